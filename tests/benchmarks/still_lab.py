"""The real kernel over a log in memory: what a turn costs without disk and bus.

Nodes are played: each module has joined, and ``finish`` says that an action of one has ended.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import cache
from typing import TypeVar

from msgspec.structs import replace

from labos.clock import SystemClock, Uuid7Ids
from labos.core.decide import Command, Rejection
from labos.core.decide.actions import FinishAction
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.nodes import JoinNode
from labos.core.decide.runs import SubmitRun
from labos.core.effects import AnyEffect, Move
from labos.core.envelope import Record
from labos.core.ids import ActionId, StationName, local
from labos.core.model import ModuleSpec, Workcell
from labos.core.state import LabState
from labos.errors import StoreError
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.ports import EventStore, Head
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.testing.disk import SimulatedStore
from tests.simulation.mixes import CELL, PLANS, route, stand

T = TypeVar("T")
ROUTES = 40
OUTPUT, WASTE = StationName("rpl/wc.output"), StationName("rpl/wc.trash")
STOCK = {local(name): (kind,) * count for name, kind, count in stand().stock}
"""What the stacks of a workcell hold at first, by the station's name in the workcell."""


class MemoryWriter:
    """Everything is on disk at once; nothing is kept."""

    def __init__(self) -> None:
        self._store = SimulatedStore()
        self._on_durable: Callable[[int], None] = lambda _: None

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        self._on_durable = on_durable

    def submit(self, records: Sequence[Record]) -> None:
        # Not within the kernel's turn: a real writer answers from another thread.
        asyncio.get_running_loop().call_soon(self._on_durable, records[-1].head.position)

    async def call(self, function: Callable[[EventStore], T]) -> T:
        return function(self._store)

    async def close(self) -> None:
        pass


class StillLab:
    """The RPL workcell with living modules and full stacks. ``dead`` modules have no node."""

    def __init__(self, kernel: Kernel, seed: int, cell: Workcell) -> None:
        self.kernel, self.cell = kernel, cell
        self.rng = random.Random(seed)

    @property
    def state(self) -> LabState:
        return self.kernel.state

    def furnish(self, dead: Sequence[str] = ()) -> None:
        self.tell(ApplyWorkcell(self.cell))
        for module in self.cell.modules:
            if module.name.rpartition("/")[2] not in dead:
                self.join(module)
        for station in self.cell.places:
            self.tell(DeclareStation(station.name, STOCK.get(local(station.name), ())))

    def join(self, module: ModuleSpec) -> None:
        self.tell(JoinNode(module.name, "journal", "i1", module.driver, "1", "about", "IDLE"))

    def tell(self, command: Command) -> None:
        answer = self.kernel.submit(command, "benchmark")
        assert not isinstance(answer, Rejection), answer

    async def submit(self, run: SubmitRun) -> None:
        self.tell(run)
        await asyncio.sleep(0)

    def list_flying(self) -> list[ActionId]:
        return list(self.state.actions.open)

    async def finish_one(self) -> float:
        """Let some action in flight succeed; returns the processor's seconds for the
        kernel's turn: there is nothing in it to wait for."""
        flying = self.list_flying()
        assert flying, "the lab has come to rest"
        action = self.state.actions.open[self.rng.choice(flying)]
        began = time.thread_time()
        self.tell(FinishAction(action.id, action.attempt, True, "all"))
        took = time.thread_time() - began
        await asyncio.sleep(0)
        return took

    async def tidy(self) -> None:
        """What a person does by the way: empty the waste, refill the stacks. Where something is
        under way, it is left for the next time."""
        for station in self.cell.stations:
            place = self.state.bench.stations[station.name]
            if station.kind == "waste" and place.level > station.capacity // 2:
                self.kernel.submit(DeclareStation(station.name), "benchmark")
            elif station.kind == "stack" and len(place.stock) < 6 and local(station.name) in STOCK:
                self.kernel.submit(DeclareStation(station.name, STOCK[local(station.name)]), "benchmark")
        await asyncio.sleep(0)


def to_waste(run: SubmitRun) -> SubmitRun:
    """The same run, but its plate ends in the waste: an output hotel that nobody empties would
    fill up."""
    steps = tuple(
        replace(step, effects=tuple(_to_waste(effect) for effect in step.effects)) for step in run.plan.steps
    )
    return replace(run, plan=replace(run.plan, steps=steps))


def _to_waste(effect: AnyEffect) -> AnyEffect:
    if isinstance(effect, Move) and effect.target == OUTPUT:
        return replace(effect, target=WASTE)
    return effect


@cache
def workflow(number: int) -> SubmitRun:
    """PCR for 0, generated routes for the others."""
    return to_waste(route(number) if number else PLANS["pcr"])


def random_run(rng: random.Random, users: int = 20) -> SubmitRun:
    """PCR or a generated route, for one of the users."""
    number = 0 if rng.random() < 0.3 else rng.randrange(1, ROUTES)
    return replace(workflow(number), user=f"user{rng.randrange(users)}")


@asynccontextmanager
async def still_lab(
    seed: int = 0,
    dead: Sequence[str] = (),
    plan_with: Callable[[], Scheduler] = make_searching_scheduler,
    cell: Workcell | None = CELL.workcell,
) -> AsyncIterator[StillLab]:
    """A lab with one workcell, or with none (``cell=None``) for those who furnish it themselves."""
    settings = KernelSettings(lease_s=3600.0, snapshot_every=10**9)
    kernel = Kernel(MemoryWriter(), SystemClock(), Uuid7Ids(), settings, plan_with)
    await kernel.open()
    lab = StillLab(kernel, seed, cell or CELL.workcell)
    if cell is not None:
        lab.furnish(dead)
    await asyncio.sleep(0)
    yield lab
    await kernel.close()
