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
from labos_drivers._wired import DeviceOnWire

N = TypeVar("N", bound=Node)
D = TypeVar("D", bound=DeviceOnWire)
T = TypeVar("T")

PACE = 200.0


def setup_of(name: str, world: World | None, pace: float = PACE, **told: Any) -> Setup:
    return Setup(name=name, workcell="rpl", world=world, pace=pace, **told)


@contextmanager
def power_on(
    kind: Callable[..., D],
    name: str,
    world: World,
    path: Path | None = None,
    *,
    pace: float = PACE,
    told: dict[str, Any] | None = None,
    **more: Any,
) -> Iterator[D]:
    """A simulated device that is switched on, at a port of a lasting name (without a path: at an end of
    its own). ``told`` is the rest of its Setup."""
    ends = [PtyEnd(path)] if path is not None else []
    device = kind(setup_of(name, world, pace, **told or {}), *ends, **more)
    device.start()
    try:
        yield device
    finally:
        device.close()


def at_port(driver: type[N], name: str, path: Path | str, *, key: str = "port", **told: Any) -> N:
    """A node with its real driver: it knows where the device is, and nothing of a bench."""
    config = {key: str(path), **told.pop("config", {})}
    return driver(setup_of(name, None, 1.0, config=config, **told))


async def until(reached: Callable[[], bool], limit_s: float = 20.0) -> None:
    """Wait for something that another thread brings about."""
    deadline = time.monotonic() + limit_s
    while not reached():
        assert time.monotonic() < deadline, "it never came"
        await asyncio.sleep(0.002)


def run(work: Callable[[], Awaitable[T]]) -> T:
    async def body() -> T:
        return await work()

    return asyncio.run(body())
