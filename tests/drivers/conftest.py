"""A bench in memory, and a loop in which waiting takes no time."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, TypeVar

import pytest

from labos.node import Node, Setup, World

N = TypeVar("N", bound=Node)
T = TypeVar("T")


class Leap(selectors.SelectSelector):
    """A selector that skips the time it was asked to wait."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self.now += timeout or 0.0
        return super().select(0)


def leaping_loop() -> asyncio.AbstractEventLoop:
    selector = Leap()
    loop = asyncio.SelectorEventLoop(selector)
    loop.time = lambda: selector.now  # type: ignore[method-assign]
    return loop


def lab_seconds(work: Callable[[], Awaitable[T]]) -> T:
    """Run in a loop whose clock leaps: a lab second takes no time."""
    with asyncio.Runner(loop_factory=leaping_loop) as runner:

        async def body() -> T:
            return await work()

        return runner.run(body())


@pytest.fixture
def world() -> Iterator[World]:
    world = World()
    yield world
    world.close()


class Bench:
    """Nodes on one bench."""

    def __init__(self, world: World) -> None:
        self.world = world

    async def start(self, driver: type[N], name: str, *, pace: float = 1e6, **more: Any) -> N:
        node = driver(Setup(name=name, workcell="rpl", world=self.world, pace=pace, **more))
        await node.connect()
        return node


@pytest.fixture
def bench(world: World) -> Bench:
    return Bench(world)
