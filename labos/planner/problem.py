"""The remaining work in a workcell, as a problem of tasks and rooms, read from the lab's state.

A task is a step that has not ended. It uses its module (if it is exclusive) and its zones, the modules into
whose places its hand reaches, and the place where it changes its grip. Labware uses room at a place from the
start of the task that brings it to the end of the task that carries it away; during that time it also uses
the deck (``claim``) to which the place belongs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

import msgspec

from labos.core.actions import ActionStatus
from labos.core.booked import find_blocked, find_contacts, is_exempt
from labos.core.effects import list_carried
from labos.core.ids import ModuleName, RunId, StationName, experiment_owner, run_owner, split_key
from labos.core.model import MAIN, PlanStep
from labos.core.runs import IN_FLIGHT, PENDING, SETTLED, RunState, RunStatus, find_holds
from labos.core.state import LabState
from labos.core.suggestions import MOST_STEPS
from labos.planner.lengths import estimate_at_level
from labos.planner.measure import rate_runs
from labos.planning.forecast import find_run, find_setup_in_progress
from labos.planning.taken import count_room, find_station, is_deck, list_counted_keys, list_taken

MOST_WAITING = 30
"""Only so many waiting runs are planned: those that would start first."""


MOST_WINDOWED = 20
"""If there are windows, only so many runs are planned in all, and always those in progress; further runs are
added when these end, and take part in rehearsals before (``add_next``)."""

AHEAD_NS = 24 * 3600 * 10**9
"""Bookings within this time from now are planned (wall time)."""

LEAST_S = 1.0
"""The least remaining time of a step that takes longer than planned (lab seconds)."""


class TimeLag(msgspec.Struct, frozen=True):
    """A task starts at least and at most so long (lab seconds) after the end of another one. The other one is
    a task (``anchor``), or has ended so long ago (``ago_s``)."""

    anchor: int | None
    ago_s: float
    wait_s: float
    within_s: float | None


class Task(msgspec.Struct, frozen=True):
    """A step that has not ended: its remaining time (lab seconds), the keys of the resources that one task at
    a time may use, and the numbers of the tasks that end before. ``runs``: it has started and is in progress.
    In the times of ``shut`` (lab seconds from now) its module is booked for others."""

    run: RunId
    step: int
    duration_s: float
    takes: tuple[str, ...]
    after: tuple[int, ...]
    lags: tuple[TimeLag, ...] = ()
    runs: bool = False
    shut: tuple[tuple[float, float], ...] = ()


class RoomUse(msgspec.Struct, frozen=True):
    """Labware uses room at ``place`` from the start of task ``first`` (None: now) to the end of task ``last``
    (None: without end)."""

    place: str
    first: int | None
    last: int | None


class SetupCosts(msgspec.Struct, frozen=True):
    """Tasks on a module that is set up for each of them. A task is carried out after another one, or as the
    first; the set-up makes it longer by so many lab seconds (``first_s``, and ``change_s`` with a row for
    each task before)."""

    tasks: tuple[int, ...]
    first_s: tuple[float, ...]
    change_s: tuple[tuple[float, ...], ...]


class SchedulingProblem(msgspec.Struct, frozen=True):
    """All tasks, those of a run together, and the room at each place. ``like`` are pairs of equal first tasks
    of two runs: the first of a pair goes first. For each run, ``ends`` are the tasks without a later task,
    and ``more`` says whether it belongs to an experiment, so that further unknown runs follow; ``ranks`` is
    the number of classes before which it goes, and ``due_s`` the deadline of its campaign, if it has one (lab
    seconds from now). ``line`` are the first tasks of the runs that wait for their start, in the order of
    rank and age, and ``overtaken`` says how often each of them was overtaken. The end of all counts
    ``end_weight`` times as much as the mean of all ends."""

    tasks: tuple[Task, ...]
    stays: tuple[RoomUse, ...]
    room: dict[str, int]
    like: tuple[tuple[int, int], ...]
    ends: tuple[tuple[int, ...], ...]
    more: tuple[bool, ...]
    ranks: tuple[int, ...] = ()
    due_s: tuple[float | None, ...] = ()
    line: tuple[int, ...] = ()
    own_due_s: tuple[float | None, ...] = ()
    setups: tuple[SetupCosts, ...] = ()
    end_weight: int = 1
    overtaken: tuple[int, ...] = ()


def choose_runs(state: LabState, cell: str, waiting: Iterable[RunState]) -> list[RunState]:
    """The runs that are planned together: those in progress, and the first of the waiting ones."""
    active = [run for run in state.runs.list_inside(cell) if run.status == RunStatus.ACTIVE]
    inside = [run for run in active if not find_holds(run)]
    outside = [run for run in islice(waiting, MOST_WAITING) if not find_holds(run)]
    found: list[RunState] = []
    steps, windowed = 0, False
    for run in [*inside, *outside]:
        steps += len(state.runs.plan_of(run).steps)
        windowed = windowed or bool(state.runs.plans[run.plan].windowed)
        if steps > MOST_STEPS or (windowed and len(found) >= max(MOST_WINDOWED, len(inside))):
            break
        found.append(run)
    return found


def add_next(runs: Sequence[RunState], waiting: Iterable[RunState]) -> list[RunState]:
    """These runs and the first of those that wait: an order for a part of the runs is compared with what it
    does to the next ones, too."""
    known = {run.id for run in runs}
    others = [run for run in islice(waiting, MOST_WAITING) if run.id not in known and not find_holds(run)]
    return [*runs, *others]


def problem_of(state: LabState, runs: Sequence[RunState], now: int, level: float = 0.5) -> SchedulingProblem:
    """The remaining work of these runs of a workcell. ``level`` is the quantile of durations, between 0 and
    1."""
    reader = _Reader(state, now, level)
    for run in runs:
        reader.read(run)
    rated = rate_runs(state, runs, now)
    users = Counter(run.user for run in runs)
    return SchedulingProblem(
        tuple(reader.tasks),
        tuple(reader.stays),
        reader.count_rooms(),
        tuple(reader.like),
        tuple(reader.ends),
        tuple(bool(run.experiment) for run in runs),
        ranks=tuple(rated[run.id].rank for run in runs),
        due_s=tuple(_find_time_to(state, rated[run.id].deadline, now) for run in runs),
        own_due_s=tuple(
            _find_time_to(state, run.due_at, now) if users[run.user] > 1 else None for run in runs
        ),
        line=tuple(reader.line),
        setups=tuple(_list_setups(state, reader.tasks)),
    )


def _find_time_to(state: LabState, at: int, now: int) -> float | None:
    """Lab seconds from now to a time (UTC ns); None if that is 0, no time."""
    return (at - now) / 1e9 * state.lab.pace if at else None


def _list_setups(state: LabState, tasks: Sequence[Task]) -> Iterator[SetupCosts]:
    """The durations of set-ups between tasks that have not started, for each module with set-ups."""
    by_module: dict[ModuleName, dict[int, Mapping[str, Any]]] = {}
    for number, task in enumerate(tasks):
        step = state.runs.plan_of(find_run(state, task.run)).steps[task.step]
        module = state.modules.by_name.get(step.module)
        setup = module.spec.setup if module is not None else None
        if setup is not None and setup.argument in step.args and not task.runs:
            by_module.setdefault(step.module, {})[number] = step.args
    for name, args in by_module.items():
        module = state.modules.by_name[name]
        setup = module.spec.setup
        assert setup is not None
        values = [found[setup.argument] for found in args.values()]
        yield SetupCosts(
            tuple(args),
            tuple(setup.compute_cost_s(module.set_up_for, found) for found in args.values()),
            tuple(tuple(setup.compute_cost_s(before, found) for found in args.values()) for before in values),
        )


class _Reader:
    def __init__(self, state: LabState, now: int, level: float) -> None:
        self.state, self.now, self.level = state, now, level
        self.tasks: list[Task] = []
        self.stays: list[RoomUse] = []
        self.read_runs: dict[RunId, bool] = {}
        self._taken: dict[str, int] = {}
        self._looks: dict[str, int] = {}
        self.like: list[tuple[int, int]] = []
        self.ends: list[tuple[int, ...]] = []
        self.line: list[int] = []

    def read(self, run: RunState) -> None:
        plan = self.state.runs.plan_of(run)
        self.read_runs[run.id] = True
        base = len(self.tasks)
        numbers: dict[int, int] = {}
        for index, step in enumerate(plan.steps):
            status = run.steps[index].status if run.has_started else PENDING
            if step.part == MAIN and status not in SETTLED:
                numbers[index] = base + len(numbers)
        ended = {i: at.ended_at for i, at in enumerate(run.steps)} if run.has_started else {}
        for index, number in numbers.items():
            step = plan.steps[index]
            after = tuple(numbers[before] for before in step.after if before in numbers)
            flying = run.has_started and run.steps[index].status == IN_FLIGHT
            lags = tuple(self._list_lags(step, numbers, ended))
            duration_s = self._find_left_s(run, index, step) if flying else self._estimate_s(step)
            taken = tuple(list_taken(self.state, step))
            shut = () if flying else tuple(self._shut(run, step))
            self.tasks.append(Task(run.id, index, duration_s, taken, after, lags, runs=flying, shut=shut))
            assert number == len(self.tasks) - 1
        self._carry(run, plan.steps, numbers)
        before = {number for task in self.tasks[base:] for number in task.after}
        self.ends.append(tuple(number for number in numbers.values() if number not in before))
        if not run.has_started:
            self.line.append(base)
            look = repr((plan.steps, run.user, run.experiment, run.priority))
            if look in self._looks:
                self.like.append((self._looks[look], base))
            self._looks[look] = base

    def _list_lags(
        self, step: PlanStep, numbers: dict[int, int], ended: dict[int, int | None]
    ) -> Iterator[TimeLag]:
        for window in step.windows:
            if window.anchor is None:
                continue
            if window.anchor in numbers:
                yield TimeLag(numbers[window.anchor], 0.0, window.wait_s, window.within_s)
            elif (ended_at := ended.get(window.anchor)) is not None:
                gone_s = (self.now - ended_at) / 1e9 * self.state.lab.pace
                yield TimeLag(None, gone_s, window.wait_s, window.within_s)

    def _shut(self, run: RunState, step: PlanStep) -> Iterator[tuple[float, float]]:
        state, now = self.state, self.now
        if not state.bookings.open or is_exempt(state, run, step):
            return
        for module, clears in find_contacts(state, step).items():
            for span in find_blocked(state, run.user, module, now, now + AHEAD_NS, clears=clears):
                begins, ends = ((at - now) / 1e9 * state.lab.pace for at in (span.begins, span.ends))
                yield max(0.0, begins), ends

    def _find_left_s(self, run: RunState, index: int, step: PlanStep) -> float:
        for action in self.state.actions.list_in_cell(self.state.runs.plan_of(run).workcell):
            if action.run == run.id and action.step == index and action.status != ActionStatus.UNKNOWN:
                gone_ns = self.now - action.requested_at - find_setup_in_progress(self.state, action)
                return max(self._estimate_s(step) - gone_ns / 1e9 * self.state.lab.pace, LEAST_S)
        return LEAST_S

    def _estimate_s(self, step: PlanStep) -> float:
        pace = self.state.lab.pace
        return round(estimate_at_level(self.state.lengths, step, pace, self.level) / 1e9 * pace, 3)

    def _carry(self, run: RunState, steps: tuple[PlanStep, ...], numbers: dict[int, int]) -> None:
        standing: dict[str, list[int | None]] = {}
        owners = [run_owner(run.id), *([experiment_owner(run.experiment)] if run.experiment else [])]
        for labware in [piece for owner in owners for piece in self.state.bench.list_owned(owner)]:
            if not labware.on:
                for place in list_counted_keys(self.state, labware.station):
                    standing.setdefault(place, []).append(None)
        for index, step in enumerate(steps):
            number = numbers.get(index)
            if number is None:
                continue
            for what in list_carried(step.effects):
                for place in list_counted_keys(self.state, what.emptied):
                    pieces = standing.get(place, [])
                    if is_deck(place) and len(pieces) > 1:
                        pieces.pop()  # the run has the deck until its last piece has left
                    elif pieces:
                        self.stays.append(RoomUse(place, pieces.pop(0), number))
                    elif self._is_standing(place):
                        self._taken[place] = self._taken.get(place, 0) + 1
                        self.stays.append(RoomUse(place, None, number))
                for place in list_counted_keys(self.state, what.filled):
                    standing.setdefault(place, []).append(number)
        # Labware that a run leaves behind stays there without end. Not in an experiment: its next run will
        # fetch it, at an unknown time.
        last = max(numbers.values(), default=None) if run.experiment else None
        for place, pieces in standing.items():
            for first in pieces[:1] if is_deck(place) else pieces:
                self.stays.append(RoomUse(place, first, last))

    def _is_standing(self, place: str) -> bool:
        """Whether labware stands at a place and none of these runs fetches it."""
        name = StationName(split_key(place)[1])
        return not is_deck(place) and self._count_strangers(name) > self._taken.get(place, 0)

    def count_rooms(self) -> dict[str, int]:
        """The room at each place where labware of these runs stands at some time."""
        room: dict[str, int] = {}
        for key in dict.fromkeys(stay.place for stay in self.stays):
            station = find_station(self.state, key)
            if station is None:
                room[key] = 1  # a deck
                continue
            strangers = self._count_strangers(station.spec.name) - self._taken.get(key, 0)
            room[key] = count_room(self.state, station) - strangers
        return room

    def _count_strangers(self, place: StationName) -> int:
        """The number of pieces at a place that neither these runs nor an experiment will carry away."""
        mine = {run_owner(run) for run in self.read_runs}
        mine.update(map(experiment_owner, self.state.experiments.open))
        labware = self.state.bench.labware
        return sum(labware[name].owner not in mine for name in self.state.bench.stations[place].labware)
