"""Which steps to start now: evaluated only where something has changed, in a fair order.

A step that cannot start sleeps on the keys whose change may end its wait. Runs that wait to be
let in sleep in bundles of those that wait for the same (see ``waiting``): the cost of a decision
does not grow with the queue.

The scheduler keeps nothing that it could not work out again from the state.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from functools import partial

import msgspec

from labos.core.decide.cancelling import GiveUpWayOut, TakeWayOut
from labos.core.decide.endings import under_way
from labos.core.decide.experiments import EndExperiment
from labos.core.ids import ActionId, InterventionId, ModuleName, RunId
from labos.core.leaving import will_leave
from labos.core.rules import due_at, examine, lab_ns, missed_at
from labos.core.runs import PENDING, SETTLED, RunState, anchored_at
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.aside import better_here
from labos.planning.forecast import is_pending
from labos.planning.obstacle import obstacle
from labos.planning.reservations import Reservations
from labos.planning.safety import Safety
from labos.planning.stuck import asked, stuck_on
from labos.planning.touch import BENCH, EVERYTHING, cell_key
from labos.planning.waiting import Kind, WaitingRoom


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
    """Something to look at: a step of an active run, or a bundle of runs that wait and which of
    them is first."""

    run: RunState
    step: int
    bundle: str = ""


class Scheduler:
    """Proposes starts for one state that only moves forward. Make a new one after a refold."""

    def __init__(self) -> None:
        self.safety = Safety()
        self.reservations = Reservations()
        self.evaluations = 0
        self.refusals = 0
        self._asleep: dict[tuple[str, int], Wait] = {}
        self._by_key: dict[str, dict[tuple[str, int], bool]] = {}
        self._alarms: list[tuple[int, tuple[str, int]]] = []
        self.room = WaitingRoom()
        self._levels: dict[str, float] = {}
        self._futile: dict[RunId, bool] = {}
        self._futile_at = -1
        self._fresh = True

    def proposals(self, state: LabState, keys: Iterable[str], now: int) -> Iterator[Start]:
        """Starts that are legal and safe, one by one. The caller carries each one out before it
        asks for the next."""
        self._levels.clear()
        for spot in self._ordered(state, self._woken(state, set(keys), now), now):
            if spot.bundle:
                yield from self._admissions(state, spot.bundle, spot.run, now)
            else:
                wait = self.judge(state, state.runs.active.get(spot.run.id), spot.step, now)
                if wait is None:
                    yield Start(spot.run.id, spot.step)
                else:
                    self._sleep((spot.run.id, spot.step), wait)

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
        reserved = self.reservations.against(state, run, step, now, self.safety)
        if reserved is not None:
            return reserved
        queued = run.status == "queued"
        if queued:
            stuck = stuck_on(state, run)
            if stuck is not None:
                return stuck  # let in, it would come to a stand on the bench
        if queued or self.safety.changes_anything(state, run, step):
            plan = state.runs.plan_of(run)
            aside = better_here(state, self.safety, run, step)
            if aside is not None:
                return aside
            if queued and run.id not in state.runs.windowed:  # a clock that runs goes before patience
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

    def timed_out(self, state: LabState, now: int) -> list[ActionId]:
        """Actions that have not ended in the time that their steps give them, or whose node is away."""
        return list(dict.fromkeys(name for name, due in _due(state) if now > due))

    def leaving(self, state: LabState) -> list[TakeWayOut | GiveUpWayOut | EndExperiment]:
        """What becomes of cancelled runs of which nothing is in flight: they go their way out, or cannot.
        Cancelled experiments close when their runs have ended."""
        found: list[TakeWayOut | GiveUpWayOut | EndExperiment] = [
            EndExperiment(experiment.id, "it was cancelled")
            for experiment in state.campaigns.experiments.values()
            if experiment.status == "cancelled" and not experiment.runs
        ]
        for run in state.runs.active.values():
            if run.status == "active" or under_way(run):
                continue
            if will_leave(state.runs.plan_of(run), run):
                found.append(TakeWayOut(run.id))
            elif run.status == "leaving" and not self.safety.comes_out(state, run):
                found.append(GiveUpWayOut(run.id))
        return found

    def outages_over(self, state: LabState, now: int) -> list[ModuleName]:
        """Modules that were out of service until now."""
        return [module for module, back_at in state.modules.back_at.items() if back_at <= now]

    def unanswered(self, state: LabState, now: int) -> list[InterventionId]:
        """Planned work that should have been confirmed until now."""
        return [
            question.id
            for question in state.interventions.open.values()
            if 0 < question.due_at <= now and not question.overdue
        ]

    def next_deadline(self, state: LabState) -> int | None:
        """When to look again even if nothing happens (UTC ns)."""
        times = [deadline + 1 for run, step, _, deadline in _windows(state) if step not in run.breached]
        times += state.modules.back_at.values()
        times += [due + 1 for _, due in _due(state)]
        asked = state.interventions.open.values()
        times += [question.due_at for question in asked if question.due_at and not question.overdue]
        while self._alarms and self._asleep.get(self._alarms[0][1], Wait("")).until != self._alarms[0][0]:
            heapq.heappop(self._alarms)
        if self._alarms:
            times.append(self._alarms[0][0])
        return min(times, default=None)

    def waits(self, state: LabState, run: RunState, now: int) -> list[tuple[int, Wait]]:
        """Why a run does not go on: (step, wait) for each step whose turn it is."""
        steps = state.runs.plans[run.plan].starts if run.status == "queued" else ready(state, run)
        found = [(step, self.judge(state, run, step, now, only_asking=True)) for step in steps]
        return [*asked(state, run), *((step, wait) for step, wait in found if wait is not None)]

    # -- waking ------------------------------------------------------------------------------

    def _woken(self, state: LabState, keys: set[str], now: int) -> list[Spot]:
        if self._fresh or BENCH in keys:
            self._fresh = False
            self.room.fill(state)
            self.safety.forget()
            keys.add(EVERYTHING)
        moved = self.room.follow(state)
        names: dict[tuple[str, int], bool] = {(bundle, 0): True for bundle in moved}
        for key in keys:
            if key.startswith("run:"):
                for name in self._of_run(state, RunId(key[4:])):
                    names[name] = True
            elif key != EVERYTHING:
                names.update(self._by_key.pop(key, {}))
        while self._alarms and self._alarms[0][0] <= now:
            names[heapq.heappop(self._alarms)[1]] = True
        if EVERYTHING in keys:
            self._asleep.clear()
            self._by_key.clear()
            self._alarms.clear()
            names = {(run.id, step): True for run in state.runs.active.values() for step in ready(state, run)}
            names.update({(bundle, 0): True for bundle in self.room})
        seen: dict[Kind, list[Wait]] = {}
        return [spot for spot in (self._rouse(state, name, now, seen) for name in names) if spot is not None]

    def _rouse(
        self, state: LabState, name: tuple[str, int], now: int, seen: dict[Kind, list[Wait]]
    ) -> Spot | None:
        """Who is worth a look in turn; a bundle that has to wait anyway sleeps on at once. ``seen``
        keeps what was found for bundles of the same kind."""
        self._asleep.pop(name, None)
        who, step = name
        if who not in self.room:
            active = state.runs.active.get(RunId(who))
            return Spot(active, step) if active is not None else None
        run = self.room.anybody(state, who)
        if run is None:
            return None
        kind = self.room.kind(who)
        waits = seen.get(kind)
        if waits is None:
            waits = seen[kind] = self._waits_at_start(state, run, now)
        for wait in waits:
            self._sleep(name, wait)
        first = self._first(state, who, now) if not waits else None
        return Spot(first, 0, who) if first is not None else None

    def _waits_at_start(self, state: LabState, run: RunState, now: int) -> list[Wait]:
        """What each first step of a run has to wait for; nothing if one of them is possible."""
        waits: list[Wait] = []
        for step in state.runs.plans[run.plan].starts:
            self.evaluations += 1
            found = examine(state, run, step, now)
            if not isinstance(found, Wait):
                return []
            waits.append(found)
        return waits

    def _of_run(self, state: LabState, name: RunId) -> list[tuple[str, int]]:
        active = state.runs.active.get(name)
        if active is not None:
            return [(name, step) for step in ready(state, active)]
        queued = state.runs.queued.get(name)
        bundle = self.room.note(state, queued) if queued is not None else ""
        return [(bundle, 0)] if bundle else []

    def _sleep(self, name: tuple[str, int], wait: Wait) -> None:
        self._asleep[name] = wait
        for key in wait.on:
            self._by_key.setdefault(key, {})[name] = True
        if wait.until is not None:
            heapq.heappush(self._alarms, (wait.until, name))

    # -- order -------------------------------------------------------------------------------

    def _ordered(self, state: LabState, spots: list[Spot], now: int) -> list[Spot]:
        def rank(spot: Spot) -> tuple[int, int, bool, float, int]:
            run, waits = spot.run, bool(spot.bundle)
            deadline = self.reservations.urgency(state, run, None if waits else spot.step, now)
            return (deadline, -run.priority, waits, self._used(state, now, run.user), run.position)

        return sorted(spots, key=rank)

    def _used(self, state: LabState, now: int, user: str) -> float:
        """The lab time a user has had, worked out once in a turn."""
        level = self._levels.get(user)
        if level is None:
            usage = state.campaigns.usage.get(user)
            level = self._levels[user] = usage.level(now) if usage is not None else 0.0
        return level

    # -- letting new runs in -----------------------------------------------------------------

    def _first(self, state: LabState, bundle: str, now: int) -> RunState | None:
        return self.room.first(state, bundle, partial(self._used, state, now))

    def _admissions(self, state: LabState, bundle: str, first: RunState | None, now: int) -> Iterator[Start]:
        run = first
        while run is not None:
            free, waits = self._free_start(state, run, now)
            if free is None and any(wait.code == "after_elder" for wait in waits):
                # Somebody older than the elder need not wait with the others.
                run = self.room.oldest(state, bundle) or run
                free, waits = self._free_start(state, run, now)
            if free is None:
                for wait in waits:
                    self._sleep((bundle, 0), wait)
                return
            self.room.let_in(state, run)
            yield Start(run.id, free)
            if run.id in state.runs.queued:
                return  # the start was rejected: to propose it again would be for ever
            run = self._first(state, bundle, now)

    def _free_start(self, state: LabState, run: RunState, now: int) -> tuple[int | None, list[Wait]]:
        """The first step with which a run may be let in, or what each of them waits for."""
        waits: list[Wait] = []
        for step in state.runs.plans[run.plan].starts:
            wait = self.judge(state, run, step, now)
            if wait is None:
                return step, []
            waits.append(wait)
        return None, waits

    def _protected(self, state: LabState, run: RunState) -> str:
        """The elder for whom this run has to stay out; empty if there is none."""
        plan = state.runs.plans[run.plan]
        for elder in self.room.impatient(state):
            if elder.position < run.position and not elder.paused:
                first = state.runs.plans[elder.plan].starts[0]
                found = examine(state, elder, first, state.recorded_at)
                if isinstance(found, Wait) and found.blocked:
                    continue  # it waits for a person: nobody has to wait with it
                if self._stands_out(state, elder):
                    continue  # a later step of it does, or what it waits for no run inside moves away
                if not plan.windowed and self._reserved(state, elder, first):
                    continue  # it waits for a time: who reserves nothing does not put it off
                mine = {step.module for step in state.runs.plan_of(run).steps}
                if mine & {step.module for step in state.runs.plan_of(elder).steps}:
                    return str(elder.id)
        return ""

    def _stands_out(self, state: LabState, elder: RunState) -> bool:
        """Whether a run could not come to its end in an empty workcell either."""
        if self._futile_at != state.position:
            self._futile_at = state.position
            self._futile.clear()
        known = self._futile.get(elder.id)
        if known is None:
            known = stuck_on(state, elder) is not None or bool(obstacle(self.safety, state, elder))
            self._futile[elder.id] = known
        return known

    def _reserved(self, state: LabState, run: RunState, step: int) -> bool:
        return self.reservations.against(state, run, step, state.recorded_at, self.safety) is not None


def ready(state: LabState, run: RunState) -> list[int]:
    """Steps whose turn it is: pending, with everything before them done."""
    plan = state.runs.plan_of(run)
    return [
        index
        for index, status in enumerate(run.steps)
        if status == PENDING and all(run.steps[before] in SETTLED for before in plan.steps[index].after)
    ]


def _due(state: LabState) -> Iterator[tuple[ActionId, int]]:
    """The actions in flight whose time is limited, by their step or as their node is gone, and when it is
    over (UTC ns)."""
    for action in state.actions.open.values():
        for due in (due_at(state, action), missed_at(state, action)):
            if due is not None:
                yield action.id, due


def _windows(state: LabState) -> Iterator[tuple[RunState, int, int, int]]:
    """(run, step, window, deadline) of every running window of a step that has not started."""
    for name in state.runs.windowed:
        run = state.runs.get(name)
        assert run is not None
        plan = state.runs.plans[run.plan]
        for index in plan.windowed:
            if not is_pending(run, index):
                continue
            for number, window in enumerate(plan.plan.steps[index].windows):
                ended = anchored_at(run, window)
                if ended is not None and window.within_s is not None:
                    yield run, index, number, ended + lab_ns(state, window.within_s)


__all__ = ["Breach", "Scheduler", "Start", "ready"]
