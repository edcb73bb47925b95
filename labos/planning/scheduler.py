"""Which steps to start now: evaluated only where something has changed, in a fair order.

A step that cannot start sleeps on the keys whose change may end its wait. Runs that wait to be
let in sleep in bundles of those that wait for the same (see ``waiting``): the cost of a decision
does not grow with the queue.

The scheduler keeps nothing that it could not work out again from the state.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import islice

import msgspec

from labos.core import reasons
from labos.core.decide import Command
from labos.core.decide.cancelling import GiveUpWayOut, TakeWayOut
from labos.core.decide.endings import under_way
from labos.core.effects import list_carried
from labos.core.ids import ExperimentId, InterventionId, ModuleName, RunId, workcell_of
from labos.core.leaving import will_leave
from labos.core.model import Plan
from labos.core.rules import examine
from labos.core.runs import PENDING, SETTLED, RunState, RunStatus, find_holds, options, queue_key
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning import booked
from labos.planning.arrival import check_arrival
from labos.planning.aside import check_may_stay
from labos.planning.choosing import list_changes, options_in_order
from labos.planning.deadlines import Deadlines
from labos.planning.due import UNDATED, DueDates
from labos.planning.obstacle import obstacle
from labos.planning.patience import OvertakeCounts
from labos.planning.pilot import MOST_WAITING, Candidate, Pilot, differ
from labos.planning.reservations import Reservations
from labos.planning.safety import Safety
from labos.planning.setup_order import SetupOrder
from labos.planning.sleepers import Name, Sleepers
from labos.planning.stuck import find_block, find_questions
from labos.planning.suggested import LAST, Adviser
from labos.planning.touch import (
    BEGUN,
    BENCH,
    BOOKING,
    EVERYTHING,
    OVER,
    RUN,
    STANDING,
    Touched,
    cell_key,
    cell_of_closing,
    cell_of_run,
    list_cell_keys,
    near_key,
    sort_keys,
)
from labos.planning.urgency import is_urgent
from labos.planning.waiting import Kind, Turn, WaitingRoom, modules_of
from labos.planning.work_behind import WorkBehind

MOST_BUNDLES = 50
"""So many are asked for what they need: a decision costs no more with a longer queue."""


class StepStart(msgspec.Struct, frozen=True):
    """Start this step of this run; ``plan`` is the one to which it binds a run that has several."""

    run: RunId
    step: int
    plan: str = ""


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
        self.deadlines = Deadlines()
        self.sleepers = Sleepers()
        self.room = WaitingRoom()
        self.patience = OvertakeCounts()
        self.adviser = Adviser()
        self.due_dates = DueDates()
        self.pilot = Pilot()
        self.behind = WorkBehind()
        self.setup_order = SetupOrder()
        self._cells: dict[str, str] = {}
        self._standings: dict[str, tuple[float, float]] = {}
        self._futile: dict[tuple[RunId, str], bool] = {}
        self._futile_at: int | None = None
        self._fresh = True
        self._touched = sort_keys([EVERYTHING])

    def proposals(self, state: LabState, now: int) -> Iterator[StepStart]:
        """Starts that are legal and safe after the last ``note_changes``, one by one. The caller carries each
        one out before it asks for the next."""
        self._standings.clear()
        self.due_dates.forget()
        self.setup_order.forget()
        for spot in self._order(state, self._wake(state, now), now):
            if spot.bundle:
                yield from self._admissions(state, spot.bundle, spot.run, now)
            else:
                # Only now: until it is looked at, others may overtake it.
                self.sleepers.wake((spot.run.id, spot.step))
                wait = self.check_start(state, state.runs.active.get(spot.run.id), spot.step, now)
                if wait is None:
                    self.patience.count_start(state, spot.run, spot.step, self.sleepers)
                    yield StepStart(spot.run.id, spot.step)
                else:
                    self.sleepers.sleep((spot.run.id, spot.step), wait)

    def check_start(
        self,
        state: LabState,
        run: RunState | None,
        step: int,
        now: int,
        *,
        only_asking: bool = False,
        at_once: bool = False,
    ) -> Wait | None:
        """What a step waits for; None if it may start now. Unless the caller is only asking, the
        step is then taken as started. With ``at_once``, a run starts even if its
        next place is not free soon."""
        if run is None:
            return Wait(reasons.Gone())
        self.evaluations += 1
        found = examine(state, run, step, now)
        if isinstance(found, Wait):
            return found
        wait = booked.check_start(state, run, step, now) if state.bookings.open else None
        wait = wait or self.reservations.check_start(state, run, step, now, self.safety)
        if wait is None and state.suggestions.orders and not self._is_overtaken(state, run):
            wait = self.adviser.check_start(state, run, step, now)
        if wait is not None:
            return wait
        queued = not run.has_started
        if queued:
            stuck = find_block(state, run)
            if stuck is not None:
                return stuck  # let in, it would come to a stand on the bench
        if queued or self.safety.changes_anything(state, run, step):
            plan = state.runs.plan_of(run)
            aside = check_may_stay(state, self.safety, run, step)
            if aside is not None:
                return aside
            if queued and run.id not in state.runs.windowed:  # a clock that runs goes before patience
                elder = self._find_protected(state, run, now)
                if elder:
                    # It protects nothing any more once it has to wait for a booking.
                    until = booked.find_room_end(state, RunId(elder), now) if state.bookings.open else None
                    return Wait(reasons.AfterElder(elder), (cell_key(plan.workcell),), until)
                early = None
                if not at_once and not self.adviser.is_time(state, run, step, now):
                    early = check_arrival(state, run, step, now, self._list_plans(state, plan.workcell))
                waited = early is not None and any(
                    run.id == other.id for other in self.room.list_overtaken(state, plan.workcell)
                )
                if early is not None and not waited:
                    return early
                inside = self.patience.keeps_out(state, run, self.sleepers)
                if inside is not None:
                    return Wait(reasons.AfterElder(inside), (near_key(plan.workcell),))
            trapped = self.safety.traps(state, run, step, only_asking=only_asking)
            if trapped:
                self.refusals += 1
                key, itself = plan.steps[step].key, trapped == [str(run.id)]
                why = reasons.NoWayOut(key, run.id) if itself else reasons.Unsafe(key, tuple(trapped))
                return Wait(why, (cell_key(plan.workcell),))
        return None

    def note_changes(self, state: LabState, keys: Iterable[str]) -> None:
        """Take note of the keys of new events, before anything else is asked."""
        self._touched = self._find_touched(state, keys)
        self.deadlines.note_changes(state, self._touched)

    def due(self, state: LabState, now: int) -> Iterator[Command]:
        """What the time that has come asks for, and what becomes of cancelled runs."""
        yield from self.deadlines.due(state, now)
        yield from self._find_ways_out(state)
        yield from list_changes(state, self.safety)

    def _find_ways_out(self, state: LabState) -> list[TakeWayOut | GiveUpWayOut]:
        """Commands for cancelled runs with nothing in flight: they take their way out, or give it up."""
        found: list[TakeWayOut | GiveUpWayOut] = []
        for run in map(state.runs.active.__getitem__, state.runs.ending):
            if under_way(run):
                continue
            if will_leave(state.runs.plan_of(run), run):
                found.append(TakeWayOut(run.id))
            elif run.status == RunStatus.LEAVING and not self.safety.comes_out(state, run):
                found.append(GiveUpWayOut(run.id))
        return found

    def next_deadline(self, state: LabState) -> int | None:
        """When to look again even if nothing happens (UTC ns)."""
        times = (self.deadlines.first(state), self.sleepers.first())
        return min((time for time in times if time is not None), default=None)

    def next_wake(self) -> int | None:
        """When somebody who waits for a time is to be looked at again (UTC ns)."""
        return self.sleepers.first()

    def waits(self, state: LabState, run: RunState, now: int) -> list[tuple[int, Wait]]:
        """Why a run does not go on: (step, wait) for each step whose turn it is."""
        with self.reservations.only_asking():
            found = [
                (step, self.check_start(state, option, step, now, only_asking=True))
                for option in options(run)
                for step in (
                    state.runs.plans[option.plan].starts
                    if not run.has_started
                    else list_ready_steps(state, run)
                )
            ]
        if not run.has_started and any(wait is None for _, wait in found):
            found = self._explain_outside(state, run, now) or found
        if run.choices and not run.has_started:
            possible = any(wait is None for _, wait in found)  # one of its plans is enough
            found = [] if possible else [each for i, each in enumerate(found) if each not in found[:i]]
        return [*find_questions(state, run), *((step, wait) for step, wait in found if wait is not None)]

    # -- waking ------------------------------------------------------------------------------

    def _wake(self, state: LabState, now: int) -> list[Spot]:
        touched, self._touched = self._touched, Touched()
        named = touched.named
        if self._fresh:
            self._fresh = False
            self.room.fill(state)
            self._cells = _cells(state)
        for cell in named.get(BENCH, ()):
            self.safety.forget(state, cell)
            self.pilot.forget(cell)
            self.room.refill(state, cell)
        for cell in named.get(BOOKING, ()):
            self.room.refill(state, cell)
        over = named.get(OVER, ())
        for name in [*over, *self.room.take_emptied()]:
            self.sleepers.forget(name)
        for name in over:
            self.room.forget(RunId(name), self._cells.pop(name, ""))
            self.patience.forget(RunId(name))
        cells = list(state.lab.workcells) if touched.whole else named.get(STANDING, ())
        names: dict[Name, bool] = {(bundle, 0): True for bundle in self.room.follow(state, cells)}
        names.update(dict.fromkeys(self.sleepers.due(now), True))
        for cell in named.get(EVERYTHING, ()):
            inside = state.runs.inside(cell)
            names.update({(run.id, step): True for run in inside for step in list_ready_steps(state, run)})
            names.update({(bundle, 0): True for bundle in self.room.within(cell)})
        for key in touched.keys:
            if key.startswith("run:"):
                names.update(dict.fromkeys(self._list_run_steps(state, RunId(key[4:])), True))
            else:
                names |= self.sleepers.find_waiting(key)
        if touched.whole:
            active = state.runs.active.values()
            names.update({(run.id, step): True for run in active for step in list_ready_steps(state, run)})
            names.update({(bundle, 0): True for bundle in self.room})
        seen: dict[Kind, list[Wait]] = {}
        return [
            spot for spot in (self._look_again(state, name, now, seen) for name in names) if spot is not None
        ]

    def _find_touched(self, state: LabState, keys: Iterable[str]) -> Touched:
        """What the keys stand for, with the workcells of all that is over: the state does not know any more
        in which it was. Notes where what has begun is."""
        if self._fresh:
            return sort_keys([*keys, EVERYTHING])
        touched = sort_keys(keys)
        for kind in (RUN, BEGUN):
            for name in touched.named.get(kind, ()):
                cell = _cell_of(state, name)
                if cell is not None:
                    self._cells[name] = cell
        left = [self._cells.get(name) for name in touched.named.get(OVER, ())]
        if not left:
            return touched
        return sort_keys([*keys, *(key for cell in left for key in _list_keys_of(cell))])

    def _look_again(
        self, state: LabState, name: tuple[str, int], now: int, seen: dict[Kind, list[Wait]]
    ) -> Spot | None:
        """Who is worth a look in turn; a bundle that has to wait anyway sleeps on at once. ``seen``
        keeps what was found for bundles of the same kind."""
        who, step = name
        active = state.runs.active.get(RunId(who))
        if active is not None:
            return Spot(active, step)
        self.sleepers.wake(name)
        if who not in self.room:
            return None
        run = self.room.anybody(state, who)
        if run is None:
            return None
        kind = self.room.kind(who)
        waits = seen.get(kind)
        if waits is None:
            waits = seen[kind] = self._waits_at_start(state, run, now)
        for wait in waits:
            self.sleepers.sleep(name, wait)
        first = self._find_first(state, who, now) if not waits else None
        return Spot(first, 0, who) if first is not None else None

    def _waits_at_start(self, state: LabState, run: RunState, now: int) -> list[Wait]:
        """What each first step of a run has to wait for; nothing if one of them is possible."""
        waits: list[Wait] = []
        for option in options(run):
            for step in state.runs.plans[option.plan].starts:
                self.evaluations += 1
                found = examine(state, option, step, now)
                if not isinstance(found, Wait):
                    return []
                waits.append(found)
        return waits

    def _list_run_steps(self, state: LabState, name: RunId) -> list[tuple[str, int]]:
        active = state.runs.active.get(name)
        if active is not None:
            return [(name, step) for step in list_ready_steps(state, active)]
        queued = state.runs.queued.get(name)
        bundle = self.room.note(state, queued) if queued is not None else ""
        return [(bundle, 0)] if bundle else []

    # -- order -------------------------------------------------------------------------------

    def _order(self, state: LabState, spots: list[Spot], now: int) -> list[Spot]:
        def rank(
            spot: Spot,
        ) -> tuple[int, int, bool, int, int, bool, tuple[float, float], float, int, int, float]:
            run, waits = spot.run, bool(spot.bundle)
            deadline = self.reservations.urgency(state, run, None if waits else spot.step, now)
            behind = 0.0 if waits else -self.behind.measure(state, run.plan, spot.step)
            if not waits and self.patience.is_over(run.id):
                return (deadline, 0, False, 0, 0, False, (0.0, 0.0), UNDATED, 0, run.position, behind)
            calm, share = not is_urgent(state, run, now), self._find_share_used(state, now, run.user)
            orders = state.suggestions.orders
            advised = self.adviser.start_of(state, run, None if waits else spot.step, now) if orders else LAST
            due, change = self._rank_own(state, run, None if waits else spot.step)
            return (
                deadline,
                1,
                calm,
                -run.priority,
                advised,
                waits,
                share,
                due,
                change,
                run.position,
                behind,
            )

        return sorted(spots, key=rank)

    def _is_overtaken(self, state: LabState, run: RunState) -> bool:
        """Whether a run has waited for so long that nobody's advice holds it up."""
        if run.has_started:
            return self.patience.is_over(run.id)
        return run in self.room.list_overtaken(state, state.runs.plan_of(run).workcell)

    def _find_share_used(self, state: LabState, now: int, user: str) -> tuple[float, float]:
        """The lab time that a user's group and the user have had for their weights, worked out once in a
        turn."""
        standing = self._standings.get(user)
        if standing is None:
            standing = self._standings[user] = state.shares.find_share_used(user, now)
        return standing

    def _make_turn_key(self, state: LabState, now: int, run: RunState) -> Turn:
        own = self._rank_own(state, run, None)
        return (
            not is_urgent(state, run, now),
            *self._find_share_used(state, now, run.user),
            *own,
            run.position,
        )

    def _rank_own(self, state: LabState, run: RunState, step: int | None) -> tuple[float, int]:
        """What goes before age among the runs of one user: due dates, and what need not be set up."""
        return self.due_dates.rank(state, run), self.setup_order.rank(state, run, step)

    # -- letting new runs in -----------------------------------------------------------------

    def _find_first(self, state: LabState, bundle: str, now: int) -> RunState | None:
        first = self.room.first(state, bundle, partial(self._make_turn_key, state, now))
        if first is None or not state.suggestions.orders or self._is_overtaken(state, first):
            return first
        return self.adviser.find_next(state, first, now)

    def _admissions(
        self, state: LabState, bundle: str, first: RunState | None, now: int
    ) -> Iterator[StepStart]:
        run = first
        while run is not None:
            start, waits = self._free_start(state, run, now)
            if start is None and any(isinstance(wait.reason, reasons.AfterElder) for wait in waits):
                # Somebody older than the elder need not wait with the others.
                run = self.room.oldest(state, bundle) or run
                start, waits = self._free_start(state, run, now)
            chosen = self._choose(state, run, start, waits, now)
            if not isinstance(chosen, Candidate):
                for wait in chosen:
                    self.sleepers.sleep((bundle, 0), wait)
                return
            run = option = chosen.run
            free = chosen.step
            self.room.let_in(state, option, urgent=is_urgent(state, run, now))
            self.patience.count_start(state, option, free, self.sleepers)
            yield StepStart(run.id, free, option.plan if run.choices else "")
            if run.id in state.runs.queued:
                return  # the start was rejected: to propose it again would be for ever
            run = self._find_first(state, bundle, now)

    def _free_start(
        self, state: LabState, run: RunState, now: int
    ) -> tuple[tuple[RunState, int] | None, list[Wait]]:
        """A run as one of its plans has it, and the first step with which it may be let in; or what each of
        them waits for."""
        waits: list[Wait] = []
        for option in options_in_order(state, run, now):
            for step in self.behind.sort(state, option.plan, state.runs.plans[option.plan].starts):
                wait = self.check_start(state, option, step, now)
                if wait is None:
                    return (option, step), []
                waits.append(wait)
        return None, waits

    def _choose(
        self,
        state: LabState,
        run: RunState,
        start: tuple[RunState, int] | None,
        waits: list[Wait],
        now: int,
        *,
        only_asking: bool = False,
    ) -> Candidate | list[Wait]:
        """The run that starts now: this one if it may ``start``, another of equal rank, or none, and what the
        run waits for then."""
        early = start is None
        if start is None and waits and all(isinstance(wait.reason, reasons.WouldBlock) for wait in waits):
            option = options_in_order(state, run, now)[0]
            start = option, state.runs.plans[option.plan].starts[0]
        if start is None:
            return waits
        option, step = start
        cell = state.runs.plan_of(option).workcell
        first = Candidate(option, step, early=early)
        goes_first = run.id in state.runs.windowed or self._is_overtaken(state, run)
        stands = any(list_carried(each.effects) for each in state.runs.plan_of(option).steps)
        if goes_first or not stands or cell in state.suggestions.orders:
            return waits if early else first  # a run that carries nothing stands in nobody's way
        equals = self._list_equals(state, option, now)
        if len(equals) >= MOST_WAITING or not differ(state, [*state.runs.inside(cell), *equals], option):
            return waits if early else first
        enter = partial(self._find_candidate, state, now=now)
        chosen = self.pilot.choose(state, first, equals, now, enter)
        if isinstance(chosen, Wait):
            return waits if early else [chosen]
        if chosen == first and not early:
            return first
        wait = self.check_start(
            state, chosen.run, chosen.step, now, at_once=chosen.early, only_asking=only_asking
        )
        if wait is not None:
            return waits if early else first
        return chosen

    def _explain_outside(self, state: LabState, run: RunState, now: int) -> list[tuple[int, Wait | None]]:
        """What a run waits for that may start, if the look ahead is against it."""
        for option in options_in_order(state, run, now):
            for step in state.runs.plans[option.plan].starts:
                with self.reservations.only_asking():
                    wait = self.check_start(state, option, step, now, only_asking=True)
                    if wait is None:
                        chosen = self._choose(state, run, (option, step), [], now, only_asking=True)
                        waits = chosen if isinstance(chosen, list) else []
                        return [(step, each) for each in waits]
        return []

    def _find_candidate(self, state: LabState, run: RunState, now: int) -> Candidate | None:
        """The step with which a run may start now; None if there is none."""
        step = state.runs.plans[run.plan].starts[0]
        with self.reservations.only_asking():
            wait = self.check_start(state, run, step, now, only_asking=True)
            if wait is None:
                return Candidate(run, step)
            if isinstance(wait.reason, reasons.WouldBlock):
                wait = self.check_start(state, run, step, now, only_asking=True, at_once=True)
                return Candidate(run, step, early=True) if wait is None else None
        return None

    def _list_equals(self, state: LabState, run: RunState, now: int) -> list[RunState]:
        """The first of the waiting runs in a workcell that differ in rank from this run only by age, the
        oldest first."""
        rank = (run.priority, self._make_turn_key(state, now, run)[:-1])
        cell = state.runs.plan_of(run).workcell
        found: list[RunState] = []
        for bundle in self.room.within(cell)[:MOST_WAITING]:
            for head in self.room.heads(state, bundle):
                if (head.priority, self._make_turn_key(state, now, head)[:-1]) != rank or find_holds(head):
                    continue
                group = state.runs.queue[queue_key(state.runs.shape_of(head), head)]
                found += [state.runs.queued[name] for name in islice(group, MOST_WAITING)]
        found = [other for other in found if other.id != run.id and other.id not in state.runs.windowed]
        return sorted(found, key=lambda other: other.position)

    def _list_plans(self, state: LabState, cell: str) -> Iterator[Plan]:
        """Plans of those who are in a workcell, and of some who wait for it: one of each bundle."""
        yield from map(state.runs.plan_of, state.runs.inside(cell))
        for bundle in self.room.within(cell)[:MOST_BUNDLES]:
            run = self.room.anybody(state, bundle)
            if run is not None:
                yield state.runs.plan_of(run)

    def _find_protected(self, state: LabState, run: RunState, now: int) -> str:
        """The elder run that this run has to stay out for; empty if there is none."""
        plan = state.runs.plans[run.plan]
        mine: set[ModuleName] | None = None
        for elder in self.room.list_overtaken(state, plan.plan.workcell):
            if elder.position >= run.position or find_holds(elder):
                continue
            mine = mine or {step.module for step in plan.plan.steps}
            if mine.isdisjoint(modules_of(state, elder)):
                continue
            if any(self._is_next(state, option, now, bool(plan.windowed)) for option in options(elder)):
                return str(elder.id)
        return ""

    def _is_next(self, state: LabState, elder: RunState, now: int, windowed: bool) -> bool:
        """Whether a run would come in next, with the plan that it has here, if nobody else was let in."""
        first = state.runs.plans[elder.plan].starts[0]
        found = examine(state, elder, first, now)
        if isinstance(found, Wait) and found.blocked:
            return False  # it waits for a person: nobody has to wait with it
        if self._is_hopeless(state, elder):
            return False  # a later step of it does, or what it waits for no run inside moves away
        if state.bookings.open and booked.check_start(state, elder, first, now) is not None:
            return False  # it waits until somebody else's booking is over
        # It may wait for a time: who reserves nothing does not put it off.
        return windowed or not self._is_reserved(state, elder, first, now)

    def _is_hopeless(self, state: LabState, elder: RunState) -> bool:
        """Whether a run could not come to its end in an empty workcell either."""
        if self._futile_at != state.position:
            self._futile_at = state.position
            self._futile.clear()
        known = self._futile.get((elder.id, elder.plan))
        if known is None:
            known = find_block(state, elder) is not None or bool(obstacle(self.safety, state, elder))
            self._futile[elder.id, elder.plan] = known
        return known

    def _is_reserved(self, state: LabState, run: RunState, step: int, now: int) -> bool:
        return self.reservations.check_start(state, run, step, now, self.safety) is not None


def list_ready_steps(state: LabState, run: RunState) -> list[int]:
    """Steps whose turn it is: pending, with everything before them done."""
    plan, steps = state.runs.plan_of(run), run.steps
    found: list[int] = []
    for index, step in enumerate(steps):
        if step.status is PENDING:
            for before in plan.steps[index].after:
                if steps[before].status not in SETTLED:
                    break
            else:
                found.append(index)
    return found


def _list_keys_of(cell: str | None) -> tuple[str, ...]:
    """What is touched when something is over that was in a workcell; in none if it is empty, None if nobody
    knows."""
    if cell is None:
        return (EVERYTHING,)
    return list_cell_keys(cell) if cell else ()


def _cells(state: LabState) -> dict[str, str]:
    """The workcells of all runs, experiments and questions that are not over, by their names; empty for
    what is in none."""
    runs = state.runs
    names = [*runs.active, *runs.queued, *state.experiments.open, *state.interventions.open]
    found = ((name, _cell_of(state, name)) for name in names)
    return {name: cell for name, cell in found if cell is not None}


def _cell_of(state: LabState, name: str) -> str | None:
    """The workcell of a run, an experiment or a question; empty if it is in none, None if it is over, or
    nobody can tell."""
    question = state.interventions.open.get(InterventionId(name))
    if question is not None:
        about = question.module or (question.subject if "/" in question.subject else "")
        return workcell_of(ModuleName(about)) or cell_of_run(state, question.run) or None
    if ExperimentId(name) in state.experiments.open:
        return cell_of_closing(state, name)
    return cell_of_run(state, name) or None


__all__ = ["Scheduler", "StepStart", "list_ready_steps"]
