"""Which waiting run is admitted: the first that may start, or another of equal rank that the look ahead
(``pilot``) prefers."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import Protocol

import msgspec

from labos.core import reasons
from labos.core.effects import list_carried
from labos.core.runs import RunState, find_holds, queue_key
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.choosing import sort_options
from labos.planning.pilot import MOST_WAITING, Candidate, Pilot, are_different
from labos.planning.ranking import Ranking
from labos.planning.reservations import Reservations
from labos.planning.suggested import Adviser
from labos.planning.touch import cell_key
from labos.planning.waiting import WaitingRoom
from labos.planning.window_order import LOOK_NS, WindowOrders

MOST_INSIDE = 8
"""The most runs inside for which an order is searched."""


class CheckStart(Protocol):
    """A check that returns what a step waits for (``Scheduler.check_start``)."""

    def __call__(
        self,
        state: LabState,
        run: RunState | None,
        step: int,
        now: int,
        *,
        only_asking: bool = False,
        at_once: bool = False,
    ) -> Wait | None: ...


class FoundStart(msgspec.Struct, frozen=True):
    """What was found for a waiting run: its ``start``, which is the run with one of its plans, and its first
    step. Without one, ``waits`` are the waits of each of its first steps."""

    start: tuple[RunState, int] | None
    waits: list[Wait]


class Admission:
    """Chooses which waiting run is admitted."""

    def __init__(
        self,
        room: WaitingRoom,
        reservations: Reservations,
        ranking: Ranking,
        adviser: Adviser,
        window_orders: WindowOrders,
        check_start: CheckStart,
    ) -> None:
        self.pilot = Pilot()
        self._room = room
        self._reservations = reservations
        self._ranking = ranking
        self._adviser = adviser
        self._window_orders = window_orders
        self._check_start = check_start

    def find_first(self, state: LabState, bundle: str, now: int) -> RunState | None:
        """The run of a bundle that is next; None if there is none."""
        first = self._ranking.find_first(state, self._room.list_heads(state, bundle), now)
        if first is None or not self._adviser.has_orders(state) or self._room.is_overtaken(state, first):
            return first
        if self._adviser.own.find(state.runs.plan_of(first).workcell) is not None:
            heads = self._room.list_heads(state, bundle)
            starts = [(self._adviser.start_of(state, head, None, now), head.position) for head in heads]
            return heads[starts.index(min(starts))]
        return self._adviser.find_next(state, first, now)

    def choose(self, state: LabState, bundle: str, run: RunState, now: int) -> Candidate | list[Wait]:
        """The run that starts now, if ``run`` is the next of its bundle; or what the bundle waits for."""
        possible = self._find_start(state, run, now)
        if possible.start is None and any(
            isinstance(wait.reason, reasons.AfterElder) for wait in possible.waits
        ):
            # A run that is older than the overtaken run need not wait for it.
            oldest = self._room.find_oldest(state, bundle)
            if oldest is not None and oldest is not run:
                run, possible = oldest, self._find_start(state, oldest, now)
        return self._look_ahead(state, run, possible, now)

    def explain(self, state: LabState, run: RunState, now: int) -> list[tuple[int, Wait]]:
        """The waits of a run that may start, if the look ahead prefers another run or none: (step, wait).
        Empty if it does not, or if no step may start."""
        for option in sort_options(state, run, now):
            for step in state.runs.plans[option.plan].starts:
                with self._reservations.forget_afterwards():
                    wait = self._check_start(state, option, step, now, only_asking=True)
                    if wait is None:
                        possible = FoundStart((option, step), [])
                        chosen = self._look_ahead(state, run, possible, now, only_asking=True)
                        waits = chosen if isinstance(chosen, list) else []
                        return [(step, each) for each in waits]
        return []

    def find_order(self, state: LabState, cell: str, now: int) -> bool:
        """Search for an order of all known runs of a workcell, if its runs may be compared. Return whether
        the order has changed."""
        own = self._adviser.own
        if not own.is_used:
            return False
        if own.find(cell) is None and not 0 < len(self._room.list_in_cell(cell)) <= MOST_WAITING:
            return False
        inside = state.runs.list_inside(cell)
        if len(inside) > MOST_INSIDE or state.suggestions.find(cell, now) is not None:
            return own.drop(cell)
        waiting = self._list_waiting(state, cell, now)
        runs = [*inside, *waiting] if waiting is not None else []
        if len(runs) < 2 or not are_different(state, runs, runs[0]):
            return own.drop(cell)
        return own.search(state, cell, inside, waiting or [], now)

    def _list_waiting(self, state: LabState, cell: str, now: int) -> list[RunState] | None:
        """All runs that wait for a workcell, the oldest first. None if there are too many of them, or if they
        differ in rank. None also if one of them is held back, has a choice of modules, or carries nothing."""
        found: list[RunState] = []
        if len(self._room.list_in_cell(cell)) > MOST_WAITING:
            return None
        for head in self._list_heads(state, cell):
            found += _list_class(state, head, MOST_WAITING + 1)
            if len(found) > MOST_WAITING:
                return None
        if any(find_holds(run) or run.choices or not _carries(state, run) for run in found):
            return None
        if len({self._make_rank(state, run, now) for run in found}) > 1:
            return None
        return sorted(found, key=lambda run: run.position)

    def _find_start(self, state: LabState, run: RunState, now: int) -> FoundStart:
        waits: list[Wait] = []
        for option in sort_options(state, run, now):
            for step in self._ranking.behind.sort(state, option.plan, state.runs.plans[option.plan].starts):
                wait = self._check_start(state, option, step, now)
                if wait is None:
                    return FoundStart((option, step), [])
                waits.append(wait)
        return FoundStart(None, waits)

    def _look_ahead(
        self, state: LabState, run: RunState, possible: FoundStart, now: int, *, only_asking: bool = False
    ) -> Candidate | list[Wait]:
        """The run that starts now: this one if it may start, another of equal rank, or none. If none starts,
        what the run waits for."""
        start, waits = possible.start, possible.waits
        early = start is None
        if start is None and waits and all(isinstance(wait.reason, reasons.WouldBlock) for wait in waits):
            option = sort_options(state, run, now)[0]
            start = option, state.runs.plans[option.plan].starts[0]
        if start is None:
            return waits
        option, step = start
        cell = state.runs.plan_of(option).workcell
        first = Candidate(option, step, early=early)
        goes_first = run.id in state.runs.windowed or self._room.is_overtaken(state, run)
        own = self._adviser.own
        if not goes_first and own.is_used:
            if own.is_too_early(state, cell):
                return [Wait(reasons.SearchForOrder(), (cell_key(cell),), own.goes_on_at(cell))]
            if self._window_orders.is_too_early(state, cell, now):
                return [Wait(reasons.SearchForOrder(), (cell_key(cell),), now + LOOK_NS)]
        if goes_first or not _carries(state, option) or self._adviser.has_order(state, cell, now):
            return waits if early else first  # a run that carries nothing blocks no other run
        equals = self._list_equals(state, option, now)
        if len(equals) >= MOST_WAITING or not are_different(
            state, [*state.runs.list_inside(cell), *equals], option
        ):
            return waits if early else first
        enter = partial(self._find_candidate, state, now=now)
        chosen = self.pilot.choose(state, first, equals, now, enter)
        if isinstance(chosen, Wait):
            return waits if early else [chosen]
        if chosen == first and not early:
            return first
        wait = self._check_start(
            state, chosen.run, chosen.step, now, at_once=chosen.early, only_asking=only_asking
        )
        if wait is not None:
            return waits if early else first
        return chosen

    def _find_candidate(self, state: LabState, run: RunState, now: int) -> Candidate | None:
        """The start of a run with its first step, if this is possible now; else None. It is ``early`` if the
        place after that step is not free soon."""
        step = state.runs.plans[run.plan].starts[0]
        with self._reservations.forget_afterwards():
            wait = self._check_start(state, run, step, now, only_asking=True)
            if wait is None:
                return Candidate(run, step)
            if isinstance(wait.reason, reasons.WouldBlock):
                wait = self._check_start(state, run, step, now, only_asking=True, at_once=True)
                return Candidate(run, step, early=True) if wait is None else None
        return None

    def _list_equals(self, state: LabState, run: RunState, now: int) -> list[RunState]:
        """The first waiting runs of a workcell that differ in rank from this run only by age, the oldest
        first."""
        rank = self._make_rank(state, run, now)
        cell = state.runs.plan_of(run).workcell
        found: list[RunState] = []
        for head in self._list_heads(state, cell):
            if self._make_rank(state, head, now) != rank or find_holds(head):
                continue
            found += _list_class(state, head, MOST_WAITING)
        found = [other for other in found if other.id != run.id and other.id not in state.runs.windowed]
        return sorted(found, key=lambda other: other.position)

    def list_next(self, state: LabState, cell: str, most: int, now: int) -> list[RunState]:
        """The first waiting runs of a workcell with the best rank, which differ only by age. At most
        ``most``, the oldest first."""
        heads: list[RunState] = []
        for bundle in self._room.list_in_cell(cell)[: 4 * most]:
            heads += [head for head in self._room.list_heads(state, bundle) if not find_holds(head)]
        if not heads:
            return []
        ranks = {head.id: self._make_rank(state, head, now) for head in heads}
        first = min(ranks.values())
        found: list[RunState] = []
        for head in heads:
            if ranks[head.id] == first:
                found += _list_class(state, head, most)
        return sorted(found, key=lambda run: run.position)[:most]

    def _list_heads(self, state: LabState, cell: str) -> Iterator[RunState]:
        for bundle in self._room.list_in_cell(cell)[:MOST_WAITING]:
            yield from self._room.list_heads(state, bundle)

    def _make_rank(self, state: LabState, run: RunState, now: int) -> tuple[object, ...]:
        """The rank of a waiting run without its age. The least goes first."""
        return -run.priority, *self._ranking.rank_waiting(state, run, now)


def _list_class(state: LabState, head: RunState, most: int) -> list[RunState]:
    """The first waiting runs, this one included, that differ from it in nothing but age; at most ``most``."""
    group = state.runs.queue[queue_key(state.runs.find_shape(head), head)]
    return [state.runs.queued[name] for name in islice(group, most)]


def _carries(state: LabState, run: RunState) -> bool:
    return any(list_carried(step.effects) for step in state.runs.plan_of(run).steps)
