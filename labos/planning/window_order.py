"""The lab's own order for runs with windows: when each waiting run starts, and when clocks start.

Where clocks run, a run that starts a little earlier or later may delay others for long. So planning lays out
the runs inside and the first waiting runs in a timetable (``chains``). It tries many orders of these runs. In
each order, every run in turn gets the earliest end that the runs before it leave. The order with the soonest
end of all is kept, and the next search begins with it. It is followed like a planner's suggestion
(``suggested``): all rules are checked, and a start counts as planned only if no window is missed needlessly
in a rehearsal.

A planner may suggest an order of the runs with which the search begins. There is no such order while a
planner suggests times of steps, or if all runs have the same plan. There is none either if a run has no
windows, uses doors, setpoints or holds, or has steps that do not follow one another.
The same applies to experiments, and to waiting runs that may choose a module.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import islice

import msgspec

from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import PENDING, RunState, find_holds
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested, Suggested
from labos.planning.chains import Chain, Fit, SlotTable
from labos.planning.forecast import find_usual_time
from labos.planning.outline import Ways
from labos.planning.own_order import BREATH_NS, draw_numbers
from labos.planning.retiming import correct_times
from labos.planning.window_timetable import PlannedCell, lay_out_runs

OWN_WINDOWS = "labos, windows"
"""The author of the lab's own order for windows, in place of a planner's name."""

MOST_WAITING = 16
"""The most waiting runs that are laid out. The first ones count."""

TRIES_EACH = 25
"""The number of orders that one search tries for each waiting run."""

MOST_TRIES = 160
"""The most orders that one search tries. They take about 50 ms of processor time; the kernel does nothing
else meanwhile."""

TRIES_NEW = 10
"""The number of orders that a search tries if only the waiting runs have changed, as after a submission."""

ENOUGH_EACH = 430
"""The number of orders that are tried for each waiting run before the search is over. While nothing happens,
it goes on in one turn of the kernel after another."""

LONGEST_SEARCH_NS = 10_000_000_000
"""The longest time (ns of wall time) for which no run starts in an empty workcell because of the search."""

LOOK_NS = 1_000_000_000
"""A run that waits for the end of the search is checked again after this time at the latest (ns)."""

WARMTH = 0.025
"""The search sometimes continues from a worse order. The typical loss that it accepts is this part of the
best value at the start of a cycle, and falls to zero at its end."""

CYCLE = 1500
"""After this many orders, the search begins a new cycle with the best order."""

WEIGHT_OF_MEAN = 0.1
"""The weight of the mean of all ends in the value of an order. The last end has the weight 1."""

RISK_S = 30.0
"""An order counts as so much longer (lab seconds) for each step that may find a module or place taken if the
step before it ends early, and may then miss its window."""

LATE = 50
"""A run inside that misses a window whose clock runs counts as this many waiting runs that do not fit in."""

LOST = 1000
"""A run inside that does not fit in at all counts as this many waiting runs."""

PUNCTUAL_S = 5.0
"""The most (lab seconds) that a step may be behind its time in an order that still counts."""

Value = tuple[int, float]
"""The value of an order; less is better. First, the number of runs that do not fit in or are overtaken too
often. Then the last end, with the mean of all ends and the risk of missed windows (slots)."""


class CellSearch(msgspec.Struct):
    """The progress of the search in one workcell."""

    members: tuple[tuple[RunId, ...], tuple[RunId, ...]] | None = None
    """The runs inside and the waiting runs of the last search."""
    line: list[RunId] | None = None
    """The best order of the runs. None if there is none."""
    last: list[RunId] = []
    """The order with which the last search ended."""
    late: dict[RunId, bool] = {}
    """The runs that did not start in time. They are left out."""
    seen: object = None
    """The progress of the runs inside when a run was late last."""
    progress: object = None
    """How far the runs inside were at the last search, and whether they were paused."""
    looked: int = 0
    """The time of the last search (UTC ns)."""
    tried: int = 0
    """The number of orders that were tried."""
    waited_since: int | None = None
    """The time since when runs wait for the search in an empty workcell (UTC ns)."""
    suggested: tuple[RunId, ...] = ()
    """The last order of runs that a planner has suggested for the search."""
    rating: tuple[int, int] = (0, 0)
    """The value of the best order when it was found: the number of ``Value``, and its slots as a time (UTC
    ns). So ratings of different times can be compared."""

    @property
    def goes_on(self) -> bool:
        """Whether the search goes on even if nothing happens."""
        return self.members is not None and self.tried < ENOUGH_EACH * len(self.members[1])


class WindowOrders:
    """The lab's own orders of workcells where clocks run. ``orders`` are those in force; ``tries`` counts the
    timetables that were made. ``patience`` is the number of younger runs that may go before a waiting one."""

    def __init__(self, patience: int) -> None:
        self.orders: dict[str, OrderSuggested] = {}
        self.tries = 0
        self._patience = patience
        self._ways: dict[str, Ways] = {}
        self._searches: dict[str, CellSearch] = {}

    def forget(self, cell: str) -> None:
        """Forget a workcell whose bench has changed."""
        self._ways.pop(cell, None)
        self.drop(cell)

    def remember(self, other: WindowOrders) -> None:
        """Take over the orders and searches of another scheduler."""
        self.orders.update(other.orders)
        for cell, search in other._searches.items():
            self._searches[cell] = msgspec.structs.replace(search, late=dict(search.late))

    def drop(self, cell: str) -> None:
        """Drop the order of a workcell and its search."""
        self.orders.pop(cell, None)
        self._searches.pop(cell, None)

    def find_best(self, cell: str) -> tuple[tuple[RunId, ...], tuple[int, int]]:
        """The best order of runs of the last search, and its rating (``CellSearch.rating``; less is better).
        Without runs if there is no order."""
        search = self._searches.get(cell, CellSearch())
        return tuple(search.line or ()), search.rating

    def find_next_look(self) -> int | None:
        """The next time at which a search goes on even if nothing happens (UTC ns); None if all are over."""
        if not self.orders:
            return None
        searches = [self._searches[cell] for cell in self.orders]
        return min((search.looked + BREATH_NS for search in searches if search.goes_on), default=None)

    def is_too_early(self, state: LabState, cell: str, now: int) -> bool:
        """Whether no run should start yet in an empty workcell, because the search goes on: the first start
        cannot be undone. Notes since when runs wait for the search."""
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
        """Bring the order of a workcell up to date with its runs inside and those ``waiting`` (the first one
        first). Returns whether the order has changed, or a search is over for which runs waited.
        ``overtakings`` returns how often a run was overtaken."""
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
        suggested = state.suggestions.find_line(cell, now)
        is_new, search.suggested = suggested != search.suggested, suggested
        # While a run is paused there is no order: the line is kept for the first search after the pause.
        hint = suggested if is_new or search.line is None else ()
        progress = tuple((run.status, find_holds(run), *run.statuses) for run in inside)
        if known == members and not (is_new and suggested):
            if search.looked == now or (order is None and search.progress == progress):
                return False
            if order is not None and not is_waited_for and not _is_on_time(state, order, now):
                # Only once for each progress of the runs inside: the rules do not let the late runs start, so
                # the next order does not wait for them again.
                if search.seen == progress:
                    return False
                search.seen = progress
                late.update(dict.fromkeys(_list_late(state, order, now), True))
                waiting = [run for run in waiting if run.id not in late]
                members = (members[0], tuple(run.id for run in waiting))
        elif known is not None and known[0] != members[0]:
            late.clear()
        elif known is not None and known != members:
            tries = TRIES_NEW
        come = {*members[1]} - {*(known[1] if known is not None else ())}
        search.tried = max(0, search.tried - ENOUGH_EACH * len(come))
        search.members, search.looked, before = members, now, search.line
        is_same = known == members and search.progress == progress
        search.progress = progress
        found = self._search(state, cell, [*inside, *waiting], overtakings, now, tries, now, hint)
        if found is None:
            search.line = None
            return self.orders.pop(cell, None) is not None
        is_same = is_same and search.line == before
        is_over = is_waited_for and not search.goes_on
        if not is_over and is_same and order is not None and _is_on_time(state, order, now):
            return False  # nothing has changed, and no better order was found
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
        """The best order of these runs that is found with this number of tries; None if there is none. The
        search begins with the last order. A planner's order may be in force. The order is not kept in
        ``orders``."""
        found: OrderSuggested | None = None
        self._searches.setdefault(cell, CellSearch())
        for tried in range(0, max(1, tries), CYCLE):
            seed = now + tried * BREATH_NS  # each cycle draws other numbers, as at a later time
            found = self._search(state, cell, runs, overtakings, now, min(tries, CYCLE), seed)
            if found is None:
                return None
        return found

    def _search(
        self,
        state: LabState,
        cell: str,
        runs: Sequence[RunState],
        overtakings: Callable[[RunId], float],
        now: int,
        tries: int,
        seed: int,
        hint: Sequence[RunId] = (),
    ) -> OrderSuggested | None:
        plans = {run.plan for run in runs}
        if len(plans) < 2 or not all(state.runs.plans[name].windowed for name in plans):
            return None  # a run without windows has to keep the margin of reservations
        if any(run.experiment or (run.choices and not run.has_started) for run in runs):
            return None  # the experiment's later runs, or the chosen modules, are not known
        ways = self._ways.setdefault(cell, Ways())
        layout = lay_out_runs(state, cell, ways, runs, now)
        if layout is None:
            return None
        for name, member in layout.members.items():
            if not member.run.has_started:
                member.limit = max(0, math.ceil(self._patience - overtakings(name)))
        found = self._searches[cell]
        known = [name for name in found.line or () if name in layout.members]
        new = [name for name in layout.members if name not in known]
        search = _Search(layout, seed, convert_lab_s(state, RISK_S))
        by_work = sorted(
            layout.members, key=lambda n: (not layout.members[n].run.has_started, -search.work(n))
        )
        lines = [[*known, *new], by_work]
        if hint:
            hinted = [name for name in hint if name in layout.members]
            lines.append([*hinted, *(name for name in lines[0] if name not in hinted)])
        if known and new:
            lines.append([name for name in by_work if name in new] + known)
        last = [name for name in found.last if name in layout.members]
        here = last if len(last) == len(layout.members) and not hint else None
        best, here = search.improve(lines, tries, here, found.tried)
        self.tries += search.tries
        found.tried += search.tries
        if best is None:
            return None
        found.line, found.last = best.line, here
        found.rating = best.value[0], now + int(best.value[1] * layout.slot)
        fits = {
            name: run.fit for name, run in zip(best.line, best.fitted, strict=True) if run.fit is not None
        }
        order = _suggest(state, cell, layout, fits)
        return correct_times(state, order, now)


class FittedRun(msgspec.Struct, frozen=True):
    """How a run of an order fits in (None: it does not), and the timetable with it and all runs before it.
    ``conflicts`` and ``late`` count for all of them: conflicts (see ``SlotTable``), and runs inside that miss
    a window whose clock runs."""

    fit: Fit | None
    table: SlotTable
    conflicts: int = 0
    late: int = 0


class TriedOrder(msgspec.Struct, frozen=True):
    """One order of the runs, and how each of them fits in."""

    line: list[RunId]
    fitted: list[FittedRun]
    value: Value


class _Search:
    """A search that tries orders of the runs of a layout. ``risk`` is the weight of a conflict (ns)."""

    def __init__(self, layout: PlannedCell, seed: int, risk: int) -> None:
        self.layout = layout
        self.tries = 0
        self._draws = ((number >> 11) / 2**53 for number in draw_numbers(seed))
        self._waiting = [n for n, member in layout.members.items() if not member.run.has_started]
        self._risk = risk / layout.slot

    def work(self, name: RunId) -> int:
        """The sum of the durations of the steps that a run has left (slots)."""
        return sum(leg.length for leg in self.layout.members[name].chain.legs)

    def improve(
        self, lines: Iterable[list[RunId]], tries: int, last: list[RunId] | None, tried: int
    ) -> tuple[TriedOrder | None, list[RunId]]:
        """The best order found, and the order with which the search ended. The best order is None if a run
        inside does not fit in with any of them. The search begins with the best of these ``lines``, or with
        the ``last`` order of the search before. ``tried`` is the number of orders tried before."""
        here = best = min((self._try(line) for line in lines), key=lambda attempt: attempt.value)
        if last is not None and tried % CYCLE + tries < CYCLE:
            here = self._try(last)
            best = min(best, here, key=lambda attempt: attempt.value)
        for number in range(tries if len(best.line) > 1 and self._waiting else 0):
            heat = WARMTH * best.value[1] * (1 - (tried + number) % CYCLE / CYCLE)
            other = self._try(self._vary(here.line), here)
            worse = other.value[1] - here.value[1]
            if other.value <= here.value or (
                other.value[0] == here.value[0] and next(self._draws) < math.exp(-worse / heat)
            ):
                here = other
                if other.value < best.value:
                    best = other
        return (best if best.value[0] < LOST else None), here.line

    def _vary(self, line: list[RunId]) -> list[RunId]:
        """A similar order: one or two times, a run is moved or two runs are exchanged."""
        other, count, draws = list(line), len(line), self._draws
        while other == line:
            for _ in range(1 if next(draws) < 0.8 else 2):
                one, two = int(next(draws) * count), int(next(draws) * count)
                if next(draws) < 0.65:
                    other.insert(two, other.pop(one))
                else:
                    other[one], other[two] = other[two], other[one]
        return other

    def _try(self, line: list[RunId], like: TriedOrder | None = None) -> TriedOrder:
        """Lay out the runs in an order. If it begins like another attempt, the first runs are taken over from
        there."""
        self.tries += 1
        same = 0
        if like is not None:
            while line[same] == like.line[same]:
                same += 1
        fitted = like.fitted[:same] if like is not None else []
        last = fitted[-1] if fitted else FittedRun(None, self.layout.table)
        for name in line[same:]:
            last = fit_behind(last, self.layout.members[name].chain)
            fitted.append(last)
        return TriedOrder(line, fitted, self._value(line, fitted))

    def _value(self, line: list[RunId], fitted: list[FittedRun]) -> Value:
        members = self.layout.members
        fits = [run.fit for run in fitted]
        ends = [fit.end for fit in fits if fit is not None]
        out = LATE * fitted[-1].late + sum(
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
        for name in reversed(self._waiting):
            begin = begins.get(name)
            if begin is not None:
                out += sum(other < begin for other in younger) > members[name].limit
                younger.append(begin)
        mean = sum(ends) / max(1, len(ends))
        return out, max(ends, default=0) + WEIGHT_OF_MEAN * mean + self._risk * fitted[-1].conflicts


def fit_behind(last: FittedRun, chain: Chain) -> FittedRun:
    """How the chain of a run fits in behind the ``last`` run. If a run inside cannot keep its window, it
    waits as long as it has to."""
    table, late = last.table, last.late
    fit = table.fit(chain)
    if fit is None and chain.begins is not None and chain.legs:
        first = msgspec.structs.replace(chain.legs[0], most=None)
        chain = msgspec.structs.replace(chain, legs=(first, *chain.legs[1:]))
        fit, late = table.fit(chain), late + 1
    if fit is None:
        return FittedRun(None, table, last.conflicts, late)
    conflicts = last.conflicts + table.count_conflicts(chain, fit)
    table = table.copy()
    table.mark(chain, fit)
    return FittedRun(fit, table, conflicts, late)


# -- the order ---------------------------------------------------------------------------------------


def _suggest(state: LabState, cell: str, layout: PlannedCell, fits: dict[RunId, Fit]) -> OrderSuggested:
    """The timetable as an order. A step without a wait starts exactly when the step before it ends."""
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
    """The runs that should have started a step by now, and have not; one of them may come several times."""
    latest = now - convert_lab_s(state, PUNCTUAL_S)
    for one in order.steps:
        if one.start >= latest:
            return
        run = state.runs.get(one.run)
        if run is not None and (not run.has_started or run.steps[one.step].status == PENDING):
            yield one.run
