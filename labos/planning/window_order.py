"""An order of one's own for runs with windows: which waiting run is let in when, and when clocks start.

Where clocks run, a run that is let in a little sooner or later may keep out others for long. So planning lays
out the runs inside and the first that wait in a timetable (``chains``), in one order after the other: in turn
each run has the earliest end that those before leave to it. The order after which all are over soonest is
kept, and is where the next search begins. It is followed as if a planner had suggested it (``suggested``):
the rules are asked as ever, and a start counts as planned only if a rehearsal shows that all windows are
kept.

There is no such order where a planner's counts, where all runs are of one kind, where some run has no
windows, has doors or setpoints to care for, or has steps that do not follow one another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import islice

import msgspec

from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import PENDING, RunState
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested, Suggested
from labos.planning.chains import Fit, SlotTable
from labos.planning.forecast import find_usual_time
from labos.planning.outline import Ways
from labos.planning.window_timetable import PlannedCell, lay_out_runs

OWN_WINDOWS = "labos, windows"
"""In place of the planner's name, in the lab's own order where clocks run."""

MOST_WAITING = 16
"""So many runs that wait are laid out, the first ones."""

TRIES_EACH = 25
"""So many orders are tried for each run that waits, when something has happened."""

MOST_TRIES = 160
"""So many in all: they take some 50 ms of processor time, and the kernel does nothing else meanwhile."""

TRIES_NEW = 10
"""So many in all, when somebody has submitted a run."""

ENOUGH_EACH = 430
"""So many for each run that has come, in one turn of the kernel after the other, while nothing happens."""

BREATH_NS = 2_000_000
"""The pause between two turns of a search: work that has to be done goes on meanwhile."""

LONGEST_SEARCH_NS = 10_000_000_000
"""For so long (wall time) at most no run starts in an empty workcell because the search is going on."""

LOOK_NS = 1_000_000_000
"""A run that waits for the end of the search is looked at again after so long at the latest."""

WARMTH = 0.025
"""An order that is worse by this part of the time that is left is still gone on with now and then."""

CYCLE = 1500
"""After so many orders the search begins anew with the best one."""

WEIGHT_OF_MEAN = 0.1
"""How much the middle of all ends counts beside the last one."""

LOST = 1000
"""A run inside that does not fit in counts as so many that wait."""

PUNCTUAL_S = 5.0
"""So much later (lab seconds) than it should a step may start, and the order still counts."""

Value = tuple[int, float]
"""How many runs do not fit in or are overtaken too often, and when all is over: less is better."""


class CellSearch(msgspec.Struct):
    """What is known of the search in one workcell."""

    members: tuple[tuple[RunId, ...], tuple[RunId, ...]] | None = None
    """The runs inside and those that wait for which was searched last."""
    line: list[RunId] | None = None
    """The best order of the runs."""
    last: list[RunId] = []
    """The order with which the search ended."""
    late: dict[RunId, bool] = {}
    """Runs that did not start in time: they are left out."""
    seen: object = None
    """How far the runs inside had come when one was late last."""
    statuses: object = None
    """How far they had come when the order was made."""
    looked: int = 0
    """When was searched last (UTC ns)."""
    tried: int = 0
    """How many orders were tried."""
    waited_since: int | None = None
    """Since when runs wait for the search in an empty workcell (UTC ns)."""

    @property
    def goes_on(self) -> bool:
        """Whether orders are still to be tried, even if nothing happens."""
        return self.members is not None and self.tried < ENOUGH_EACH * len(self.members[1])


class WindowOrders:
    """The orders of workcells where clocks run. ``orders`` are those that count now; ``tries`` counts the
    timetables that were made."""

    def __init__(self, patience: int) -> None:
        self.orders: dict[str, OrderSuggested] = {}
        self.tries = 0
        self._patience = patience
        self._ways: dict[str, Ways] = {}
        self._searches: dict[str, CellSearch] = {}

    def forget(self, cell: str) -> None:
        """The bench of a workcell has changed."""
        self._ways.pop(cell, None)
        self.drop(cell)

    def remember(self, other: WindowOrders) -> None:
        """Begin with the orders of another scheduler."""
        self.orders.update(other.orders)
        for cell, search in other._searches.items():
            self._searches[cell] = msgspec.structs.replace(search, late=dict(search.late))

    def drop(self, cell: str) -> None:
        """There is no order for a workcell any more."""
        self.orders.pop(cell, None)
        self._searches.pop(cell, None)

    def find_next_look(self) -> int | None:
        """When the search goes on even if nothing happens (UTC ns); None if it is over."""
        searches = [self._searches[cell] for cell in self.orders]
        return min((search.looked + BREATH_NS for search in searches if search.goes_on), default=None)

    def is_too_early(self, state: LabState, cell: str, now: int) -> bool:
        """Whether no run should start yet in an empty workcell, because an order is being searched: what the
        first run does cannot be taken back."""
        search = self._searches.get(cell)
        if cell not in self.orders or search is None or not search.goes_on or state.runs.list_inside(cell):
            return False
        if search.waited_since is None or now < search.waited_since:
            search.waited_since = now
        return now < search.waited_since + LONGEST_SEARCH_NS

    def update(
        self,
        state: LabState,
        cell: str,
        waiting: Sequence[RunState],
        overtakings: Callable[[RunId], float],
        now: int,
    ) -> bool:
        """See to it that the order of a workcell fits what is inside and waits (the first one first); returns
        whether it is another one. ``overtakings`` tells how often a run was overtaken."""
        if state.suggestions.find(cell, now) is not None:
            self.drop(cell)
            return False
        search = self._searches.setdefault(cell, CellSearch())
        inside = state.runs.list_inside(cell)
        late = search.late
        if inside:
            search.waited_since = None
        is_waited_for = search.waited_since is not None and search.goes_on
        waiting = [run for run in waiting if run.id not in late][:MOST_WAITING]
        members = (tuple(run.id for run in inside), tuple(run.id for run in waiting))
        known, order = search.members, self.orders.get(cell)
        tries = min(MOST_TRIES, TRIES_EACH * len(waiting))
        if known == members:
            if order is None or search.looked == now:
                return False
            if not is_waited_for and not _is_on_time(state, order, now):
                # Once for all that has happened: what the rules do not let start is not waited for again.
                seen = tuple(tuple(run.statuses) for run in inside)
                if search.seen == seen:
                    return False
                search.seen = seen
                late.update(dict.fromkeys(_list_late(state, order, now), True))
                waiting = [run for run in waiting if run.id not in late]
                members = (members[0], tuple(run.id for run in waiting))
        elif known is not None and known[0] != members[0]:
            late.clear()
        elif known is not None:
            tries = TRIES_NEW
        come = {*members[1]} - {*(known[1] if known is not None else ())}
        search.tried = max(0, search.tried - ENOUGH_EACH * len(come))
        search.members, search.looked, before = members, now, search.line
        found = self._search(state, cell, inside, waiting, overtakings, now, tries, seed=now)
        if found is None:
            search.line = None
            return self.orders.pop(cell, None) is not None
        statuses = tuple(tuple(run.statuses) for run in inside)
        is_same = known == members and search.line == before and search.statuses == statuses
        search.statuses = statuses
        is_over = is_waited_for and not search.goes_on
        if not is_over and is_same and order is not None and _is_on_time(state, order, now):
            return False  # nothing has happened, and nothing better was found
        self.orders[cell] = found
        return is_over or order is None or order.steps != found.steps

    def search_longer(
        self,
        state: LabState,
        cell: str,
        runs: Sequence[RunState],
        overtakings: Callable[[RunId], float],
        now: int,
        tries: int,
    ) -> OrderSuggested | None:
        """The best order of these runs in so many tries, also where a planner's order is followed now; None
        if there is none. It is not kept in ``orders``."""
        inside = [run for run in runs if run.has_started]
        waiting = [run for run in runs if not run.has_started]
        found: OrderSuggested | None = None
        self._searches.setdefault(cell, CellSearch())
        for tried in range(0, tries, CYCLE):
            seed = now + tried * BREATH_NS  # other draws in each cycle, as if time went by
            found = self._search(state, cell, inside, waiting, overtakings, now, min(tries, CYCLE), seed)
            if found is None:
                return None
        return found

    def _search(
        self,
        state: LabState,
        cell: str,
        inside: Sequence[RunState],
        waiting: Sequence[RunState],
        overtakings: Callable[[RunId], float],
        now: int,
        tries: int,
        seed: int,
    ) -> OrderSuggested | None:
        plans = {run.plan for run in (*inside, *waiting)}
        if len(plans) < 2 or not all(state.runs.plans[name].windowed for name in plans):
            return None  # a run without windows keeps the margin of reservations
        if any(run.experiment or (run.choices and not run.has_started) for run in (*inside, *waiting)):
            return None  # what else is to be done, or on which module, is not known
        ways = self._ways.setdefault(cell, Ways())
        layout = lay_out_runs(state, cell, ways, [*inside, *waiting], now)
        if layout is None:
            return None
        for run in waiting:
            layout.members[run.id].limit = max(0, math.ceil(self._patience - overtakings(run.id)))
        found = self._searches[cell]
        known = [name for name in found.line or () if name in layout.members]
        new = [name for name in layout.members if name not in known]
        search = _Search(layout, seed)
        by_work = sorted(
            layout.members, key=lambda n: (not layout.members[n].run.has_started, -search.work(n))
        )
        lines = [[*known, *new], by_work]
        if known and new:
            lines.append([name for name in by_work if name in new] + known)
        last = [name for name in found.last if name in layout.members]
        here = last if len(last) == len(layout.members) else None
        best, here = search.improve(lines, tries, here, found.tried)
        self.tries += search.tries
        found.tried += search.tries
        if best is None:
            return None
        found.line, found.last = best.line, here
        fits = zip(best.line, best.fits, strict=True)
        return _suggest(state, cell, layout, {name: fit for name, fit in fits if fit is not None})


class TriedOrder(msgspec.Struct):
    """One order of the runs, how they fit in with it, and the timetables after each of them."""

    line: list[RunId]
    fits: list[Fit | None]
    tables: list[SlotTable]
    value: Value


class _Search:
    """Tries orders of the runs of a layout."""

    def __init__(self, layout: PlannedCell, seed: int) -> None:
        self.layout = layout
        self.tries = 0
        self._draws = _Draws(seed)
        self._older = [n for n, member in layout.members.items() if not member.run.has_started]

    def work(self, name: RunId) -> int:
        """How long a run is at work if nothing is in its way (slots)."""
        return sum(leg.length for leg in self.layout.members[name].chain.legs)

    def improve(
        self, lines: Iterable[list[RunId]], tries: int, last: list[RunId] | None, tried: int
    ) -> tuple[TriedOrder | None, list[RunId]]:
        """The best order found, beginning with the best of these, or with the ``last`` one of the search so
        far; None if with none of them those inside fit in. And the one that the search ended with. ``tried``
        says how many were tried before."""
        here = best = min((self._try(line) for line in lines), key=lambda attempt: attempt.value)
        if last is not None and tried % CYCLE + tries < CYCLE:
            here = self._try(last)
            best = min(best, here, key=lambda attempt: attempt.value)
        for number in range(tries if len(best.line) > 1 and self._older else 0):
            heat = WARMTH * best.value[1] * (1 - (tried + number) % CYCLE / CYCLE)
            other = self._try(self._vary(here.line), here)
            worse = other.value[1] - here.value[1]
            if other.value <= here.value or (
                other.value[0] == here.value[0] and self._draws.next() < math.exp(-worse / heat)
            ):
                here = other
                if other.value < best.value:
                    best = other
        return (best if best.value[0] < LOST else None), here.line

    def _vary(self, line: list[RunId]) -> list[RunId]:
        """Another order that is like this one."""
        other, count, draws = list(line), len(line), self._draws
        while other == line:
            for _ in range(1 if draws.next() < 0.8 else 2):
                one, two = int(draws.next() * count), int(draws.next() * count)
                if draws.next() < 0.65:
                    other.insert(two, other.pop(one))
                else:
                    other[one], other[two] = other[two], other[one]
        return other

    def _try(self, line: list[RunId], like: TriedOrder | None = None) -> TriedOrder:
        """Lay out the runs in an order. What begins like another attempt takes over its first runs."""
        self.tries += 1
        same = 0
        if like is not None:
            while line[same] == like.line[same]:
                same += 1
        tables = like.tables[:same] if like is not None else []
        fits = like.fits[:same] if like is not None else []
        table = tables[-1] if tables else self.layout.table
        for name in line[same:]:
            fit = table.fit(self.layout.members[name].chain)
            fits.append(fit)
            if fit is not None:
                table = table.copy()
                table.mark(fit.marks)
            tables.append(table)
        return TriedOrder(line, fits, tables, self._value(line, fits))

    def _value(self, line: list[RunId], fits: list[Fit | None]) -> Value:
        members = self.layout.members
        ends = [fit.end for fit in fits if fit is not None]
        out = sum(
            LOST if members[name].run.has_started else 1
            for name, fit in zip(line, fits, strict=True)
            if fit is None
        )
        begins = {
            name: fit.starts[0]
            for name, fit in zip(line, fits, strict=True)
            if fit is not None and not members[name].run.has_started
        }
        younger: list[int] = []
        for name in reversed(self._older):
            begin = begins.get(name)
            if begin is not None:
                out += sum(other < begin for other in younger) > members[name].limit
                younger.append(begin)
        return out, max(ends, default=0) + WEIGHT_OF_MEAN * sum(ends) / max(1, len(ends))


class _Draws:
    """Numbers between 0 and 1 that look as if they were drawn, the same ones each time."""

    def __init__(self, seed: int) -> None:
        self._at = seed

    def next(self) -> float:
        self._at = (self._at * 6364136223846793005 + 1442695040888963407) % 2**64
        return (self._at >> 11) / 2**53


# -- the order ---------------------------------------------------------------------------------------


def _suggest(state: LabState, cell: str, layout: PlannedCell, fits: dict[RunId, Fit]) -> OrderSuggested:
    """The timetable as an order. A step that does not wait starts as soon as the one before it has ended."""
    steps: list[Suggested] = []
    last = layout.now
    for name, fit in fits.items():
        member = layout.members[name]
        plan = state.runs.plan_of(member.run)
        slot_end, end = member.chain.begins, member.end
        for leg, at, index in zip(
            member.chain.legs, fit.starts, member.line.steps[member.first :], strict=True
        ):
            start = layout.now + at * layout.slot
            if at == slot_end:
                start = end
            steps.append(Suggested(name, index, start))
            end, slot_end = start + find_usual_time(state, plan.steps[index]), at + leg.length
            last = max(last, end)
    steps.sort(key=lambda step: (step.start, step.run, step.step))
    return OrderSuggested(cell, OWN_WINDOWS, last + convert_lab_s(state, 60.0), tuple(steps))


def _is_on_time(state: LabState, order: OrderSuggested, now: int) -> bool:
    return order.until > now and not any(True for _ in islice(_list_late(state, order, now), 1))


def _list_late(state: LabState, order: OrderSuggested, now: int) -> Iterable[RunId]:
    """The runs that should have started a step by now, and have not."""
    latest = now - convert_lab_s(state, PUNCTUAL_S)
    for one in order.steps:
        if one.start >= latest:
            return
        run = state.runs.get(one.run)
        if run is not None and (not run.has_started or run.steps[one.step].status == PENDING):
            yield one.run
