"""Reservations: what is kept free for steps with a running clock.

A reservation lasts from the start of the step that starts a window's clock to the start of the windowed step.
It covers the modules, stations and zones that the run needs on the way to that step. A start of another run
waits if it would still occupy one of them at the latest time at which the run needs it.

A reservation is soft. It ends with its window. It never stops its own run or experiment, or a run that has to
move first so that its own run can continue. If two reservations need the same resource, the one with the
earlier deadline goes first. So the reservation with the earliest deadline stops no run on which it depends,
and no run waits for longer than a window.

Durations vary, so reservations keep a margin: they count the longest durations. The plan in ``keeping`` keeps
windows by usual durations, also where there is no room for a margin. Its starts go before all reservations.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import msgspec

from labos.core import reasons
from labos.core.actions import Action
from labos.core.booked import find_begun_booking
from labos.core.effects import list_carried
from labos.core.ids import ModuleName, RunId, module_key, split_key, workcell_of, zone_key
from labos.core.rules import convert_lab_s
from labos.core.runs import IN_FLIGHT, SETTLED, UNKNOWN, RunState, RunStatus, find_holds
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested
from labos.core.waits import Wait
from labos.core.zones import find_zones
from labos.planning.forecast import (
    find_deadline,
    find_earliest_start,
    find_latest_starts,
    find_longest_time,
    find_pending_before,
    find_run,
    find_setup_in_progress,
    find_spread,
    find_usual_time,
    is_pending,
    list_clocked,
    list_uses,
)
from labos.planning.helpers import Helpers, find_helpers
from labos.planning.keeping import CALM_S, Windows
from labos.planning.layout import is_down
from labos.planning.player import FAR
from labos.planning.safety import Safety
from labos.planning.taken import find_station
from labos.planning.touch import cell_key, window_key

NEVER = 2**63 - 1
"""A time that never comes (UTC ns)."""


class Need(msgspec.Struct, frozen=True):
    """A step needs a resource (the key of a module, station or zone): from ``release`` at the earliest, from
    ``latest`` at the latest (both UTC ns), and for ``length`` (ns)."""

    resource: str
    step: int
    release: int
    latest: int
    length: int


class Reservation(msgspec.Struct, frozen=True):
    """What a run needs so that ``step`` starts by its ``deadline`` (UTC ns). ``chain`` are the steps that
    have not started yet, the windowed one last. ``position`` is the run's, for its age."""

    run: RunId
    step: int
    deadline: int
    position: int
    chain: tuple[int, ...]
    needs: tuple[Need, ...]


class AskedStart(msgspec.Struct, frozen=True):
    """A start of a step that is checked, and the open reservations of its workcell."""

    state: LabState
    run: RunState
    step: int
    now: int
    reservations: Sequence[Reservation]


class Reservations:
    """The reservations of one state after the other. They are computed once for each workcell and position of
    the log. ``refusals`` counts the starts that had to wait."""

    def __init__(self, safety: Safety, own: Mapping[str, OrderSuggested]) -> None:
        self.refusals = 0
        self._safety, self._own = safety, own
        self.windows = Windows(safety, own)
        self._position: dict[str, int] = {}
        self._all: dict[str, list[Reservation]] = {}
        self._urgent: dict[str, dict[tuple[RunId, int], int]] = {}
        self._helpers: dict[tuple[RunId, int], Helpers] = {}
        self._helpers_at: tuple[int, int] | None = None

    def list_open(self, state: LabState, now: int, cell: str) -> list[Reservation]:
        """The reservations of a workcell whose window is open, the earliest deadline first."""
        if not state.runs.windowed_in.get(cell):
            return []
        if self._position.get(cell) != state.position:
            self._position[cell] = state.position
            self._work_out(state, now, cell)
        return [found for found in self._all[cell] if now <= found.deadline]

    def find_latest_start(self, state: LabState, run: RunState, step: int | None, now: int) -> int:
        """The time by which a step has to start (UTC ns); NEVER if it has no deadline. For a queued run,
        ``step`` is None, and the earliest such time of its steps counts."""
        if run.id not in state.runs.windowed:
            return NEVER
        cell = state.runs.plan_of(run).workcell
        self.list_open(state, now, cell)
        urgent = self._urgent.get(cell, {})
        if step is None:
            return min((at for (name, _), at in urgent.items() if name == run.id), default=NEVER)
        late = find_deadline(state, run, step)
        return min(urgent.get((run.id, step), NEVER), NEVER if late is None else late)

    @contextmanager
    def forget_afterwards(self) -> Iterator[None]:
        """Forget afterwards what ``windows`` finds here: a question must not change a later decision."""
        kept, self.windows = self.windows, Windows(self._safety, self._own)
        self.windows.remember(kept)
        try:
            yield
        finally:
            self.windows = kept

    def check_start(self, state: LabState, run: RunState, step: int, now: int) -> Wait | None:
        """What a start waits for because of reservations and windows; None if it may go ahead. The rules must
        allow the start."""
        planned = self.windows.find_planned_start(state, run, step, now)
        if planned <= now:
            return None
        reservations = self.list_open(state, now, state.runs.plan_of(run).workcell)
        asked = AskedStart(state, run, step, now, reservations)
        wait = self._check_reservations(asked) or self._check_in_time(asked)
        wait = wait or self.windows.check_start(state, run, step, now)
        self.refusals += wait is not None
        if wait is not None and planned < FAR and (wait.until is None or planned < wait.until):
            return msgspec.structs.replace(wait, until=planned)  # no event marks that time
        return wait

    # -- starts that would block a reservation -------------------------------------------------

    def _check_reservations(self, asked: AskedStart) -> Wait | None:
        state, run, now = asked.state, asked.run, asked.now
        taken: dict[str, int] = {}
        for number, found in enumerate(asked.reservations, 1):
            if found.run == run.id or _is_same_experiment(state, found.run, run):
                continue
            taken = taken or list_uses(state, run, asked.step, now)
            for need in found.needs:
                time = taken.get(need.resource)
                if time is not None and now + time > need.latest:
                    if self._helps_reservation(asked, asked.reservations[:number]):
                        return None
                    return self._wait(state, found, need, now)
        return None

    def _helps_reservation(self, asked: AskedStart, reservations: Sequence[Reservation]) -> bool:
        """Whether a start helps one of these reservations: its step is in the chain, or its run has to move
        out of the way first."""
        for found in reservations:
            if found.run == asked.run.id:
                if asked.step in found.chain:
                    return True
            elif self._find_helpers_for(asked, found).include(asked.state, asked.run):
                return True
        return False

    def _find_helpers_for(self, asked: AskedStart, found: Reservation) -> Helpers:
        state, now = asked.state, asked.now
        if self._helpers_at != (state.position, now):
            self._helpers_at = (state.position, now)
            self._helpers.clear()
        key = (found.run, found.step)
        known = self._helpers.get(key)
        if known is None:
            run = find_run(state, found.run)
            known = self._helpers[key] = find_helpers(state, run, found.chain, now, self._safety)
        return known

    def _wait(self, state: LabState, found: Reservation, need: Need, now: int) -> Wait:
        plan = state.runs.plan_of(find_run(state, found.run))
        times = [at for helpers in self._helpers.values() for at in helpers.times if at > now]
        return Wait(
            reasons.Reserved(split_key(need.resource)[1], str(found.run), plan.steps[need.step].key),
            (cell_key(plan.workcell), window_key(found.run), *{need.resource: True for need in found.needs}),
            until=min([*times, found.deadline + 1]),
        )

    # -- clocks that should not start yet ------------------------------------------------------

    def _check_in_time(self, asked: AskedStart) -> Wait | None:
        """What a step waits for that would start a clock. It waits while the reservations of other runs and
        the actions in flight leave no room for the step that has to follow in time."""
        state, run, step, now = asked.state, asked.run, asked.step, asked.now
        plan = state.runs.plans[run.plan]
        followers = list_clocked(plan, step)
        if not followers:
            return None
        others = [found for found in asked.reservations if found.run != run.id]
        foreseen = {step: now + find_usual_time(state, plan.plan.steps[step])}
        for index in followers:
            mine = _make_reservation(state, run, index, now, foreseen)
            if mine is None:
                continue
            for resource in {need.resource: True for need in mine.needs}:
                flying = _list_needs_in_flight(state, resource, now)
                theirs = [job for found in others for job in _list_jobs(found, resource, now)]
                ours, room = _list_jobs(mine, resource, now), _find_room(state, resource)
                together = _count_late([*flying, *theirs, *ours], room)
                if together <= _count_late([*flying, *theirs], room) + _count_late(ours, room):
                    continue
                if self._helps_reservation(asked, asked.reservations):
                    return None
                rivals = [found for found in others if any(n.resource == resource for n in found.needs)]
                if rivals:
                    need = next(n for n in rivals[0].needs if n.resource == resource)
                    return self._wait(state, rivals[0], need, now)
                key = plan.plan.steps[index].key
                end = max(job.length for job in flying) + now
                _, name = split_key(resource)
                # The start need not wait until the action ends and its labware leaves. It is enough if both
                # happen before the following step needs the module.
                leaves = end + _measure_clearing(state, resource)
                again = max(now + convert_lab_s(state, CALM_S), now + _measure_lateness(ours, leaves))
                return Wait(
                    reasons.NotInTime(name, key), (resource, cell_key(plan.plan.workcell)), min(end, again)
                )
        return None

    # -- computing -----------------------------------------------------------------------------

    def _work_out(self, state: LabState, now: int, cell: str) -> None:
        all_ = self._all[cell] = []
        urgent = self._urgent[cell] = {}
        for name in state.runs.windowed_in[cell]:
            run = state.runs.get(name)
            if run is None or find_holds(run) or run.status == RunStatus.CANCELLING or run.has(UNKNOWN):
                continue
            for index in state.runs.plans[run.plan].windowed:
                if is_pending(run, index) and not run.is_breached(index):
                    found = _make_reservation(
                        state, run, index, now, _find_anchors_in_flight(state, run, index)
                    )
                    if found is not None:
                        all_.append(found)
        all_.sort(key=lambda found: (found.deadline, found.position, found.step))
        for found in all_:
            for need in found.needs:
                key = (found.run, need.step)
                urgent[key] = min(urgent.get(key, NEVER), need.latest)


def _find_anchors_in_flight(state: LabState, run: RunState, index: int) -> dict[int, int]:
    """The expected ends (UTC ns) of the steps in flight that start clocks of a step."""
    windows = state.runs.plan_of(run).steps[index].windows
    anchors = {window.anchor for window in windows if window.anchor is not None}
    if not any(run.steps[step].status == IN_FLIGHT for step in anchors if run.has_started):
        return {}
    return {
        action.step: end
        for action, end in _list_in_flight(state, state.runs.plan_of(run).workcell)
        if action.run == run.id and action.step in anchors and run.steps[action.step].status == IN_FLIGHT
    }


def _list_in_flight(state: LabState, cell: str) -> Iterator[tuple[Action, int]]:
    """The actions in flight in a workcell, and the end of each by its longest duration (UTC ns)."""
    for action in state.actions.list_in_cell(cell):
        run = state.runs.active.get(action.run)
        if run is not None:
            takes = find_longest_time(state, state.runs.plan_of(run).steps[action.step])
            yield action, action.requested_at + takes + find_setup_in_progress(state, action)


def _make_reservation(
    state: LabState, run: RunState, index: int, now: int, foreseen: dict[int, int] | None = None
) -> Reservation | None:
    """What a run needs for a windowed step. None if no clock runs for the step, or if the run cannot go on by
    itself. ``foreseen`` are the expected ends of steps that start clocks (UTC ns): these count as ended."""
    known = dict(foreseen or {})
    plan = state.runs.plan_of(run)
    # A step that ends earlier than expected starts its clock earlier.
    sooner = {step: max(now, at - find_spread(state, plan.steps[step])) for step, at in known.items()}
    end, last = find_deadline(state, run, index, sooner), find_deadline(state, run, index, known)
    if end is None or last is None:
        return None
    chain = find_pending_before(run, plan, index)
    if foreseen:
        over = {before for step in foreseen for before in find_pending_before(run, plan, step)}
        chain = [step for step in chain if step not in over]
    if any(is_down(state, plan.steps[step].module) for step in chain):
        return None
    if find_begun_booking(state, run, [plan.steps[step] for step in chain]) is not None:
        return None
    latest = find_latest_starts(state, plan, chain, end, find_longest_time)
    needs: list[Need] = []
    for step in chain:
        begin = max(
            now,
            find_earliest_start(state, run, step, known),
            *(known.get(before, 0) for before in plan.steps[step].after),
        )
        known[step] = begin + find_longest_time(state, plan.steps[step])
        for resource, time in list_uses(state, run, step, begin).items():
            needs.append(Need(resource, step, begin, latest[step], time))
    # A short window has no room for this margin. Then the deadline moves later: at most to the one that
    # counts from the expected end of the anchor.
    late = min(max([0, *(need.release - need.latest for need in needs)]), last - end)
    if late:
        needs = [msgspec.structs.replace(need, latest=need.latest + late) for need in needs]
    return Reservation(run.id, index, end + late, run.position, tuple(chain), tuple(needs))


def _list_jobs(found: Reservation, resource: str, now: int) -> list[Need]:
    """A run's needs of a resource. Needs without a gap between them are joined."""
    jobs: list[Need] = []
    for need in sorted((n for n in found.needs if n.resource == resource), key=lambda n: n.release):
        need = msgspec.structs.replace(need, release=max(need.release, now))
        last = jobs[-1] if jobs else None
        if last is not None and need.release <= last.release + last.length:
            end = max(last.release + last.length, need.release + need.length)
            jobs[-1] = msgspec.structs.replace(last, length=end - last.release)
        else:
            jobs.append(need)
    return jobs


def _list_needs_in_flight(state: LabState, resource: str, now: int) -> list[Need]:
    """The actions in flight on a module or in a zone, as needs from now to their expected ends."""
    cell = workcell_of(ModuleName(split_key(resource)[1]))
    return [
        Need(resource, action.step, now, now, end - now)
        for action, end in _list_in_flight(state, cell)
        if end > now and action.exclusive and resource in _list_taken(state, action)
    ]


def _measure_clearing(state: LabState, resource: str) -> int:
    """The time to carry labware away from a module after the action in flight there has ended (ns)."""
    cell = workcell_of(ModuleName(split_key(resource)[1]))
    found = 0
    for action, _ in _list_in_flight(state, cell):
        if resource == module_key(action.module):
            steps = state.runs.plan_of(state.runs.active[action.run]).steps
            after = (step for step in steps if action.step in step.after and list_carried(step.effects))
            found = max([found, *(find_longest_time(state, step) for step in after)])
    return found


def _list_taken(state: LabState, action: Action) -> list[str]:
    zones = find_zones(state, action.module, action.effects)
    return [module_key(action.module), *map(zone_key, zones)]


def _find_room(state: LabState, resource: str) -> int:
    """The number of runs that may have a resource at the same time. At a station with several places, labware
    that does not leave it next takes up a place."""
    station = find_station(state, resource)
    if station is None or station.spec.capacity < 2:
        return 1
    leaving = 0
    for run in state.runs.list_inside(workcell_of(station.spec.name)):
        steps = state.runs.plan_of(run).steps
        for step, at in zip(steps, run.steps, strict=True):
            if at.status not in SETTLED and all(run.steps[before].status in SETTLED for before in step.after):
                leaving += any(what.emptied == station.spec.name for what in list_carried(step.effects))
    return max(1, station.spec.capacity - max(0, station.count - leaving))


def _count_late(jobs: Sequence[Need], room: int) -> int:
    """The number of these needs that are late if at most ``room`` have the resource at a time. They are taken
    in the better of two orders: by deadline, or by release."""

    def count(order: list[Need]) -> int:
        free_at, late = [0] * room, 0
        for job in order:
            time = max(heapq.heappop(free_at), job.release)
            late += time > job.latest
            heapq.heappush(free_at, time + job.length)
        return late

    by_deadline = sorted(jobs, key=lambda job: job.latest)
    as_they_come = sorted(jobs, key=lambda job: (job.release, job.latest))
    return min(count(by_deadline), count(as_they_come))


def _measure_lateness(jobs: Sequence[Need], begin: int) -> int:
    """The most by which one of these needs is late (ns) if they follow one another and none begins before
    ``begin`` (UTC ns)."""
    worst, time = 0, begin
    for job in sorted(jobs, key=lambda job: job.release):
        time = max(time, job.release)
        worst = max(worst, time - job.latest)
        time += job.length
    return worst


def _is_same_experiment(state: LabState, name: RunId, run: RunState) -> bool:
    other = state.runs.get(name)
    return other is not None and bool(run.experiment) and other.experiment == run.experiment
