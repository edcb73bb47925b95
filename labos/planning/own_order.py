"""Finds an order in which the next motions of a workcell should start, by inserting runs one by one.

An order of motions is a list of runs. Each run stands in it once for each of its remaining motions. If two
runs need the same module, zone or place, the one that is earlier in the list goes first. The simplified model
(``outline``) computes when each step starts. The search takes some runs out of the order, up to half of them
and one more. It puts them back one by one, each at the best place. A motion stands where its run is ready and
the target has room; earlier, if another run needs the place where the run is. So the order stays possible.
This is repeated, and an order that ends sooner is kept.

An order is compared with the order by age, in the same model. It is followed only if all work ends clearly
sooner. A run that ends later than by age counts against it (``Value``).

One turn of the kernel tries about ``AT_ONCE`` orders. Runs that can start do so with the best order so far,
and the search continues from it. The numbers that choose runs are computed from the runs and the count of
orders tried. So a forecast that continues from the same state finds the same order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

import msgspec

from labos.core.ids import RunId
from labos.core.rules import convert_lab_s
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested, Suggested
from labos.planning.outline import Outline, Ways
from labos.planning.supplies import are_enough

OWN = "labos"
"""The author (``by``) of the lab's own orders."""

ENOUGH = 3000
"""The number of orders that are tried for the same runs, over several turns of the kernel."""

AT_ONCE = 60
"""After this many orders, a turn of the kernel takes no more runs out of an order."""

BEFORE_START = 2000
"""The number of orders that are tried before the first run starts in an empty workcell, because a start
cannot be undone."""

BREATH_NS = 2_000_000
"""The pause between two turns of a search (ns). Other work goes on in this time."""

REFRESH_S, REFRESHED = 1.0, 20
"""After ``ENOUGH`` orders, a followed order is computed again after this many lab seconds at the earliest.
This many orders are then tried."""

STALE_S = 60.0
"""An order is barred if a step has still not started this many lab seconds after it could by the model. An
order is valid until this many lab seconds after the end of all work."""

WORSE = 0.25
"""The search may continue from an order that is worse by up to this part of the remaining time."""

GAIN = 0.02
"""An order is followed if it is better than the order by age by this part of the remaining time."""

EQUALLY_OLD_S = 60.0
"""Runs of one user that were submitted within this many lab seconds are equally old."""

Value = tuple[int, int]
"""How good an order is; less is better. First the end of all work (UTC ns), plus the largest loss of a run:
how much later it ends than by age. Then the sum of the ends of all runs."""


Part = tuple[int, int, tuple[int, ...], tuple[int, ...], tuple[int, ...]]
"""A step, its duration (ns), and numbers of the model: what it uses while it lasts, the places where it takes
room from its start, and the places where it frees room at its end."""

FAR = 2**62


class MotionGroup(msgspec.Struct, frozen=True, gc=False):
    """A motion of a run, and the steps after it up to the next motion. ``left`` is the duration of these and
    of all later steps of the run (ns)."""

    parts: tuple[Part, ...]
    left: int


class EquallyOld(msgspec.Struct, frozen=True):
    """Runs of the same age, and their ends by age, the first end first (UTC ns). Which of these runs has
    which end makes no difference."""

    runs: frozenset[RunId]
    ends: tuple[int, ...]


class OwnOrder(msgspec.Struct):
    """The order of a workcell. ``motions`` are the runs of its motions, and ``last`` those of the order with
    which the search ended. ``order`` has the starts of its steps. ``runs`` are those for which it was found,
    ``seen`` is when it was last computed (UTC ns), ``tried`` the number of orders tried. ``by_age`` are the
    ends of runs by age. ``limit`` is the largest value with which an order is followed. Both are from the
    time when the last of these runs was submitted. ``is_followed``: an order had such a value. ``due`` are
    steps that could have started by the model, and since when (UTC ns). If one of them has not started for
    ``STALE_S``, the order is ``barred``: the model does not know what the step waits for."""

    motions: list[RunId]
    last: list[RunId]
    order: OrderSuggested
    runs: frozenset[RunId]
    seen: int
    tried: int
    by_age: tuple[EquallyOld, ...]
    limit: int
    is_followed: bool
    due: dict[tuple[RunId, int], int] = {}
    barred: bool = False


def _list_sequence(order: OrderSuggested | None) -> list[tuple[RunId, int]] | None:
    return None if order is None else [(one.run, one.step) for one in order.steps]


class OwnOrders:
    """The lab's own orders, one for each workcell. ``enough`` orders are tried for the same runs; with 0,
    there is no own order. In an empty workcell, no run starts before ``before_start`` orders have been tried.
    The search continues from the ``known`` orders. With ``weighs_age`` false, the age of runs does not
    count, and each order that is found is followed."""

    def __init__(
        self,
        enough: int = ENOUGH,
        before_start: int = 0,
        known: Mapping[str, OwnOrder] = MappingProxyType({}),
        *,
        weighs_age: bool = True,
    ) -> None:
        self._enough, self._before_start, self._weighs_age = enough, before_start, weighs_age
        self._ways: dict[str, Ways] = {}
        self._known = dict(known)

    @property
    def known(self) -> dict[str, OwnOrder]:
        """The orders found so far, by workcell."""
        return dict(self._known)

    @property
    def is_used(self) -> bool:
        return self._enough > 0

    def __bool__(self) -> bool:
        return bool(self._known)

    def find(self, cell: str) -> OrderSuggested | None:
        """The order of a workcell; None if there is none, or if it is not followed or is barred."""
        known = self._known.get(cell)
        return known.order if known is not None and known.is_followed and not known.barred else None

    def forget(self, cell: str) -> None:
        """Forget the order and the model of a workcell, because its bench has changed."""
        self._ways.pop(cell, None)
        self._known.pop(cell, None)

    def drop(self, cell: str) -> bool:
        """Remove the order of a workcell. Returns whether there was one."""
        return self._known.pop(cell, None) is not None

    def search(
        self, state: LabState, cell: str, inside: Sequence[RunState], waiting: Sequence[RunState], now: int
    ) -> bool:
        """Search for an order for these runs, or for a better one. Returns whether the order of the workcell
        has changed; if none is possible, it is removed."""
        runs = frozenset(run.id for run in (*inside, *waiting))
        known = self._known.get(cell)
        # If the clock was set back, the times of the known order are no longer valid.
        kept = known if known is not None and runs <= known.runs and known.seen <= now else None
        if kept is not None and (kept.barred or now < self._find_next_look(state, kept)):
            return False
        if not are_enough(state, [*inside, *waiting]):
            return self.drop(cell)  # the oldest runs get the supplies
        outline = Outline(state, cell, waiting, now, self._ways.setdefault(cell, Ways()))
        if not outline.is_safe:
            return self.drop(cell)
        found_by_age = (kept.by_age, kept.limit) if kept is not None else self._find_limits(state, outline)
        if found_by_age is None:
            return self.drop(cell)
        by_age, limit = found_by_age
        tried = kept.tried if kept is not None else 0
        search = OrderSearch(outline, by_age, tried)
        if not search.is_possible:
            return self.drop(cell)
        numbers = {run.id: number for number, run in enumerate(outline.runs)}
        lines = (known.motions, known.last) if known is not None else ([], [])
        best, last = ([numbers[run] for run in line if run in numbers] for line in lines)
        improved = search.improve(REFRESHED if tried >= self._enough else AT_ONCE, best, last)
        if improved is None:
            return self.drop(cell)
        found, here = improved
        names = [run.id for run in outline.runs]
        steps = tuple(Suggested(names[who], step, time) for time, who, step in sorted(found.starts))
        until = found.last + convert_lab_s(state, STALE_S)
        was = known.due if known is not None and known.seen <= now else {}
        due = {(one.run, one.step): was.get((one.run, one.step), now) for one in steps if one.start <= now}
        barred = any(now - since > convert_lab_s(state, STALE_S) for since in due.values())
        order = OrderSuggested(cell, OWN, until, steps)
        motions, last_motions = ([names[who] for who in each.order] for each in (found, here))
        tried += search.tried
        is_followed = found.value[0] <= limit or (kept is not None and kept.is_followed)
        runs = runs if kept is None else kept.runs
        before = self.find(cell)
        self._known[cell] = OwnOrder(
            motions, last_motions, order, runs, now, tried, by_age, limit, is_followed, due, barred
        )
        return _list_sequence(before) != _list_sequence(self.find(cell))

    def _find_limits(self, state: LabState, outline: Outline) -> tuple[tuple[EquallyOld, ...], int] | None:
        return _play_by_age(state, outline) if self._weighs_age else ((), FAR)

    def goes_on_at(self, cell: str) -> int | None:
        """The time at which the search continues (UTC ns); None if it is over."""
        known = self._known.get(cell)
        if known is None or known.barred or known.tried >= self._enough:
            return None
        return known.seen + BREATH_NS

    def is_too_early(self, state: LabState, cell: str) -> bool:
        """Whether a workcell is empty and no run should start yet, because too few orders have been tried."""
        known = self._known.get(cell)
        if known is None or known.barred or state.runs.list_inside(cell):
            return False
        return known.tried < min(self._before_start, self._enough)

    def _find_next_look(self, state: LabState, known: OwnOrder) -> int:
        if known.tried >= self._enough and not known.is_followed:
            return FAR
        pause = BREATH_NS if known.tried < self._enough else convert_lab_s(state, REFRESH_S)
        return known.seen + pause


def _play_by_age(state: LabState, outline: Outline) -> tuple[tuple[EquallyOld, ...], int] | None:
    """The ends of the runs if the runs inside go first, and then the oldest; and the largest value with which
    an order is followed instead. None if not all runs reach their ends."""
    play = outline.copy().go_on()
    if any(left > 0 for left in play.left):
        return None
    ends = dict(zip((run.id for run in outline.runs), play.ends, strict=True))
    groups = group_equally_old(state, outline.runs)
    by_age = tuple(
        EquallyOld(frozenset(run.id for run in group), tuple(sorted(ends[run.id] for run in group)))
        for group in groups
    )
    last = max(play.ends)
    return by_age, last - int(GAIN * (last - outline.now))


def group_equally_old(state: LabState, runs: Iterable[RunState]) -> list[list[RunState]]:
    """The runs in groups: those that one user submitted within ``EQUALLY_OLD_S`` are together. In a group,
    the oldest is first."""
    groups: list[list[RunState]] = []
    for run in sorted(runs, key=lambda run: (run.user, run.submitted_at, run.position)):
        first = groups[-1][0] if groups else None
        apart = run.submitted_at - first.submitted_at if first is not None and first.user == run.user else FAR
        if apart <= convert_lab_s(state, EQUALLY_OLD_S):
            groups[-1].append(run)
        else:
            groups.append([run])
    return groups


class FoundOrder(msgspec.Struct, frozen=True):
    """An order with its value and its starts. ``last`` is the end of all work (UTC ns)."""

    value: Value
    last: int
    order: list[int]
    starts: list[tuple[int, int, int]]
    """(time, run, step)"""


class OrderSearch:
    """Searches for an order of the motions of an outline. ``tried`` counts the orders, ``seed`` those that
    were tried before. ``by_age`` are the ends of the runs by age. ``is_possible``: the model fits the runs
    and what is in flight; otherwise do not search."""

    def __init__(self, outline: Outline, by_age: Sequence[EquallyOld], seed: int = 0) -> None:
        self.outline = outline
        self.tried = 0
        self._seed = seed
        numbers = {run.id: number for number, run in enumerate(outline.runs)}
        self._by_age = [([numbers[r] for r in group.runs if r in numbers], group.ends) for group in by_age]
        self._count = len(outline.runs)
        self._room = outline.room
        self._ready = [outline.now] * self._count
        self._held: list[dict[int, int]] = []
        self._free_at = [outline.now] * len(self._room)
        self._slots = [
            [outline.now] * max(0, room - used) for room, used in zip(self._room, outline.used, strict=True)
        ]
        self._before: list[list[Part]] = []
        self._motions: list[list[MotionGroup]] = []
        flying = {who: (end, step) for end, who, step in outline.flying}
        for end, who, step in outline.flying:
            task = outline.ways[who][step]
            self._ready[who] = max(self._ready[who], end)
            for key in task.takes:
                self._free_at[key] = max(self._free_at[key], end)
            for key in task.frees:
                self._slots[key].append(end)
        self.is_possible = len(flying) == len(outline.flying) and all(map(self._read, range(self._count)))
        busy = {key for _, who, step in outline.flying for key in outline.ways[who][step].takes}
        self.is_possible &= all(not taken or key in busy for key, taken in enumerate(outline.busy))

    def _read(self, who: int) -> bool:
        """Read the remaining steps of a run. Returns whether each of them follows the one before."""
        outline = self.outline
        way, times = outline.ways[who], outline.times[who]
        line = self._list_line(who)
        if line is None:
            return False
        before: list[Part] = []
        groups: list[list[Part]] = []
        for step in line:
            task = way[step]
            if task.carries:
                groups.append([])
            (groups[-1] if groups else before).append((step, times[step], task.takes, task.gets, task.frees))
        self._before.append(before)
        left, motions = 0, list[MotionGroup]()
        held: dict[int, int] = {}
        for group in reversed(groups):
            left += sum(part[1] for part in group)
            motions.append(MotionGroup(tuple(group), left))
            _, _, _, gets, frees = group[0]
            for key in frees:
                held[key] = held.get(key, 0) + 1
            for key in gets:
                held[key] = max(0, held.get(key, 0) - 1)
        self._motions.append(motions[::-1])
        self._held.append({key: count for key, count in held.items() if count})
        return True

    def _list_line(self, who: int) -> list[int] | None:
        """The main steps of a run that have not begun, if each follows the one before. None if some steps do
        not wait for each other, or if not all remaining steps are in this line."""
        outline = self.outline
        way, turns = outline.ways[who], outline.turns[who]
        flown = [step for _, other, step in outline.flying if other == who]
        if len(turns) + len(flown) > 1:
            return None
        line: list[int] = []
        at = [*turns, *flown]
        while at:
            if at[0] not in flown:
                line.append(at[0])
            at = [after for after in way[at[0]].followers if way[after].main]
            if len(at) > 1 or any(way[after].before > 1 for after in at):
                return None
        return line if len(line) + len(flown) == max(outline.left[who], 0) else None

    # -- the duration of an order --------------------------------------------------------------------

    def measure(
        self, order: Sequence[int], most: int | None = None, without: frozenset[int] = frozenset()
    ) -> FoundOrder | None:
        """The start of each step in this order, as if the runs ``without`` were not there. None if the order
        is not possible, or if the model shows that a run would end after ``most`` (UTC ns)."""
        self.tried += 1
        free_at, ready = list(self._free_at), list(self._ready)
        slots = [list(times) for times in self._slots]
        at = [0] * self._count
        starts: list[tuple[int, int, int]] = []
        last = total = 0
        for who in without:
            for key, count in self._held[who].items():
                slots[key] += [self.outline.now] * count
        for who, parts in enumerate(self._before):
            if parts and who not in without and not self._go(who, parts, ready, free_at, slots, starts):
                return None
        for who in order:
            motion = self._motions[who][at[who]]
            at[who] += 1
            if not self._go(who, motion.parts, ready, free_at, slots, starts):
                return None
            if most is not None and starts[-len(motion.parts)][0] + motion.left > most:
                return None
        for who, end in enumerate(ready):
            if who not in without:
                total += end
                last = max(last, end)
        return FoundOrder((last + self._find_loss(ready, without), total), last, list(order), starts)

    def _find_loss(self, ends: Sequence[int], without: frozenset[int]) -> int:
        """The largest loss of a run: how much later it ends than by age (ns). Of equally old runs, those that
        are over count as the ones with the first ends."""
        loss = 0
        for group, by_age in self._by_age:
            mine = sorted([ends[who] for who in group if who not in without])
            for end, sooner in zip(reversed(mine), reversed(by_age)):  # noqa: B905  (some are over)
                if end - sooner > loss:
                    loss = end - sooner
        return loss

    def _go(
        self,
        who: int,
        parts: Sequence[Part],
        ready: list[int],
        free_at: list[int],
        slots: list[list[int]],
        starts: list[tuple[int, int, int]],
    ) -> bool:
        """Start these steps of a run one after the other, each as soon as possible. Returns False if at this
        point of the order there is no room for one of them."""
        time = ready[who]
        for step, lasts, takes, gets, frees in parts:
            for key in takes:
                if free_at[key] > time:
                    time = free_at[key]
            for key in gets:
                times = slots[key]
                if not times:
                    return False
                first = min(times)
                times.remove(first)
                if first > time:
                    time = first
            starts.append((time, who, step))
            time += lasts
            for key in takes:
                free_at[key] = time
            for key in frees:
                slots[key].append(time)
        ready[who] = time
        return True

    # -- putting a run into an order -----------------------------------------------------------------

    def insert(self, order: Sequence[int], who: int, out: frozenset[int] = frozenset()) -> FoundOrder | None:
        """The best order after a run is put into this one; None if there is none. The runs ``out`` are
        missing too, and are put back later."""
        gone = out | {who}
        found = self.measure(order, without=gone)
        if found is None:
            return None
        if not self._motions[who]:
            return self.measure(order, without=out)
        used, peaks, begun = self._list_used(found, gone)
        best: FoundOrder | None = None
        seen: set[tuple[int, ...]] = set()
        for first in range(1 if self.outline.inside[who] else len(order) + 1):
            places = self._find_places(who, first, used, peaks, begun)
            if places is None or places in seen:
                continue
            seen.add(places)
            merged: list[int] = []
            done = 0
            for place in places:
                merged += order[done:place]
                merged.append(who)
                done = place
            merged += order[done:]
            other = self.measure(merged, best.value[0] if best is not None else None, without=out)
            if other is not None and (best is None or other.value < best.value):
                best = other
        return best

    def _list_used(
        self, found: FoundOrder, gone: frozenset[int]
    ) -> tuple[list[list[int]], list[list[int]], list[int]]:
        """The pieces that take room at each place: before each motion of an order and after the last, then
        during each motion. Then the start of each motion (UTC ns). Runs that are ``gone`` take no room."""
        floor = list(self.outline.floor)
        for who in gone:
            for key, count in self._held[who].items():
                floor[key] -= count
        used, peaks = [floor], list[list[int]]()
        times = {(who, step): time for time, who, step in found.starts}
        at, begun = [0] * self._count, list[int]()
        for who in found.order:
            step, _, _, gets, frees = self._motions[who][at[who]].parts[0]
            at[who] += 1
            now = list(used[-1])
            for key in gets:
                now[key] += 1
            peaks.append(now)
            now = list(now)
            for key in frees:
                now[key] -= 1
            used.append(now)
            begun.append(times[who, step])
        return used, peaks, begun

    def _find_places(
        self, who: int, first: int, used: list[list[int]], peaks: list[list[int]], begun: list[int]
    ) -> tuple[int, ...] | None:
        """Where in an order the motions of a run stand, if the search begins at ``first``. A motion stands
        where its run is ready and there is room, but before a motion of another run that needs the place
        where the run is. A run from outside has its first motion at ``first``. None if not possible."""
        room, length = self._room, len(begun)
        held = dict(self._held[who])
        places: list[int] = []
        place = first
        ready = self._ready[who] + sum(part[1] for part in self._before[who])
        is_outside = not self.outline.inside[who]
        for motion in self._motions[who]:
            _, _, _, gets, frees = motion.parts[0]
            sets_out = is_outside and not places
            last: int | None = None
            while True:
                if all(used[place][key] + held.get(key, 0) < room[key] for key in gets):
                    last = place
                    if sets_out or place == length or begun[place] >= ready:
                        break
                if sets_out or place == length:
                    break
                if any(peaks[place][key] + count > room[key] for key, count in held.items()):
                    break
                place += 1
            if last is None:
                return None
            place = last
            places.append(place)
            for key in gets:
                held[key] = held.get(key, 0) + 1
            for key in frees:
                held[key] = held.get(key, 0) - 1
            ready = max(ready, begun[place - 1] if place else 0) + sum(part[1] for part in motion.parts)
        return tuple(places)

    # -- the search ----------------------------------------------------------------------------------

    def improve(
        self, most: int, order: Sequence[int] = (), last: Sequence[int] = ()
    ) -> tuple[FoundOrder, FoundOrder] | None:
        """The best order found, and the order with which the search ended; None if none is found. It begins
        with the best ``order`` so far and with ``last``, with which the previous search ended. After ``most``
        tried orders, no more runs are taken out."""
        best = self._complete(list(order)) or self._complete([])
        if best is None:
            return None
        here, draw = (self._complete(list(last)) if last else None) or best, self._draw()
        stop = self.tried + most
        while self.tried < stop and self._count > 1:
            left = list(range(self._count))
            out = [left.pop(next(draw) % len(left)) for _ in range(1 + next(draw) % (self._count // 2 + 1))]
            rest = [who for who in here.order if who in left]
            other: FoundOrder | None = None
            while out:
                who = out.pop()
                other = self.insert(rest, who, frozenset(out))
                if other is None:
                    break
                rest = other.order
            if other is None:
                continue
            over = (here.value[0] - self.outline.now) * WORSE * (next(draw) % 100) / 100
            if other.value <= here.value or other.value[0] <= here.value[0] + over:
                here = other
            if other.value < best.value:
                best = other
        return best, here

    def _complete(self, order: list[int]) -> FoundOrder | None:
        """An order with all remaining motions; None if there is none. Motions that have begun are left out.
        New runs are put in: first the runs inside, then the longest, and of equally long ones the youngest. A
        run that is put in later stands in front of equal ones."""
        kept: list[int] = []
        left = [len(motions) for motions in self._motions]
        for who in reversed(order):
            if left[who]:
                left[who] -= 1
                kept.append(who)
        new = [who for who in range(self._count) if left[who]]
        rest = [who for who in reversed(kept) if who not in new]
        new.sort(key=lambda who: (not self.outline.inside[who], -self._motions[who][0].left, -who))
        found: FoundOrder | None = None
        while new:
            who = new.pop(0)
            found = self.insert(rest, who, frozenset(new))
            if found is None:
                return None
            rest = found.order
        return found or self.measure(rest)

    def _draw(self) -> Iterator[int]:
        """Pseudorandom numbers, the same for the same runs after the same number of tried orders."""
        seed = sum(run.position for run in self.outline.runs) * 1_000_003 + self._seed
        return (number >> 33 for number in draw_numbers(seed))


def draw_numbers(seed: int) -> Iterator[int]:
    """Pseudorandom numbers of 64 bits. The same seed gives the same numbers."""
    while True:
        seed = (seed * 6364136223846793005 + 1442695040888963407) % 2**64
        yield seed
