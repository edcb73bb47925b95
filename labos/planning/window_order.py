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

from labos.core.actions import Action, ActionStatus
from labos.core.effects import Carrying, Consumes, Needs
from labos.core.ids import RunId, deck_key, run_owner
from labos.core.model import MAIN, Plan
from labos.core.rules import convert_lab_s
from labos.core.runs import IN_FLIGHT, PENDING, SETTLED, RunState, RunStatus, find_anchor, find_holds
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested, Suggested
from labos.planning.chains import Chain, Fit, Leg, SlotTable
from labos.planning.forecast import find_usual_time
from labos.planning.outline import Task, Ways
from labos.planning.taken import find_station
from labos.planning.window_waits import WaitSpan, share_waits

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

MOST_SLOTS = 2048
"""So many slots all steps take together, at most."""

SLOTS_S = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 300.0, 900.0, 3600.0)
"""The lengths of a slot (lab seconds) of which the shortest that will do is taken."""

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

KNOWN = (Carrying, Needs, Consumes)
"""Effects that the timetable knows."""

Value = tuple[int, float]
"""How many runs do not fit in or are overtaken too often, and when all is over: less is better."""


class StepChain(msgspec.Struct, frozen=True):
    """A plan whose main steps follow one another: their numbers, and for each how long the run has to wait
    before it at least, and may at most (ns of wall time; None: no limit)."""

    steps: tuple[int, ...]
    least: tuple[int, ...]
    most: tuple[int | None, ...]


class PlannedRun(msgspec.Struct):
    """A run in the timetable."""

    run: RunState
    first: int
    """The first of its steps, in its line, that has not started."""
    line: StepChain
    chain: Chain
    end: int
    """When what is under way ends (UTC ns)."""
    limit: int = 0
    """So many younger runs may still be let in before it."""


class PlannedCell(msgspec.Struct):
    """What is laid out: the runs, the older ones first, and the timetable without them."""

    members: dict[RunId, PlannedRun]
    table: SlotTable
    slot: int
    now: int


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
        layout = _lay_out(state, cell, ways, [*inside, *waiting], now)
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


# -- reading the state -----------------------------------------------------------------------------


def _lay_out(
    state: LabState, cell: str, ways: Ways, runs: Sequence[RunState], now: int
) -> PlannedCell | None:
    """The runs of a workcell and those that wait, as chains; None if some run is none."""
    lines: list[tuple[RunState, StepChain, tuple[Task, ...]]] = []
    lengths: dict[RunId, dict[int, int]] = {}
    for run in runs:
        if run.has_started and (run.status != RunStatus.ACTIVE or find_holds(run)):
            return None
        plan = state.runs.plan_of(run)
        durations = {i: find_usual_time(state, plan.steps[i]) for i in range(len(plan.steps))}
        line = _read_line(state, plan, durations)
        if line is None:
            return None
        lines.append((run, line, ways.read(state, run.plan)))
        lengths[run.id] = durations
    total = sum(lengths[run.id][step] for run, line, _ in lines for step in line.steps)
    total += sum(sum(line.least) for _, line, _ in lines)
    slot = _choose_slot(state, [t for each in lengths.values() for t in each.values()], total)
    flying = {(a.run, a.step): a for a in state.actions.list_in_cell(cell)}
    members: dict[RunId, PlannedRun] = {}
    for run, line, tasks in lines:
        member = _make_member(state, run, line, tasks, ways, lengths[run.id], slot, now, flying)
        if member is None:
            return None
        members[run.id] = member
    table = SlotTable(len(ways.room), int(total / slot * 1.3) + 64)
    owners = {run_owner(run.id) for run in runs}
    for key, number in ways.numbers.items():
        station = find_station(state, key)
        if station is None or station.spec.kind in ("stack", "waste"):
            continue
        if any(state.bench.labware[labware].owner not in owners for labware in station.labware):
            if ways.room[number] == 1:
                table.taken[number] = table.full
            deck = ways.numbers.get(deck_key(station.spec.claim))
            if deck is not None and station.spec.claim:
                table.taken[deck] = table.full
    return PlannedCell(dict(sorted(members.items(), key=lambda item: item[1].run.position)), table, slot, now)


def _read_line(state: LabState, plan: Plan, durations: dict[int, int]) -> StepChain | None:
    """The main steps of a plan, if they follow one another and its windows are its own."""
    if plan.holds or any(not isinstance(effect, KNOWN) for step in plan.steps for effect in step.effects):
        return None  # doors, setpoints and the like are not in the timetable
    steps = [i for i, step in enumerate(plan.steps) if step.part == MAIN]
    place = {step: number for number, step in enumerate(steps)}
    spans: list[WaitSpan] = []
    for number, index in enumerate(steps):
        step = plan.steps[index]
        if set(step.after) != set(steps[max(0, number - 1) : number]) or step.by_person:
            return None
        for window in step.windows:
            if window.anchor is None or place.get(window.anchor, number) >= number:
                return None
            first = place[window.anchor] + 1
            between = sum(durations[i] for i in steps[first:number])
            # A move that is known to last longer than its window is followed at once.
            left = None if window.within_s is None else convert_lab_s(state, window.within_s) - between
            limit = None if left is None else max(0, left)
            spans.append(WaitSpan(first, number, convert_lab_s(state, window.wait_s) - between, limit))
    waits = share_waits(len(steps), spans)
    return None if waits is None else StepChain(tuple(steps), *waits)


def _choose_slot(state: LabState, lengths: Iterable[int], total: int) -> int:
    """How long a slot is (ns of wall time)."""
    whole = math.gcd(*lengths)
    if whole and total <= MOST_SLOTS * whole:
        return whole
    return next(
        (slot for slot in (convert_lab_s(state, s) for s in SLOTS_S) if total <= MOST_SLOTS * slot),
        max(1, total // MOST_SLOTS),
    )


def _up(time: int, slot: int) -> int:
    """So many slots; what is a twentieth over does not count."""
    return max(0, -(-(time - slot // 20) // slot))


def _make_member(
    state: LabState,
    run: RunState,
    line: StepChain,
    tasks: tuple[Task, ...],
    ways: Ways,
    durations: dict[int, int],
    slot: int,
    now: int,
    flying: dict[tuple[RunId, int], Action],
) -> PlannedRun | None:
    statuses = run.statuses if run.has_started else []
    first, begins, held = 0, None, dict[int, int]()
    in_progress: tuple[int, ...] = ()
    plan = state.runs.plan_of(run)
    end = now
    for number, index in enumerate(line.steps if statuses else ()):
        status = statuses[index]
        if status == PENDING:
            break
        first = number + 1
        _carry(held, tasks[index], is_over=status in SETTLED)
        if status in SETTLED:
            continue
        action = flying.get((run.id, index))
        if status != IN_FLIGHT or action is None or action.status == ActionStatus.UNKNOWN:
            return None
        end = max(now, action.requested_at + durations[index])
        in_progress = tasks[index].takes
    if statuses:
        if any(statuses[index] != PENDING for index in line.steps[first:]):
            return None
        begins = _up(end - now, slot)
        for index in line.steps[first - 1 : first] if in_progress else ():
            frees = tasks[index].frees
            after = dict(held)
            for key in frees:
                after[key] = after.get(key, 0) - 1
            in_progress = (*in_progress, *(key for key in frees if ways.room[key] == 1))
            held = after
    legs: list[Leg] = []
    for number in range(first, len(line.steps)):
        index = line.steps[number]
        task = tasks[index]
        least, most = line.least[number], line.most[number]
        if statuses:
            least, most = _since_clocks(state, run, plan, line, number, first, durations, end, least, most)
        takes = dict.fromkeys(k for k in (*task.takes, *task.gets) if ways.room[k] == 1)
        holds = tuple(key for key, count in held.items() if count > 0 and ways.room[key] == 1)
        wait = _up(least, slot)
        longest = None if most is None else max(wait, most // slot)
        legs.append(
            Leg(
                tuple(k for k in takes if k not in holds),
                holds,
                max(1, _up(durations[index], slot)),
                wait,
                longest,
            )
        )
        _carry(held, task, is_over=True)
    keeps = tuple(key for key, count in held.items() if count > 0 and ways.room[key] == 1)
    return PlannedRun(run, first, line, Chain(tuple(legs), begins, in_progress, keeps), end)


def _carry(held: dict[int, int], task: Task, *, is_over: bool) -> None:
    """What a run holds after a step, or while it is under way."""
    for key in task.gets:
        held[key] = held.get(key, 0) + 1
    for key in task.frees if is_over else ():
        held[key] = max(0, held.get(key, 0) - 1)


def _since_clocks(
    state: LabState,
    run: RunState,
    plan: Plan,
    line: StepChain,
    number: int,
    first: int,
    durations: dict[int, int],
    end: int,
    least: int,
    most: int | None,
) -> tuple[int, int | None]:
    """How long a run waits before a step (ns), with the clocks that run already."""
    if number != first:
        return least, most
    least, most = 0, None
    for later in range(first, len(line.steps)):
        for window in plan.steps[line.steps[later]].windows:
            assert window.anchor is not None  # of another run's clock nothing is known: see _read_line
            anchor = line.steps.index(window.anchor)
            ended = find_anchor(run, window)
            if ended is None and anchor == first - 1:
                ended = end
            if ended is None or anchor >= first or run.is_breached(line.steps[later]):
                continue
            between = sum(durations[i] for i in line.steps[first:later])
            behind = slice(first + 1, later + 1)
            waits = sum(line.least[behind])
            least = max(least, ended + convert_lab_s(state, window.wait_s) - between - waits - end)
            if window.within_s is not None:
                waits = sum(limit or 0 for limit in line.most[behind])
                left = max(0, ended + convert_lab_s(state, window.within_s) - between - waits - end)
                most = left if most is None else min(most, left)
    return least, most


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
