"""What a completed step costs to decide upon, in a lab of one workcell, of 50 and of 1,000.

All workcells are alike: the RPL workcell under other names, each with runs that want to come in. A turn
is the real kernel's over a log in memory (see ``still_lab``): the result is decided and folded, planning
proposes what may start now, each start is decided, folded and sealed, and the invariants are checked.
"""

from __future__ import annotations

import asyncio
import gc
import random
import time
from collections.abc import Sequence
from functools import cache
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from labos.core.actions import ActionRequested
from labos.core.decide import Command
from labos.core.decide.actions import AcceptAction, FinishAction
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ActionId, RunId, workcell_of
from labos.core.model import Workcell
from labos.runtime.ledger import Entry
from tests.benchmarks.figures import Figure, Report, median, milliseconds, percentile, times
from tests.benchmarks.still_lab import ROUTES, StillLab, still_lab, workflow
from tests.simulation.mixes import CELL

MUST = 1.5
MUST_P99_S = 0.020
MUST_RATE = 33.0
"""Actions a second of 1,000 workcells."""

NAME = CELL.workcell.name

T = TypeVar("T", Workcell, SubmitRun)


class Size(msgspec.Struct, frozen=True):
    """A lab of so many workcells, with so many runs that wait in each."""

    cells: int
    waiting: int
    turns: int

    def __str__(self) -> str:
        return (
            f"{self.cells:,} workcell{'s' if self.cells > 1 else ''}, {self.cells * self.waiting:,} waiting"
        )


SIZES = (Size(1, 3, 1000), Size(50, 3, 3000), Size(50, 200, 2000), Size(1000, 3, 3000))


class Work(msgspec.Struct):
    """What was measured: the processor's seconds of each turn that ends an action, and of all turns."""

    ends: list[float] = []
    accepts: list[float] = []
    events: int = 0
    evaluations: int = 0
    active: int = 0

    @property
    def mean(self) -> float:
        return sum(self.ends) / len(self.ends)

    @property
    def rate(self) -> float:
        """Actions a second of one kernel that does nothing else."""
        return len(self.ends) / (sum(self.ends) + sum(self.accepts))


def cell_name(number: int) -> str:
    return f"c{number}"


def under(name: str, what: T) -> T:
    """The same workcell, or a run in it, under another name."""
    text = msgspec.json.encode(what).decode()
    text = text.replace(f'"{NAME}/', f'"{name}/').replace(f'"workcell":"{NAME}"', f'"workcell":"{name}"')
    text = text.replace(f'"name":"{NAME}"', f'"name":"{name}"')
    return msgspec.json.decode(text, type=type(what))


@cache
def route_in(cell: int, number: int) -> SubmitRun:
    return under(cell_name(cell), workflow(number))


def some_run(rng: random.Random, cell: int, users: int) -> SubmitRun:
    """PCR or a generated route in a workcell."""
    number = 0 if rng.random() < 0.3 else rng.randrange(1, ROUTES)
    return replace(route_in(cell, number), user=f"user{rng.randrange(users)}")


class Town:
    """Many workcells under one kernel, each kept supplied with runs that wait."""

    def __init__(self, lab: StillLab, size: Size, users: int) -> None:
        self.lab, self.size, self.users = lab, size, users
        self.rng = random.Random(f"size/{size.cells}/{size.waiting}")
        cells = [under(cell_name(number), CELL.workcell) for number in range(size.cells)]
        self.labs = [StillLab(lab.kernel, number, cell) for number, cell in enumerate(cells)]
        self.waiting: list[list[RunId]] = [[] for _ in cells]
        self.flying: list[ActionId] = []
        self.new: list[ActionId] = []
        lab.kernel.listeners.append(self)

    def on_committed(self, entries: Sequence[Entry]) -> None:
        """Note what is in flight: to look for it among 1,000 workcells would take longer than a turn."""
        self.new += [entry.event.action for entry in entries if isinstance(entry.event, ActionRequested)]

    def on_reopened(self) -> None:
        raise AssertionError("a log in memory is not lost")

    async def furnish(self) -> None:
        for number, lab in enumerate(self.labs):
            lab.furnish()
            await self.supply(number)

    async def supply(self, cell: int) -> None:
        """Submit runs until as many wait in a workcell as should."""
        state = self.lab.state
        while True:
            self.waiting[cell] = [run for run in self.waiting[cell] if run in state.runs.queued]
            if len(self.waiting[cell]) >= self.size.waiting:
                return
            await self.lab.submit(some_run(self.rng, cell, self.users))
            self.waiting[cell].append(RunId(f"R{state.runs.named}"))

    async def turn(self, work: Work) -> None:
        """Let some action in flight succeed; its workcell is then tidied and supplied."""
        state, scheduler = self.lab.state, self.lab.kernel.scheduler
        for name in self.new:
            self.flying.append(name)
            work.accepts.append(self.time_turn(AcceptAction(name, 1, self.lab.kernel.clock.now_ns())))
        self.new.clear()
        at = self.rng.randrange(len(self.flying))
        self.flying[at], self.flying[-1] = self.flying[-1], self.flying[at]
        action = state.actions.open[self.flying.pop()]
        before, evaluations = state.position, scheduler.evaluations
        work.ends.append(self.time_turn(FinishAction(action.id, action.attempt, True, "all")))
        work.events += state.position - before
        work.evaluations += scheduler.evaluations - evaluations
        work.active += len(state.runs.active)
        await asyncio.sleep(0)
        cell = int(workcell_of(action.module)[1:])
        await self.labs[cell].tidy()
        await self.supply(cell)

    def time_turn(self, command: Command) -> float:
        """The processor's seconds of a turn."""
        began = time.thread_time()
        self.lab.tell(command)
        return time.thread_time() - began


async def measure_one(size: Size, users: int) -> Work:
    async with still_lab(cell=None) as lab:
        town = Town(lab, size, users)
        await town.furnish()
        for _ in range(min(size.turns, 20 * size.cells)):
            await town.turn(Work())
        gc.collect()
        gc.freeze()
        work = Work()
        for _ in range(size.turns):
            await town.turn(work)
        gc.unfreeze()
    return work


def measure(*sizes: Size, users: int = 20) -> Report:
    sizes = sizes or SIZES
    works = [asyncio.run(measure_one(size, users)) for size in sizes]
    alone = works[0]
    figures, notes = [], []
    for size, work in zip(sizes, works, strict=True):
        p99 = percentile(work.ends, 0.99)
        ratio = work.mean / alone.mean
        figures.append(
            Figure(
                f"decision after a completed step, {size}, mean (p99, worst)",
                f"{milliseconds(work.mean)} ({milliseconds(p99)}, {milliseconds(max(work.ends))})",
                milliseconds(alone.mean),
                times(ratio),
                f"≤ {MUST} ×, p99 ≤ {MUST_P99_S * 1e3:.0f} ms" if size != sizes[0] else "–",
                (ratio <= MUST and p99 <= MUST_P99_S) if size != sizes[0] else None,
            )
        )
        notes.append(
            f"{size}: p50 {milliseconds(median(work.ends))}, {work.active / len(work.ends):.0f} runs inside, "
            f"{work.events / len(work.ends):.1f} events and {work.evaluations / len(work.ends):.1f} "
            f"evaluations per turn, accepting takes {milliseconds(sum(work.accepts) / len(work.accepts))}"
        )
    rate = works[-1].rate
    figures.append(
        Figure(
            f"actions/s that one kernel decides, {sizes[-1]}",
            f"{rate:.0f}/s",
            must=f"≥ {MUST_RATE:.0f}/s",
            ok=rate >= MUST_RATE,
        )
    )
    counted = [work.evaluations / work.events for work in works]
    figures.append(
        Figure(
            f"evaluations per event, {sizes[-1]}",
            f"{counted[-1]:.2f}",
            f"{counted[0]:.2f}",
            times(counted[-1] / max(counted[0], 1e-9)),
        )
    )
    return Report(figures, notes)


def smoke() -> Report:
    return measure(Size(1, 2, 10), Size(3, 2, 10), users=4)
