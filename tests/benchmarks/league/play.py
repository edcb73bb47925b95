"""A workcell whose actions take exactly as long as their plans say, in virtual time.

Kernel and scheduler are the real ones, over a log in memory; the nodes are played: an action that was
requested succeeds after its step's duration. So what is measured is the order alone.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Mapping, Sequence

import msgspec
from msgspec.structs import replace

from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.decide import Command, Rejection
from labos.core.decide.actions import FinishAction
from labos.core.decide.composites import MOST_RUNS, SubmitRuns
from labos.core.decide.control import PauseStarts, ResumeStarts
from labos.core.decide.experiments import EndExperiment, StartExperiment
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.nodes import JoinNode
from labos.core.decide.runs import SubmitRun
from labos.core.experiments import ExperimentStarted
from labos.core.ids import ExperimentId, RunId, StationName
from labos.core.lab import WHOLE_LAB
from labos.core.model import Workcell
from labos.core.registry import Event
from labos.core.runs import RunCompleted, RunSubmitted
from labos.core.steps import WindowBreached
from labos.planner.planner import Planner
from labos.planner.watch import CellWatch, list_waiting
from labos.planning.scheduler import Scheduler
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import Entry
from labos.testing.loop import CountedIds, VirtualClock, VirtualLoop
from tests.benchmarks.still_lab import MemoryWriter

SECOND = 1_000_000_000

LOOK_AGAIN = 10
"""Where the planner has not looked at all runs, it looks again after so many have come to their ends."""
STOCK_COUNT = 400


class Work(msgspec.Struct, frozen=True):
    """Runs that follow one another, as parts of an experiment if ``experiment`` is given."""

    runs: tuple[SubmitRun, ...]
    experiment: StartExperiment | None = None
    after_s: float = 0.0


class Placed(msgspec.Struct, frozen=True):
    """A step that was carried out: seconds from the first submission."""

    run: RunId
    step: int
    start_s: float
    end_s: float


class Outcome(msgspec.Struct):
    """What came of it. ``works`` says of each run which work it belongs to, and the how manieth of it it
    is."""

    makespan_s: float
    steps: list[Placed]
    breaches: int
    works: dict[RunId, tuple[int, int]]


class Player:
    """One workcell with full stacks. ``jitter`` scatters durations by this fraction, either way; a step takes
    as long whenever it is carried out, so that orders can be compared. A planner looks when runs are
    submitted, and nothing starts before it has; where durations scatter also when runs come or go inside, or
    are late. There, without a planner, nothing starts until as much later: a difference of a millisecond can
    lead to another order.
    ``together``: the runs that wait for nothing are submitted in one command, as by ``submit_all``; else one
    after the other, and the first one starts before the next one is known."""

    def __init__(
        self,
        cell: Workcell,
        stock: Mapping[StationName, tuple[str, int]],
        plan_with: Callable[[], Scheduler] = Scheduler,
        jitter: float = 0.0,
        seed: int = 0,
        planner: Planner | None = None,
        *,
        together: bool = True,
    ) -> None:
        self.cell, self.stock, self.jitter = cell, stock, jitter
        self._seed = seed
        self.loop = VirtualLoop()
        self.clock = VirtualClock(self.loop)
        self._plan_with = plan_with
        self.planner, self.together = planner, together
        self.watch = CellWatch() if jitter else None
        self._asked = False
        self._seen: set[RunId] = set()
        self._ended = 0
        self.outcome = Outcome(0.0, [], 0, {})
        self._begun: dict[tuple[RunId, int], float] = {}
        self._ends: dict[RunId, asyncio.Event] = {}

    def play(self, works: Sequence[Work]) -> Outcome:
        """Do all of it; raises Stalled if it does not come to its end."""
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_until_complete(self._play(works))
        finally:
            asyncio.set_event_loop(None)
            self.loop.close()
        return self.outcome

    async def _play(self, works: Sequence[Work]) -> None:
        settings = KernelSettings(lease_s=1e9, snapshot_every=10**9)
        self.kernel = Kernel(MemoryWriter(), self.clock, CountedIds("league"), settings, self._plan_with)
        await self.kernel.open()
        self.kernel.listeners.append(self)
        self._tell(ApplyWorkcell(self.cell))
        for module in self.cell.modules:
            self._tell(JoinNode(module.name, "journal", "i1", module.driver, "1", "about", "IDLE"))
        for station in self.cell.places:
            kind, count = self.stock.get(station.name, ("", 0))
            self._tell(DeclareStation(station.name, (kind,) * count))
        if self.planner is not None or self.jitter:
            self._tell(PauseStarts(WHOLE_LAB, "league"))  # until it has looked
        at_once = {number: work for number, work in enumerate(works) if self.together and not work.after_s}
        submitted = self._submit_together(at_once)
        await asyncio.gather(
            *(self._do(number, work, *submitted.get(number, ())) for number, work in enumerate(works))
        )
        self.outcome.makespan_s = max(step.end_s for step in self.outcome.steps)
        await self.kernel.close()

    def _submit_together(self, works: Mapping[int, Work]) -> dict[int, tuple[ExperimentId, RunId]]:
        """Submit the first run of each work, as many in one command as it takes."""
        numbers = list(works)
        experiments = {number: self._start_experiment(works[number]) for number in numbers}
        names: list[RunId] = []
        for first in range(0, len(numbers), MOST_RUNS):
            batch = numbers[first : first + MOST_RUNS]
            runs = tuple(replace(works[n].runs[0], experiment=experiments[n]) for n in batch)
            names += _list_submitted(self._tell(SubmitRuns(runs)))
        self.outcome.works.update((name, (n, 0)) for n, name in zip(numbers, names, strict=True))
        return {n: (experiments[n], name) for n, name in zip(numbers, names, strict=True)}

    def _start_experiment(self, work: Work) -> ExperimentId:
        if work.experiment is None:
            return ExperimentId("")
        started = self._tell(work.experiment)
        return next(e.experiment for e in started if isinstance(e, ExperimentStarted))

    async def _do(
        self, number: int, work: Work, experiment: ExperimentId | None = None, first: RunId | None = None
    ) -> None:
        """Submit the runs of a work, one after the other; some have submitted the first one already."""
        await asyncio.sleep(work.after_s)
        experiment = self._start_experiment(work) if experiment is None else experiment
        for index, run in enumerate(work.runs):
            name = first if not index else None
            if name is None:
                (name,) = _list_submitted(self._tell(replace(run, experiment=experiment)))
            self.outcome.works[name] = number, index
            await self._ends.setdefault(name, asyncio.Event()).wait()
        if experiment:
            self._tell(EndExperiment(experiment))

    def _tell(self, command: Command) -> list[Event]:
        answer = self.kernel.submit(command, "league")
        assert not isinstance(answer, Rejection), answer
        return answer

    # -- what is listened to ------------------------------------------------------------------

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            event, now = entry.event, self.loop.time()
            if isinstance(event, RunSubmitted):
                self._let_plan()
            if isinstance(event, ActionRequested):
                self._begin(event, now)
            elif isinstance(event, ActionSucceeded):
                begun = self._begun.pop((event.run, event.step))
                self.outcome.steps.append(Placed(event.run, event.step, begun, now))
            elif isinstance(event, WindowBreached):
                self.outcome.breaches += 1
            elif isinstance(event, RunCompleted):
                self._ends.setdefault(event.run, asyncio.Event()).set()
                self._ended += 1
                unseen = any(run not in self._seen for run in self.kernel.state.runs.queued)
                if self.watch is None and unseen and self._ended >= LOOK_AGAIN:
                    self._let_plan()
        if self.watch is not None:
            self._let_plan()

    def on_reopened(self) -> None:
        raise AssertionError("a log in memory is never read again")

    def _let_plan(self) -> None:
        if not self._asked and (self.planner is not None or WHOLE_LAB in self.kernel.state.lab.paused):
            self._asked = True
            self.loop.call_soon(self._ask_planner)

    def _ask_planner(self) -> None:
        self._asked = False
        if self.planner is not None:
            self._look(self.planner)
        if WHOLE_LAB in self.kernel.state.lab.paused:
            self._tell(ResumeStarts(WHOLE_LAB, "league"))

    def _look(self, planner: Planner) -> None:
        state, now = self.kernel.state, self.clock.now_ns()
        waiting = list_waiting(state, self.cell.name)
        if self.watch is not None:
            is_due = self.watch.is_due(state, self.cell.name, waiting, now)
            if not is_due and not planner.is_due(state, self.cell.name, waiting, now):
                return
        found = planner.suggest(state, self.cell.name, waiting, now)
        if self.watch is not None:
            self.watch.note(state, self.cell.name, waiting, found, now)
        self._ended = 0
        if found is not None:
            self._seen.update(step.run for step in found.steps)
            self._tell(found)

    def _begin(self, event: ActionRequested, now: float) -> None:
        self._begun[event.run, event.step] = now
        step = self.kernel.state.runs.plan_of(self.kernel.state.runs.active[event.run]).steps[event.step]
        work, index = self.outcome.works[event.run]
        took = draw_duration(self._seed, self.jitter, work, index, event.step, step.duration_s)
        done = FinishAction(event.action, event.attempt, True, "all")
        self.loop.call_later(took, self._tell, done)


def draw_duration(seed: int, jitter: float, work: int, run: int, step: int, duration_s: float) -> float:
    """How long a step of a run of a work takes, if durations vary by up to this part, either way."""
    drawn = random.Random(f"league/{seed}/{work}/{run}/{step}")
    return duration_s * drawn.uniform(1 - jitter, 1 + jitter)


def _list_submitted(events: Sequence[Event]) -> list[RunId]:
    return [event.run for event in events if isinstance(event, RunSubmitted)]
