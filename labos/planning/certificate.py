"""Whether a run that is alone on the bench can keep its windows for all durations of its steps.

The lab decides when a step starts, and learns its end only when the step has ended. So this is dynamic
controllability of a simple temporal network with uncertainty. It is checked as in P. Morris, "Dynamic
controllability and dispatchability relationships", CPAIOR 2014 (O(n³)). From each node into which negative
edges lead, distances are followed backwards. A node that is met again while it is followed is on a negative
cycle. Such a cycle goes through a window, and the window is missed by at most the cycle's length.

Steps that need the same module or zone go one after the other, in the order of the plan. With another order,
a window that is missed here might be kept. No step fails and none is left out; a start takes no time.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from typing import Literal

import msgspec

from labos.core.branches import sort_by_predecessors
from labos.core.model import MAIN, Plan, Workcell
from labos.planning.forecast import MARGIN
from labos.planning.timetable import find_before, find_occupied, find_setups

SPREAD = round(MARGIN - 1, 9)
"""The part of its nominal duration by which a step may be shorter or longer."""

US = 1_000_000
"""Microseconds in a second. Times are whole microseconds, so that sums are exact."""

MOST_CYCLES = 1_000
"""From this number of cycles on, each further cycle removes its window from the check. The ``breaks_by_s``
that was found for it is then a lower bound."""

MOST_STEPS = 500
"""The most steps of a plan whose windows are checked together. In a longer plan, each is checked by
itself."""

Range = tuple[float, float]
"""The shortest and the longest duration of a step, in seconds."""


class StepTime(msgspec.Struct, frozen=True):
    """A step, and its duration when a window is missed (seconds)."""

    step: str
    takes_s: float


class WindowVerdict(msgspec.Struct, frozen=True):
    """A window of a run: ``step`` (``index`` in the plan) starts at least ``wait_s`` and at most ``within_s``
    after the end of ``anchor``. It can be missed by ``breaks_by_s`` seconds (0: it can be kept). It is missed
    by this time if the steps of ``path`` have the durations that are given there."""

    index: int
    step: str
    anchor: str
    wait_s: float
    within_s: float | None
    breaks_by_s: float = 0.0
    path: tuple[StepTime, ...] = ()

    @property
    def is_kept(self) -> bool:
        return not self.breaks_by_s


class Certificate(msgspec.Struct, frozen=True):
    """The verdict on each window of a plan. ``spread`` is the part by which durations vary. ``left_out`` are
    the steps with windows whose clock another run starts; there is no verdict on these windows. ``is_whole``
    is false if the plan is too long to check all windows together."""

    spread: float
    windows: tuple[WindowVerdict, ...] = ()
    left_out: tuple[str, ...] = ()
    is_whole: bool = True

    @property
    def is_kept(self) -> bool:
        """Whether all windows can be kept together."""
        return self.is_whole and all(window.is_kept for window in self.windows)


class _Edge(msgspec.Struct, frozen=True, eq=False):
    """``end`` comes at most ``weight`` µs after ``start``. ``case`` says whether a step may take its longest
    duration there (upper case) or its shortest (lower case); ``step`` is that step. ``window`` is the number
    of the window for which the edge stands. ``parts`` are the edges from which it was derived."""

    start: int
    end: int
    weight: int
    case: Literal["", "longest", "shortest"] = ""
    step: int | None = None
    window: int | None = None
    parts: tuple[_Edge, ...] = ()

    def expand(self) -> Iterator[_Edge]:
        """The edges of the network for which this edge stands."""
        open_ = [self]
        while open_:
            edge = open_.pop()
            if edge.parts:
                open_ += reversed(edge.parts)
            else:
                yield edge


def certify(
    plan: Plan,
    workcell: Workcell | None = None,
    *,
    spread: float = SPREAD,
    ranges: Sequence[Range] | None = None,
) -> Certificate:
    """The certificate of a plan: whether each window can be kept, together with the others, for all durations
    of the steps. ``ranges`` are the durations of all steps, in place of the nominal durations ± ``spread``
    with set-ups; the zones are the workcell's. A window has to be wider by ``breaks_by_s``, if all others are
    as wide as necessary. Of several windows that cannot be kept together, the last one is reported as
    missed."""
    order = find_order(plan)
    limits = ranges or _find_limits(plan, workcell, order, spread)
    place = {step: position for position, step in enumerate(order)}
    main = [index for index, step in enumerate(plan.steps) if step.part == MAIN]
    known = [
        (index, window.anchor, window)
        for index in main
        for window in plan.steps[index].windows
        if window.anchor is not None and {index, window.anchor} <= place.keys()
    ]
    outer = [plan.steps[i].key for i in main if any(window.of for window in plan.steps[i].windows)]
    fixed = _Fixed()
    fixed.add_durations(order, limits)
    for step in order:
        for before in sorted(find_before(plan.steps[step])):
            fixed.follow(step, before)
    for sooner, later in _find_neighbours(plan, workcell, order):
        fixed.follow(later, sooner)
    for index, anchor, window in known:
        fixed.follow(index, anchor, _convert_to_us(window.wait_s))
    width = {
        number: _convert_to_us(window.within_s)
        for number, (_, _, window) in enumerate(known)
        if window.within_s is not None
    }
    sources = [node for step in reversed(order) for node in (_end(step), _number_end(step), _begin(step))]
    broken: dict[int, int] = {}
    paths: dict[int, tuple[StepTime, ...]] = {}
    for number, most in width.items():
        index, anchor, _ = known[number]
        between, path = _find_longest_path(fixed, order[place[anchor] : place[index] + 1])
        if between > most:
            broken[number] = between - most
            paths[number] = tuple(StepTime(plan.steps[step].key, limits[step][1]) for step in path)
    width = {number: most + broken.get(number, 0) for number, most in width.items()}
    cycles = 0
    is_whole = len(main) <= MOST_STEPS or not width
    while width and is_whole:
        edges = [_Edge(_end(known[n][1]), _begin(known[n][0]), most, window=n) for n, most in width.items()]
        ways = _find_negative_cycle([*fixed.edges, *edges], sources)
        if not ways:
            break
        cycle = [part for way in ways for edge in way for part in edge.expand()]
        through = [edge.window for edge in cycle if edge.window is not None]
        blamed = max(through, key=lambda n: (place[known[n][0]], n))
        short = _find_shortfall(ways, blamed)
        broken[blamed] = broken.get(blamed, 0) + short
        paths[blamed] = _list_taken(plan, cycle, limits, place)
        cycles += 1
        if cycles < MOST_CYCLES:
            width[blamed] += short
        else:
            del width[blamed]
    verdicts = [
        WindowVerdict(
            index,
            plan.steps[index].key,
            plan.steps[anchor].key,
            window.wait_s,
            window.within_s,
            broken.get(number, 0) / US,
            paths.get(number, ()),
        )
        for number, (index, anchor, window) in enumerate(known)
    ]
    return Certificate(spread, tuple(verdicts), tuple(outer), is_whole)


def _find_limits(plan: Plan, workcell: Workcell | None, order: Sequence[int], spread: float) -> list[Range]:
    """The shortest and the longest duration of each step, with the set-up of its module. Only the first of
    the steps with a set-up on a module may find the module set up already."""
    setups = find_setups(plan, workcell, order) if workcell is not None else {}
    first: dict[str, int] = {}
    for index in order:
        if index in setups:
            first.setdefault(plan.steps[index].module, index)
    found: list[Range] = []
    for index, step in enumerate(plan.steps):
        setup_s = setups.get(index, 0.0)
        sure_s = 0.0 if first.get(step.module) == index else setup_s
        found.append(((step.duration_s + sure_s) * (1 - spread), (step.duration_s + setup_s) * (1 + spread)))
    return found


def find_order(plan: Plan) -> list[int]:
    """The steps of the workflow itself. Each is after those that it waits for; otherwise they are in written
    order."""
    main = {index: step for index, step in enumerate(plan.steps) if step.part == MAIN}
    return sort_by_predecessors(
        {index: [before for before in find_before(step) if before in main] for index, step in main.items()}
    )


# -- the network: for each step its start, its earliest possible end, and its end ---------------------


def _begin(step: int) -> int:
    return 3 * step


def _number_end(step: int) -> int:
    return 3 * step + 1


def _end(step: int) -> int:
    return 3 * step + 2


def _convert_to_us(seconds: float) -> int:
    return round(seconds * US)


class _Fixed:
    """The network without the upper limits of windows: durations, and the steps that each step follows, with
    the waits (µs)."""

    def __init__(self) -> None:
        self.edges: list[_Edge] = []
        self.longest: dict[int, int] = {}
        self.before: dict[int, list[tuple[int, int]]] = {}

    def add_durations(self, steps: Sequence[int], limits: Sequence[Range]) -> None:
        for step in steps:
            least, most = _convert_to_us(limits[step][0]), _convert_to_us(limits[step][1])
            begin, sure, end = _begin(step), _number_end(step), _end(step)
            self.longest[step] = most
            self.edges += (_Edge(begin, sure, least), _Edge(sure, begin, -least, step=step))
            self.edges += (_Edge(sure, end, most - least), _Edge(end, sure, 0))
            self.edges += (
                _Edge(sure, end, 0, "shortest", step),
                _Edge(end, sure, least - most, "longest", step),
            )

    def follow(self, step: int, before: int, wait: int = 0) -> None:
        """Let a step start at least ``wait`` µs after the end of another step."""
        self.edges.append(_Edge(_begin(step), _end(before), -wait))
        self.before.setdefault(step, []).append((before, wait))


def _find_neighbours(
    plan: Plan, workcell: Workcell | None, order: Sequence[int]
) -> Iterator[tuple[int, int]]:
    """The pairs of steps that follow one another on a module or in a zone."""
    last: dict[str, int] = {}
    for step in order:
        for name in find_occupied(plan.steps[step], workcell):
            if name in last:
                yield last[name], step
            last[name] = step


def _find_longest_path(fixed: _Fixed, steps: Sequence[int]) -> tuple[int, list[int]]:
    """The time from the end of the first of these steps to the start of the last one (µs), and the steps
    between them on the longest path. The steps are in order, and all take their longest duration."""
    first, last = steps[0], steps[-1]
    ends: dict[int, tuple[int, int]] = {first: (0, first)}
    starts: dict[int, tuple[int, int]] = {}
    for step in steps[1:]:
        known = [(ends[b][0] + wait, b) for b, wait in fixed.before.get(step, ()) if b in ends]
        if known:
            starts[step] = max(known)
            ends[step] = (starts[step][0] + fixed.longest[step], step)
    path = []
    step = starts[last][1]
    while step != first:
        path.append(step)
        step = starts[step][1]
    return starts[last][0], path[::-1]


def _list_taken(
    plan: Plan, cycle: Sequence[_Edge], limits: Sequence[Range], place: dict[int, int]
) -> tuple[StepTime, ...]:
    """The steps of a cycle with their durations there, in the order of the plan. A step that occurs with both
    its longest and its shortest duration does not matter."""
    cases: dict[int, set[str]] = {}
    for edge in cycle:
        if edge.step is not None:
            cases.setdefault(edge.step, set()).add(edge.case)
    times = {
        step: limits[step]["longest" in found]
        for step, found in cases.items()
        if not {"longest", "shortest"} <= found
    }
    return tuple(StepTime(plan.steps[step].key, times[step]) for step in sorted(times, key=place.__getitem__))


def _find_shortfall(ways: Sequence[Sequence[_Edge]], window: int) -> int:
    """By how much a window has to be wider so that a cycle through it disappears (µs). This is the cycle's
    length for each pass through the window. Less is enough if a step may then take its shortest duration
    again. No smaller value helps."""
    total = sum(edge.weight for way in ways for edge in way)
    found = [-(total // sum(_count_passes(edge, window) for way in ways for edge in way))]
    open_ = list(ways)
    while open_:
        sum_, passes = 0, 0
        for edge in reversed(open_.pop()):
            if edge.parts:
                open_.append(edge.parts)
            elif edge.case == "shortest" and passes:
                found.append(-(sum_ // passes))
            sum_ += edge.weight
            passes += _count_passes(edge, window)
    return min(found)


def _count_passes(edge: _Edge, window: int) -> int:
    return sum(part.window == window for part in edge.expand())


# -- Morris 2014 ---------------------------------------------------------------------------------------


class _Search:
    """The edges by the node at which they end, and the nodes from which everything was followed
    (``done``)."""

    def __init__(self, edges: Sequence[_Edge]) -> None:
        self.into: dict[int, list[_Edge]] = {}
        for edge in edges:
            self.into.setdefault(edge.end, []).append(edge)
        self.negative = {edge.end for edge in edges if edge.weight < 0}
        self.done: set[int] = set()

    def follow(self, source: int) -> Iterator[tuple[int, list[_Edge]]]:
        """Follow paths that lead to ``source`` backwards while they are negative. Where a path stops being
        negative, add it as an edge. Yields the negative nodes on the way that are not done, each with the
        path from there."""
        least: dict[int, int] = {}
        first: dict[int, _Edge] = {}
        queue: list[tuple[int, int]] = []
        own: int | None = None
        for edge in self.into.get(source, ()):
            if edge.weight < 0 and edge.weight < least.get(edge.start, 0):
                least[edge.start], first[edge.start] = edge.weight, edge
                heapq.heappush(queue, (edge.weight, edge.start))
                own = edge.step if edge.case == "longest" else own
        passed: set[int] = set()
        while queue:
            distance, node = heapq.heappop(queue)
            if node in passed:
                continue
            passed.add(node)
            if distance >= 0 and node == source:
                continue
            if distance >= 0:
                parts = tuple(self._find_path(node, source, first))
                self.into.setdefault(source, []).append(_Edge(node, source, distance, parts=parts))
                continue
            if node in self.negative and node not in self.done:
                yield node, self._find_path(node, source, first)
            for edge in self.into.get(node, ()):
                is_own = edge.case == "shortest" and edge.step == own
                if edge.weight < 0 or is_own or edge.start in passed:
                    continue
                if distance + edge.weight < least.get(edge.start, distance + edge.weight + 1):
                    least[edge.start], first[edge.start] = distance + edge.weight, edge
                    heapq.heappush(queue, (distance + edge.weight, edge.start))

    def _find_path(self, node: int, source: int, first: dict[int, _Edge]) -> list[_Edge]:
        path = [first[node]]
        while path[-1].end != source:
            path.append(first[path[-1].end])
        return path


def _find_negative_cycle(edges: Sequence[_Edge], sources: Sequence[int]) -> list[list[_Edge]]:
    """The paths of a cycle that no strategy can satisfy, each to the node from which it was followed. Empty
    if the network is dynamically controllable. ``sources`` are nodes in the order in which they are
    followed."""
    search = _Search(edges)
    negative = [node for node in sources if node in search.negative]
    negative += search.negative.difference(negative)
    for source in negative:
        if source in search.done:
            continue
        stack = [(source, search.follow(source))]
        ways: list[list[_Edge]] = []
        while stack:
            node, steps = stack[-1]
            met = next(steps, None)
            if met is None:
                search.done.add(node)
                stack.pop()
                ways = ways[: len(stack) - 1] if stack else []
                continue
            deeper, path = met
            above = next((n for n, (other, _) in enumerate(stack) if other == deeper), None)
            if above is not None:
                return [path, *reversed(ways[above:])]
            ways.append(path)
            stack.append((deeper, search.follow(deeper)))
    return []
