"""The scheduler: proposes which steps start now, in a fair order. It checks only where something has changed.

A step that cannot start waits for the keys whose change may end its wait (see ``wait_list``). Queued runs
that wait for the same things wait together, in bundles (see ``waiting``). So the cost of a decision does not
grow with the queue.

The scheduler can compute again from the state what it keeps, with three exceptions: the orders that it has
found, the counts of overtakings, and since when steps wait for an order. They decide which step goes first.
No rule of safety depends on them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from types import MappingProxyType

import msgspec

from labos.core import reasons
from labos.core.decide import Command
from labos.core.decide.actions import StartStep
from labos.core.decide.cancelling import GiveUpWayOut, TakeWayOut
from labos.core.decide.endings import has_open_action
from labos.core.decide.together import StartTogether
from labos.core.ids import (
    ActionId,
    ExperimentId,
    InterventionId,
    ModuleName,
    RunId,
    workcell_of,
)
from labos.core.leaving import will_leave
from labos.core.model import Plan
from labos.core.rules import examine
from labos.core.runs import RunState, RunStatus, list_options
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning import booked
from labos.planning.admission import Admission
from labos.planning.alarms import find_earliest
from labos.planning.arrival import check_arrival
from labos.planning.aside import check_should_stay
from labos.planning.choosing import list_changes
from labos.planning.companions import check_for_others, find_companions, put_last
from labos.planning.deadlines import Deadlines
from labos.planning.elders import Elders
from labos.planning.forecast import list_ready_steps
from labos.planning.own_order import BEFORE_START, OwnOrder, OwnOrders
from labos.planning.patience import OvertakeCounts
from labos.planning.pilot import Candidate
from labos.planning.ranking import Ranking, ReadyStart
from labos.planning.reservations import Reservations
from labos.planning.safety import Safety
from labos.planning.stuck import find_block, find_questions
from labos.planning.suggested import Adviser
from labos.planning.supplies import Spares
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
    find_cell_of_closing,
    find_cell_of_run,
    list_cell_keys,
    near_key,
    sort_keys,
)
from labos.planning.urgency import is_urgent
from labos.planning.wait_list import Name, WaitList
from labos.planning.waiting import PATIENCE, Kind, WaitingRoom
from labos.planning.window_order import MOST_WAITING, WindowOrders

MOST_BUNDLES = 50
"""The most bundles of a workcell whose plans are read, so that the cost of a decision has a limit."""


class StepStart(msgspec.Struct, frozen=True):
    """A proposal to start a step of a run. ``plan`` is the plan to which a run with several plans is bound,
    else empty. ``others`` are the steps of other runs that start together with it: (run, step)."""

    run: RunId
    step: int
    plan: str = ""
    others: tuple[tuple[RunId, int], ...] = ()

    def make_command(self, name_action: Callable[[], ActionId], now: int) -> Command:
        """The command that requests the start, with a new id for each action."""
        steps = ((self.run, self.step), *self.others)
        commands = [StartStep(run, step, name_action(), now, self.plan) for run, step in steps]
        return commands[0] if len(commands) == 1 else StartTogether(tuple(commands))


class Scheduler:
    """Proposes starts for one state that only moves forward. After a refold, make a new scheduler. Without
    ``own`` it does not search for the lab's own order of all steps."""

    def __init__(self, own: OwnOrders | None = None) -> None:
        self.safety = Safety()
        self.window_orders = WindowOrders(PATIENCE)
        self.reservations = Reservations(self.safety, self.window_orders.orders)
        self.evaluations = 0
        self.refusals = 0
        self.deadlines = Deadlines()
        self.wait_list = WaitList()
        self.room = WaitingRoom()
        self.patience = OvertakeCounts()
        self.adviser = Adviser(own, self.window_orders.orders)
        self.ranking = Ranking(self.reservations, self.adviser)
        self.elders = Elders(self.room, self.safety, self.reservations)
        self.admission = Admission(
            self.room, self.reservations, self.ranking, self.adviser, self.window_orders, self.check_start
        )
        self._cells: dict[str, str] = {}
        self._seen: dict[Kind, list[Wait]] = {}
        self._seen_at = (0, 0)
        self._spares = Spares()
        self._fresh = True
        self._touched = sort_keys([EVERYTHING])

    def iterate_proposals(self, state: LabState, now: int) -> Iterator[StepStart]:
        """The starts that are legal and safe after the last ``note_changes``, one by one. The caller carries
        each start out before it asks for the next one."""
        self.ranking.forget()
        for start in put_last(state, self.ranking.sort(state, self._wake(state, now), self.patience, now)):
            if start.bundle:
                yield from self._admit_runs(state, start.bundle, start.run, now)
            else:
                yield from self._start_step(state, start, now)

    def _start_step(self, state: LabState, start: ReadyStart, now: int) -> Iterator[StepStart]:
        """Propose a step of an active run. If the step has to wait, its wait is listed instead."""
        run = start.run
        # Its wait is removed only now: starts of other runs before this check count as overtaking it.
        self.wait_list.remove((run.id, start.step))
        wait = self.check_start(state, state.runs.active.get(run.id), start.step, now)
        if wait is not None:
            self.wait_list.add((run.id, start.step), wait)
            return
        others = find_companions(state, run, start.step, now)
        for each, step in ((run, start.step), *others):
            self.wait_list.remove((each.id, step))
            self.patience.count_start(state, each, step, self.wait_list)
        yield StepStart(run.id, start.step, others=tuple((each.id, step) for each, step in others))

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
        """The wait of a step; None if it may start now. A step that may start counts as started from then
        on, except with ``only_asking``. With ``at_once``, a queued run may start even if its second place
        is not free soon."""
        if run is None:
            return Wait(reasons.Gone())
        is_alone = run.has_started or run.choices or len(state.runs.plans[run.plan].starts) > 1
        bundle = "" if is_alone or only_asking else self.room.find_bundle(state, run)
        for known in self._find_waits_at_start(state, bundle, run, now) if bundle else ():
            return known
        self.evaluations += 1
        companions = find_companions(state, run, step, now)
        if not bundle:
            found = examine(state, run, step, now, [other.id for other, _ in companions])
            if isinstance(found, Wait):
                return found
        wait = self._check_time(state, run, step, now)
        if wait is None:
            outside = self._list_plans_outside(state, state.runs.plan_of(run).workcell)
            wait = check_for_others(state, run, step, companions, outside, now)
        is_outside = not run.has_started
        if wait is None and is_outside:
            wait = find_block(state, run)  # after its start it would be blocked on the bench
        if wait is None and (is_outside or self.safety.changes_anything(state, run, step)):
            wait = check_should_stay(state, self.safety, run, step)
            if wait is None and is_outside and run.id not in state.runs.windowed:
                wait = self._check_others(state, run, step, now, at_once=at_once)
            if wait is None:
                wait = self._check_safety(state, run, step, only_asking=only_asking)
        return wait

    def _check_time(self, state: LabState, run: RunState, step: int, now: int) -> Wait | None:
        """The wait of a step whose time has not come, because of bookings, windows or orders."""
        wait = booked.check_start(state, run, step, now) if state.bookings.open else None
        wait = wait or self.reservations.check_start(state, run, step, now)
        if wait is None and self.adviser.has_orders(state) and not self._is_overtaken(state, run):
            cell = state.runs.plan_of(run).workcell
            follows_order = partial(self.reservations.windows.follows_order, state, cell, now)
            wait = self.adviser.check_start(state, run, step, now, follows_order)
        return wait

    def _check_others(
        self, state: LabState, run: RunState, step: int, now: int, *, at_once: bool
    ) -> Wait | None:
        """The wait of a queued run without a running clock. It waits for an older run, queued or inside, that
        was overtaken too often; or for its second place, if that is not free soon."""
        cell = state.runs.plan_of(run).workcell
        elder = self.elders.find_protected(state, run, now)
        if elder:
            # From the time at which the elder run has to wait for a booking, it is not protected any more.
            until = booked.find_next_collision(state, RunId(elder), now) if state.bookings.open else None
            return Wait(reasons.AfterElder(elder), (cell_key(cell),), until)
        if not at_once and self.adviser.start_of(state, run, step, now) > now:
            early = check_arrival(state, run, step, now, self._list_plans(state, cell))
            if early is not None and not self.room.is_overtaken(state, run):
                return self.adviser.wake_in_time(state, run, step, early, now)
        inside = self.patience.find_run_that_goes_first(state, run, self.wait_list)
        return Wait(reasons.AfterElder(inside), (near_key(cell),)) if inside is not None else None

    def _check_safety(self, state: LabState, run: RunState, step: int, *, only_asking: bool) -> Wait | None:
        """The wait of a step after whose start a run or an experiment could not reach its end."""
        # Whether a run outside is blocked was checked before.
        is_blocked = None if run.has_started else False
        trapped = self.safety.list_trapped(state, run, step, only_asking=only_asking, is_blocked=is_blocked)
        if not trapped:
            return None
        self.refusals += 1
        plan = state.runs.plan_of(run)
        key, is_itself = plan.steps[step].key, trapped == [str(run.id)]
        why = reasons.NoWayOut(key, run.id) if is_itself else reasons.Unsafe(key, tuple(trapped))
        return Wait(why, (cell_key(plan.workcell),))

    def note_changes(self, state: LabState, keys: Iterable[str]) -> None:
        """Note what the keys of new events touch. Call this before any other method."""
        self._touched = self._find_touched(state, keys)
        self.deadlines.note_changes(state, self._touched)

    def iterate_due(self, state: LabState, now: int) -> Iterator[Command]:
        """The commands for times that have come, for cancelled runs, and for runs that change their plan."""
        yield from self.deadlines.iterate_due(state, now)
        if state.runs.ending:
            yield from self._find_ways_out(state)
        yield from list_changes(state, self.safety)

    def _find_ways_out(self, state: LabState) -> list[TakeWayOut | GiveUpWayOut]:
        """The commands for cancelled runs without an action in flight: carry out the ``on_cancel`` steps, or
        give them up if the run cannot reach its end."""
        found: list[TakeWayOut | GiveUpWayOut] = []
        for run in map(state.runs.active.__getitem__, state.runs.ending):
            if has_open_action(run):
                continue
            if will_leave(state.runs.plan_of(run), run):
                found.append(TakeWayOut(run.id))
            elif run.status == RunStatus.LEAVING and not self.safety.can_reach_end(state, run):
                found.append(GiveUpWayOut(run.id))
        return found

    def find_next_deadline(self, state: LabState) -> int | None:
        """The time of the next check even if nothing happens (UTC ns); None if there is none."""
        return find_earliest(self.deadlines.find_first(state), self.find_next_wake())

    def find_next_wake(self) -> int | None:
        """The time at which a wait ends by itself, or a search for an order continues (UTC ns); None if
        there is none."""
        return find_earliest(self.wait_list.find_first(), self.window_orders.find_next_look())

    def list_waits(self, state: LabState, run: RunState, now: int) -> list[tuple[int, Wait]]:
        """Why a run does not continue: (step, wait) for each step whose turn it is, and for each failed step
        about which a person has to decide."""
        with self.reservations.forget_afterwards():
            found = [
                (step, self.check_start(state, option, step, now, only_asking=True))
                for option in list_options(run)
                for step in (
                    state.runs.plans[option.plan].starts
                    if not run.has_started
                    else list_ready_steps(state, run)
                )
            ]
        if not run.has_started and any(wait is None for _, wait in found):
            found = [*self.admission.explain(state, run, now)] or found
        if run.choices and not run.has_started:
            possible = any(wait is None for _, wait in found)  # one plan that may start is enough
            found = [] if possible else [each for i, each in enumerate(found) if each not in found[:i]]
        return [*find_questions(state, run), *((step, wait) for step, wait in found if wait is not None)]

    # -- waking ------------------------------------------------------------------------------

    def _wake(self, state: LabState, now: int) -> list[ReadyStart]:
        touched, self._touched = self._touched, Touched()
        named = touched.named
        if self._fresh:
            self._fresh = False
            self.room.fill(state)
            self._cells = _cells(state)
        for cell in named.get(BENCH, ()):
            self.safety.forget(state, cell)
            self.admission.pilot.forget(cell)
            self.adviser.own.forget(cell)
            self.window_orders.forget(cell)
            self.patience.forget_keys()
            self.room.refill(state, cell)
        for cell in named.get(BOOKING, ()):
            self.room.refill(state, cell)
        over = named.get(OVER, ())
        for name in [*over, *self.room.take_emptied()]:
            self.wait_list.forget(name)
        for name in over:
            self.room.forget(RunId(name), self._cells.pop(name, ""))
            self.patience.forget(RunId(name))
        cells = list(state.lab.workcells) if touched.whole else named.get(STANDING, ())
        names: dict[Name, bool] = {}
        if cells:
            names.update({(bundle, 0): True for bundle in self.room.follow(state, cells)})
        names.update(dict.fromkeys(self.wait_list.list_due(now), True))
        for cell in named.get(EVERYTHING, ()):
            names |= self._list_all(state, cell)
        for key in touched.keys:
            if run := touched.runs.get(key):
                names.update(dict.fromkeys(self._list_run_steps(state, run), True))
            elif waiting := self.wait_list.find_waiting(key):
                names |= waiting
        if touched.whole:
            active = state.runs.active.values()
            names.update({(run.id, step): True for run in active for step in list_ready_steps(state, run)})
            names.update({(bundle, 0): True for bundle in self.room})
        for cell in self._list_cells(state, names) if self.adviser.own.is_used else ():
            if self.admission.find_order(state, cell, now):
                names |= self.wait_list.find_waiting(cell_key(cell))  # other steps may go first now
        for cell in self._order_windows(state, names, now):
            names |= self._list_all(state, cell)
        return [
            start for start in (self._look_again(state, name, now) for name in names) if start is not None
        ]

    def _list_cells(self, state: LabState, names: Iterable[Name]) -> list[str]:
        """The workcells of these steps and bundles."""
        found: dict[str, bool] = {}
        for who, _ in names:
            run = state.runs.active.get(RunId(who))
            found[state.runs.plan_of(run).workcell if run is not None else self.room.find_cell(who)] = True
        return [cell for cell in found if cell]

    def _list_all(self, state: LabState, cell: str) -> dict[Name, bool]:
        """The steps of a workcell whose turn it is, and its bundles."""
        inside = state.runs.list_inside(cell)
        names: dict[Name, bool] = {
            (run.id, step): True for run in inside for step in list_ready_steps(state, run)
        }
        return names | {(bundle, 0): True for bundle in self.room.list_in_cell(cell)}

    def _order_windows(self, state: LabState, names: Iterable[Name], now: int) -> list[str]:
        """Update the lab's own order in each workcell where clocks run, or will run. Returns the workcells
        whose order has changed. ``names`` are the steps and bundles that are checked now."""
        orders = self.window_orders
        if not (orders.orders or state.runs.windowed or self.adviser.own.is_used):
            return []
        cells = dict.fromkeys(cell for cell, runs in state.runs.windowed_in.items() if runs)
        if self.adviser.own.is_used:
            touched = (*orders.orders, *self._list_cells(state, names))
            cells |= dict.fromkeys(cell for cell in touched if self._will_start_clocks(state, cell))
        for cell in [cell for cell in orders.orders if cell not in cells]:
            orders.drop(cell)
        changed: list[str] = []
        for cell in cells:
            waiting = self.admission.list_next(state, cell, MOST_WAITING, now)
            if orders.update(state, cell, waiting, partial(self.room.count_overtakings, cell), now):
                changed.append(cell)
        return changed

    def _will_start_clocks(self, state: LabState, cell: str) -> bool:
        """Whether a workcell is empty, and runs with windows wait for it. Only one queued run is checked."""
        if state.runs.list_inside(cell):
            return False
        bundles = self.room.list_in_cell(cell)
        run = self.room.find_any_run(state, bundles[0]) if bundles else None
        return run is not None and bool(state.runs.plans[run.plan].windowed)

    def _find_touched(self, state: LabState, keys: Iterable[str]) -> Touched:
        """What the keys touch, with the workcells of runs, experiments and questions that have ended. The
        state has no workcell for these any more, so it is noted when they begin."""
        if self._fresh:
            return sort_keys([*keys, EVERYTHING])
        touched = sort_keys(keys)
        for kind in (RUN, BEGUN):
            for name in touched.named.get(kind, ()):
                cell = _find_cell(state, name)
                if cell is not None:
                    self._cells[name] = cell
        left = [self._cells.get(name) for name in touched.named.get(OVER, ())]
        if not left:
            return touched
        return sort_keys([*keys, *(key for cell in left for key in _list_keys_of(cell))])

    def _look_again(self, state: LabState, name: tuple[str, int], now: int) -> ReadyStart | None:
        """What to check for a name: the step of an active run, or the first run of a bundle. None if the
        bundle is gone, or if it has to wait by the rules. The wait of a bundle is listed again at once."""
        who, step = name
        active = state.runs.active.get(RunId(who))
        if active is not None:
            return ReadyStart(active, step)
        self.wait_list.remove(name)
        if who not in self.room:
            return None
        run = self.room.find_any_run(state, who)
        if run is None:
            return None
        waits = self._find_waits_at_start(state, who, run, now)
        for wait in waits:
            self.wait_list.add(name, wait)
        first = self.admission.find_first(state, who, now) if not waits else None
        return ReadyStart(first, 0, who) if first is not None else None

    def _find_waits_at_start(self, state: LabState, bundle: str, run: RunState, now: int) -> list[Wait]:
        """The wait by the rules of each first step of a run of a bundle; empty if one of them is possible.
        While nothing happens, the result for one bundle is used for all bundles of its kind."""
        if self._seen_at != (state.position, now):
            self._seen_at = state.position, now
            self._seen.clear()
            self._spares.forget()
        kind = self.room.find_kind(bundle)
        if all(self._spares.are_enough(state, needs) for needs in kind.needs):
            kind = Kind(kind.starts)
        waits = self._seen.get(kind)
        if waits is None:
            waits = self._seen[kind] = self._list_waits_at_start(state, run, now)
        return waits

    def _list_waits_at_start(self, state: LabState, run: RunState, now: int) -> list[Wait]:
        """The wait by the rules of each first step of a run; empty if one of them is possible."""
        waits: list[Wait] = []
        for option in list_options(run):
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

    # -- admission ---------------------------------------------------------------------------

    def _admit_runs(self, state: LabState, bundle: str, first: RunState, now: int) -> Iterator[StepStart]:
        run: RunState | None = first
        if first.id not in state.runs.queued:  # the look ahead for another bundle has started it
            run = self.admission.find_first(state, bundle, now)
        while run is not None:
            chosen = self.admission.choose(state, bundle, run, now)
            if not isinstance(chosen, Candidate):
                for wait in chosen:
                    self.wait_list.add((bundle, 0), wait)
                return
            option = chosen.run
            self.room.count_admission(state, option, urgent=is_urgent(state, option, now))
            self.patience.count_start(state, option, chosen.step, self.wait_list)
            yield StepStart(option.id, chosen.step, option.plan if option.choices else "")
            if option.id in state.runs.queued:
                return  # the start was rejected; proposing it again would never end
            if not self.adviser.has_order(state, state.runs.plan_of(option).workcell, now):
                yield from self._start_first_steps(state, option.id, now)
            run = self.admission.find_first(state, bundle, now)

    def _start_first_steps(self, state: LabState, name: RunId, now: int) -> Iterator[StepStart]:
        """Propose the other first steps of a run that has just started. They go before first steps of queued
        runs."""
        run = state.runs.active.get(name)
        if run is not None:
            starts = [ReadyStart(run, step) for step in list_ready_steps(state, run)]
            for start in self.ranking.sort(state, starts, self.patience, now):
                yield from self._start_step(state, start, now)

    def _is_overtaken(self, state: LabState, run: RunState) -> bool:
        """Whether a run was overtaken so often that it waits for no order any more."""
        return self.patience.is_over(run.id) if run.has_started else self.room.is_overtaken(state, run)

    def _list_plans(self, state: LabState, cell: str) -> Iterator[Plan]:
        """The plans of the runs inside a workcell, and those of ``_list_plans_outside``."""
        yield from map(state.runs.plan_of, state.runs.list_inside(cell))
        yield from self._list_plans_outside(state, cell)

    def _list_plans_outside(self, state: LabState, cell: str) -> Iterator[Plan]:
        """The plans of queued runs of a workcell: one run of each of the first ``MOST_BUNDLES`` bundles."""
        for bundle in self.room.list_in_cell(cell)[:MOST_BUNDLES]:
            run = self.room.find_any_run(state, bundle)
            if run is not None:
                yield state.runs.plan_of(run)


def make_searching_scheduler(known: Mapping[str, OwnOrder] = MappingProxyType({})) -> Scheduler:
    """A scheduler that searches for the lab's own order before the first of several runs starts. The search
    continues from the ``known`` orders, by workcell."""
    return Scheduler(OwnOrders(before_start=BEFORE_START, known=known))


def _list_keys_of(cell: str | None) -> tuple[str, ...]:
    """The keys that are touched when a run, experiment or question of a workcell ends. No keys if ``cell`` is
    empty (it was in no workcell); the key of everything if it is None (not known)."""
    if cell is None:
        return (EVERYTHING,)
    return list_cell_keys(cell) if cell else ()


def _cells(state: LabState) -> dict[str, str]:
    """The workcell of each run, experiment and question that is not over, by name; empty if it is in none.
    Those whose workcell is not known are left out."""
    runs = state.runs
    names = [*runs.active, *runs.queued, *state.experiments.open, *state.interventions.open]
    found = ((name, _find_cell(state, name)) for name in names)
    return {name: cell for name, cell in found if cell is not None}


def _find_cell(state: LabState, name: str) -> str | None:
    """The workcell of a run, an experiment or a question. Empty if it is in none; None if it is over, or its
    workcell is not known."""
    question = state.interventions.open.get(InterventionId(name))
    if question is not None:
        about = question.module or (question.subject if "/" in question.subject else "")
        return workcell_of(ModuleName(about)) or find_cell_of_run(state, question.run) or None
    if ExperimentId(name) in state.experiments.open:
        return find_cell_of_closing(state, name)
    return find_cell_of_run(state, name) or None


__all__ = ["Scheduler", "StepStart", "list_ready_steps", "make_searching_scheduler"]
