"""Which steps to start now: evaluated only where something has changed, in a fair order.

A step that cannot start sleeps on the keys whose change may end its wait. Waiting runs of one
class (same priority, shape, user and experiment) differ in nothing but age, so only the oldest of
each class is ever looked at: the cost of a decision does not grow with the queue.

The scheduler keeps nothing that it could not work out again from the state.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

import msgspec

from labos.core.ids import RunId
from labos.core.rules import Wait, examine, lab_ns
from labos.core.runs import DONE, PENDING, RunState, queue_key
from labos.core.state import LabState
from labos.planning.safety import Safety
from labos.planning.touch import EVERYTHING, cell_key

PATIENCE = 8
"""After so many younger runs of its workcell were let in before it, a waiting run is protected:
no other is let in that uses one of its modules."""

NEVER = 2**63 - 1


class Start(msgspec.Struct, frozen=True):
    """Start this step of this run."""

    run: RunId
    step: int


class Breach(msgspec.Struct, frozen=True):
    """This step's window has passed."""

    run: RunId
    step: int
    window: int


class Spot(msgspec.Struct, frozen=True):
    """A place in the waiting room: a step of an active run, or the head of a class."""

    run: RunId
    step: int
    group: str = ""


class Scheduler:
    """Proposes starts for one state that only moves forward. Make a new one after a refold."""

    def __init__(self) -> None:
        self.safety = Safety()
        self.evaluations = 0
        self.refusals = 0
        self._asleep: dict[tuple[str, int], Wait] = {}
        self._by_key: dict[str, dict[tuple[str, int], bool]] = {}
        self._alarms: list[tuple[int, tuple[str, int]]] = []
        self._passed_over: dict[RunId, int] = {}
        self._fresh = True

    def proposals(self, state: LabState, keys: Iterable[str], now: int) -> Iterator[Start]:
        """Starts that are legal and safe, one by one. The caller carries each one out before it
        asks for the next."""
        for spot in self._ordered(state, self._woken(state, set(keys), now), now):
            if spot.group:
                yield from self._admissions(state, spot.group, now)
            else:
                wait = self.judge(state, state.runs.active.get(spot.run), spot.step, now)
                if wait is None:
                    yield Start(spot.run, spot.step)
                else:
                    self._sleep((spot.run, spot.step), wait)

    def judge(
        self, state: LabState, run: RunState | None, step: int, now: int, *, only_asking: bool = False
    ) -> Wait | None:
        """What a step waits for; None if it may start now. Unless the caller is only asking, the
        step is then taken as started."""
        if run is None:
            return Wait("gone")
        self.evaluations += 1
        found = examine(state, run, step, now)
        if isinstance(found, Wait):
            return found
        queued = run.status == "queued"
        if queued or self.safety.moves_anything(state, run, step):
            plan = state.runs.plan_of(run)
            if queued:
                elder = self._protected(state, run)
                if elder:
                    return Wait("after_elder", (elder,), (cell_key(plan.workcell),))
            trapped = self.safety.traps(state, run, step, only_asking=only_asking)
            if trapped:
                self.refusals += 1
                names = (plan.steps[step].key, *trapped)
                code = "no_way_out" if trapped == [str(run.id)] else "unsafe"
                return Wait(code, names, (cell_key(plan.workcell),))
        return None

    def breaches(self, state: LabState, now: int) -> list[Breach]:
        """Windows that have passed without their step's start."""
        return [
            Breach(run.id, step, window)
            for run, step, window, deadline in _windows(state)
            if now > deadline and step not in run.breached
        ]

    def next_deadline(self, state: LabState) -> int | None:
        """When to look again even if nothing happens (UTC ns)."""
        times = [deadline + 1 for run, step, _, deadline in _windows(state) if step not in run.breached]
        while self._alarms and self._asleep.get(self._alarms[0][1], Wait("")).until != self._alarms[0][0]:
            heapq.heappop(self._alarms)
        if self._alarms:
            times.append(self._alarms[0][0])
        return min(times, default=None)

    def waits(self, state: LabState, run: RunState, now: int) -> list[tuple[int, Wait]]:
        """Why a run does not go on: (step, wait) for each step whose turn it is."""
        steps = state.runs.plans[run.plan].starts if run.status == "queued" else ready(state, run)
        found = [(step, self.judge(state, run, step, now, only_asking=True)) for step in steps]
        return [(step, wait) for step, wait in found if wait is not None]

    # -- waking ------------------------------------------------------------------------------

    def _woken(self, state: LabState, keys: set[str], now: int) -> list[Spot]:
        if self._fresh or EVERYTHING in keys:
            self._fresh = False
            self._asleep.clear()
            self._by_key.clear()
            self._alarms.clear()
            spots = [Spot(run.id, step) for run in state.runs.active.values() for step in ready(state, run)]
            return spots + [Spot(RunId(""), 0, group) for group in state.runs.queue]
        names: dict[tuple[str, int], bool] = {}
        for key in keys:
            if key.startswith("run:"):
                for spot in self._of_run(state, RunId(key[4:])):
                    names[spot] = True
            names.update(self._by_key.pop(key, {}))
        while self._alarms and self._alarms[0][0] <= now:
            names[heapq.heappop(self._alarms)[1]] = True
        woken: list[Spot] = []
        for name in names:
            self._asleep.pop(name, None)
            run, step = name
            if run in state.runs.queue:
                woken.append(Spot(RunId(""), 0, run))
            elif RunId(run) in state.runs.active:
                woken.append(Spot(RunId(run), step))
        return woken

    def _of_run(self, state: LabState, name: RunId) -> list[tuple[str, int]]:
        active = state.runs.active.get(name)
        if active is not None:
            return [(name, step) for step in ready(state, active)]
        queued = state.runs.queued.get(name)
        if queued is None:
            return []
        group = (queue_key(state.runs.plans[queued.plan].shape, queued), 0)
        return [] if group in self._asleep else [group]

    def _sleep(self, name: tuple[str, int], wait: Wait) -> None:
        self._asleep[name] = wait
        for key in wait.on:
            self._by_key.setdefault(key, {})[name] = True
        if wait.until is not None:
            heapq.heappush(self._alarms, (wait.until, name))

    # -- order -------------------------------------------------------------------------------

    def _ordered(self, state: LabState, spots: list[Spot], now: int) -> list[Spot]:
        usage = state.campaigns.usage

        def rank(spot: Spot) -> tuple[int, int, bool, float, int]:
            run = head_of(state, spot.group) if spot.group else state.runs.active[spot.run]
            used = usage[run.user].level(now) if run.user in usage else 0.0
            deadline = NEVER if spot.group else _deadline(state, run, spot.step)
            return (deadline, -run.priority, bool(spot.group), used, run.position)

        return sorted(spots, key=rank)

    # -- letting new runs in -----------------------------------------------------------------

    def _admissions(self, state: LabState, group: str, now: int) -> Iterator[Start]:
        while group in state.runs.queue:
            run = head_of(state, group)
            steps = state.runs.plans[run.plan].starts
            waits: list[Wait] = []
            free = None
            for step in steps:
                wait = self.judge(state, run, step, now)
                if wait is None:
                    free = step
                    break
                waits.append(wait)
            if free is None:
                for wait in waits:
                    self._sleep((group, 0), wait)
                return
            self._let_in(state, run)
            yield Start(run.id, free)
            if run.id in state.runs.queued:
                return  # the start was rejected: to propose it again would be for ever

    def _let_in(self, state: LabState, run: RunState) -> None:
        """Count against every class's head that is older than the run that is let in."""
        self._passed_over.pop(run.id, None)
        for group in state.runs.queue:
            head = head_of(state, group)
            if head.position < run.position and head.priority >= run.priority:
                self._passed_over[head.id] = self._passed_over.get(head.id, 0) + 1

    def _protected(self, state: LabState, run: RunState) -> str:
        """The elder for whom this run has to stay out; empty if there is none."""
        for name, count in list(self._passed_over.items()):
            elder = state.runs.queued.get(name)
            if elder is None:
                del self._passed_over[name]
            elif count >= PATIENCE and elder.position < run.position and not elder.paused:
                first = state.runs.plans[elder.plan].starts[0]
                found = examine(state, elder, first, state.recorded_at)
                if isinstance(found, Wait) and found.blocked:
                    continue  # it waits for a person: nobody has to wait with it
                mine = {step.module for step in state.runs.plan_of(run).steps}
                if mine & {step.module for step in state.runs.plan_of(elder).steps}:
                    return str(elder.id)
        return ""


def head_of(state: LabState, group: str) -> RunState:
    """The oldest run of a waiting class."""
    return state.runs.queued[next(iter(state.runs.queue[group]))]


def ready(state: LabState, run: RunState) -> list[int]:
    """Steps whose turn it is: pending, with everything before them done."""
    plan = state.runs.plan_of(run)
    return [
        index
        for index, status in enumerate(run.steps)
        if status == PENDING and all(run.steps[before] == DONE for before in plan.steps[index].after)
    ]


def _windows(state: LabState) -> Iterator[tuple[RunState, int, int, int]]:
    """(run, step, window, deadline) of every running window of a step that has not started."""
    for name in state.runs.windowed:
        run = state.runs.active[name]
        plan = state.runs.plans[run.plan]
        for index in plan.windowed:
            if run.steps[index] != PENDING:
                continue
            for number, window in enumerate(plan.plan.steps[index].windows):
                ended = run.ended_at.get(str(window.anchor))
                if ended is not None and window.within_s is not None:
                    yield run, index, number, ended + lab_ns(state, window.within_s)


def _deadline(state: LabState, run: RunState, step: int) -> int:
    deadline = NEVER
    for window in state.runs.plan_of(run).steps[step].windows:
        ended = run.ended_at.get(str(window.anchor))
        if ended is not None and window.within_s is not None:
            deadline = min(deadline, ended + lab_ns(state, window.within_s))
    return deadline


__all__ = ["Breach", "Scheduler", "Start", "head_of", "ready"]
