"""Drivers and their simulated devices, at the two ends of a real wire."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from labos.link import PtyEnd
from labos.node import Node, Setup, World
from labos_drivers._onwire import OnWire

N = TypeVar("N", bound=Node)
D = TypeVar("D", bound=OnWire)
T = TypeVar("T")

PACE = 200.0


def setup_of(name: str, world: World, pace: float = PACE) -> Setup:
    return Setup(name=name, workcell="rpl", world=world, pace=pace)


@contextmanager
def powered(
    kind: Callable[..., D], name: str, world: World, path: Path, *, pace: float = PACE, **more: Any
) -> Iterator[D]:
    """A simulated device that is switched on, at a port of a lasting name."""
    device = kind(setup_of(name, world, pace), PtyEnd(path), **more)
    device.start()
    try:
        yield device
    finally:
        device.close()


def at_port(driver: type[N], name: str, path: Path | str) -> N:
    """A node with its real driver: it knows the port and nothing of a bench."""
    return driver(Setup(name=name, workcell="rpl", config={"port": str(path)}))


async def until(reached: Callable[[], bool], limit_s: float = 5.0) -> None:
    """Wait for something that another thread brings about."""
    deadline = time.monotonic() + limit_s
    while not reached():
        assert time.monotonic() < deadline, "it never came"
        await asyncio.sleep(0.002)


def run(work: Callable[[], Awaitable[T]]) -> T:
    async def body() -> T:
        return await work()

    return asyncio.run(body())
