"""What a start would occupy, and for how long: by learned durations, or by nominal ones if too few are known.

A forecast may be wrong. It is good enough to keep room for runs with windows. No rule that must always hold
depends on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType

from labos.core.actions import Action
from labos.core.algebra import compute_settings_after, list_away_from_rest
from labos.core.effects import Carrying, list_carried
from labos.core.ids import StationName, module_key, station_key, zone_key
from labos.core.model import Plan, PlanStep, Window
from labos.core.plans import PlanState
from labos.core.rules import convert_lab_s
from labos.core.runs import PENDING, SETTLED, RunState, find_anchor
from labos.core.state import LabState
from labos.core.zones import find_zones

MARGIN = 1.1
"""The factor by which a forecast lengthens each duration, because durations vary. If the longest learned
duration is longer, it counts instead."""

FOR_EVER = 2**62
"""The duration (ns) of a stay that no step of the run ends."""


def find_longest_time(state: LabState, step: PlanStep) -> int:
    """The longest time that a step takes if nothing is in its way, with its set-up (ns of wall time)."""
    known = state.lengths.estimate(step, state.lab.pace)
    if known is not None:
        return max(known.high, int(known.usual * MARGIN)) + find_setup_ns(state, step)
    return convert_lab_s(state, step.duration_s * MARGIN) + find_setup_ns(state, step)


def find_usual_time(state: LabState, step: PlanStep) -> int:
    """The usual time that a step takes, with its set-up (ns of wall time)."""
    known = state.lengths.estimate(step, state.lab.pace)
    own = known.usual if known is not None else convert_lab_s(state, step.duration_s)
    return own + find_setup_ns(state, step)


def find_setup_ns(state: LabState, step: PlanStep) -> int:
    """How much longer a step would take now because of its module's set-up (ns of wall time)."""
    module = state.modules.by_name.get(step.module)
    if module is None or module.spec.setup is None:
        return 0
    return convert_lab_s(state, module.spec.setup.compute_cost_s(module.set_up_for, step.args))


def find_setup_in_progress(state: LabState, action: Action) -> int:
    """How much longer an action in flight takes because of its module's set-up (ns of wall time)."""
    flight = state.modules.by_name[action.module].in_flight.get(action.id)
    return convert_lab_s(state, flight.setup_s) if flight is not None and flight.setup_s else 0


def find_spread(state: LabState, step: PlanStep) -> int:
    """The difference between a step's longest and shortest time (ns of wall time). The shortest time has no
    set-up: the module may be set up for the step by then."""
    known = state.lengths.estimate(step, state.lab.pace)
    if known is not None:
        margin = int(known.usual * (MARGIN - 1))
        own = max(known.high, known.usual + margin) - min(known.low, known.usual - margin)
    else:
        own = convert_lab_s(state, step.duration_s * 2 * (MARGIN - 1))
    return own + find_setup_ns(state, step)


def find_run(state: LabState, name: str) -> RunState:
    """The run with this name, which has not ended."""
    run = state.runs.get(name)
    assert run is not None
    return run


def is_pending(run: RunState, index: int) -> bool:
    """Whether a step has not started. True for each step of a run that has not started."""
    return not run.has_started or run.steps[index].status == PENDING


def list_ready_steps(state: LabState, run: RunState) -> list[int]:
    """The pending steps of a started run for which all steps before them are done."""
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


def list_left(state: LabState, run: RunState) -> list[PlanStep]:
    """The steps of a run inside that have not ended."""
    steps = state.runs.plan_of(run).steps
    return [step for step, at in zip(steps, run.steps, strict=True) if at.status not in SETTLED]


def list_clocked(plan: PlanState, index: int) -> list[int]:
    """The steps that have to start within a limited time after the end of this step."""
    if not plan.windowed:
        return []
    return [
        follower
        for follower in plan.windowed
        for window in plan.plan.steps[follower].windows
        if window.anchor == index and window.within_s is not None
    ]


def takes_from(step: PlanStep, place: StationName) -> bool:
    """Whether a step carries labware with an id away from a place."""
    return any(what.emptied == place and not what.stock for what in list_carried(step.effects))


def find_pending_before(run: RunState, plan: Plan, index: int) -> list[int]:
    """The pending steps that have to start before this step can, in a possible order. The step itself is the
    last."""
    left = {index}
    open_ = [index]
    while open_:
        for before in plan.steps[open_.pop()].after:
            if before not in left and is_pending(run, before):
                left.add(before)
                open_.append(before)
    chain: list[int] = []
    while left:
        for step in sorted(left):
            if left.isdisjoint(plan.steps[step].after):
                left.remove(step)
                chain.append(step)
    return chain


def list_uses(state: LabState, run: RunState, index: int, now: int) -> dict[str, int]:
    """The modules, stations and zones (as keys) that a step takes from other runs if it starts now, and for
    how long (ns). It takes them while it is carried out, or while its labware stands where it was brought. It
    also takes them while a door or lid is not at rest, or while the plan holds a module."""
    found: dict[str, int] = {}
    for key, time in _list_uses(state, run, index, now):
        found[key] = max(found.get(key, 0), time)
    return found


def _list_uses(state: LabState, run: RunState, index: int, now: int) -> Iterator[tuple[str, int]]:
    plan = state.runs.plan_of(run)
    step = plan.steps[index]
    takes = find_longest_time(state, step)
    for hold in plan.holds:
        if hold.first == index:
            yield module_key(hold.module), _measure_to_end(state, run, index, hold.last, now)
    if step.exclusive:
        yield module_key(step.module), takes
        for zone in find_zones(state, step.module, step.effects):
            yield zone_key(zone), takes
    for effect in step.effects:
        if isinstance(effect, Carrying):
            for place in effect.entered:
                yield from _find_reached(state, place, takes)
            if effect.via:
                yield station_key(effect.via), takes
            if effect.filled:
                yield from _list_arrivals(state, run, index, effect.filled, now)
    module = state.modules.by_name.get(step.module)
    rest = module.spec.rest if module is not None else {}
    left = compute_settings_after(step.effects).variables if rest else {}
    for variable in list_away_from_rest(left, rest):

        def closes(other: PlanStep, variable: str = variable) -> bool:
            after = compute_settings_after(other.effects).variables
            return other.module == step.module and after.get(variable) == rest[variable]

        yield module_key(step.module), _measure_until(state, run, index, now, closes)


def _find_reached(state: LabState, place: StationName, takes: int) -> Iterator[tuple[str, int]]:
    spec = state.bench.stations[place].spec
    if spec.module and not spec.stands_apart:
        yield module_key(spec.module), takes


def _list_arrivals(
    state: LabState, run: RunState, index: int, place: StationName, now: int
) -> Iterator[tuple[str, int]]:
    """What labware occupies at the place to which a step brings it, until a later step carries it away."""
    station = state.bench.stations[place]
    if station.spec.kind == "waste":
        return
    stay = _measure_until(state, run, index, now, lambda step: takes_from(step, place))
    if station.count + 1 >= station.spec.capacity:
        yield station_key(place), stay
    if (station.spec.claim or station.spec.kind == "gripper") and station.spec.module:
        yield module_key(station.spec.module), stay


def _measure_until(
    state: LabState, run: RunState, index: int, now: int, ends: Callable[[PlanStep], bool]
) -> int:
    """The time from a step's start to the end of the next pending step for which ``ends`` is true (ns). The
    steps that have to come before it are added one after the other, with their waits. ``FOR_EVER`` if there
    is no such step."""
    plan = state.runs.plan_of(run)
    later = (i for i, step in enumerate(plan.steps) if i != index and is_pending(run, i) and ends(step))
    last = next(later, None)
    return FOR_EVER if last is None else _measure_to_end(state, run, index, last, now)


def _measure_to_end(state: LabState, run: RunState, index: int, last: int, now: int) -> int:
    plan = state.runs.plan_of(run)
    time = find_longest_time(state, plan.steps[index])
    if last == index:
        return time
    known = {index: now + time}
    for step in find_pending_before(run, plan, last):
        if step != index:
            begin = max(now + time, find_earliest_start(state, run, step, known))
            time = begin + find_longest_time(state, plan.steps[step]) - now
            known[step] = now + time
    return time


def find_latest_starts(
    state: LabState,
    plan: Plan,
    chain: Sequence[int],
    due: int,
    find_time: Callable[[LabState, PlanStep], int],
) -> dict[int, int]:
    """The latest times at which steps have to start so that the last of them starts at ``due`` (UTC ns)."""
    latest = dict.fromkeys(chain, due)
    for follower in reversed(chain):
        step = plan.steps[follower]
        for before in step.after:
            if before in latest:
                wait_s = max((w.wait_s for w in step.windows if w.anchor == before), default=0.0)
                takes = find_time(state, plan.steps[before]) + convert_lab_s(state, wait_s)
                latest[before] = min(latest[before], latest[follower] - takes)
    return latest


def find_earliest_start(state: LabState, run: RunState, index: int, known: Mapping[int, int]) -> int:
    """The earliest time at which the windows of a step let it start, by their running clocks (UTC ns; 0: at
    once). ``known`` are expected ends of steps."""
    return max(
        (ended + convert_lab_s(state, w.wait_s) for w, ended in _list_clocks(state, run, index, known)),
        default=0,
    )


def find_deadline(
    state: LabState, run: RunState, index: int, known: Mapping[int, int] = MappingProxyType({})
) -> int | None:
    """The latest time at which a step has to start (UTC ns). None if no clock of a window with an upper limit
    runs. ``known`` are expected ends of steps."""
    return min(
        (
            ended + convert_lab_s(state, window.within_s)
            for window, ended in _list_clocks(state, run, index, known)
            if window.within_s is not None
        ),
        default=None,
    )


def find_start_alone(state: LabState, run: RunState, index: int, ends: Mapping[int, int], now: int) -> int:
    """When a step would start if its run waited for nothing else (UTC ns), by usual durations. ``ends`` are
    the expected ends of the run's steps in flight."""
    plan, known = state.runs.plan_of(run), dict(ends)
    at = now
    for step in find_pending_before(run, plan, index):
        before = max((known[b] for b in plan.steps[step].after if b in known), default=now)
        at = max(now, before, find_earliest_start(state, run, step, known))
        known[step] = at + find_usual_time(state, plan.steps[step])
    return at


def find_unavoidable_delay(
    state: LabState, run: RunState, index: int, ends: Mapping[int, int], now: int
) -> int:
    """By how much a step misses its window even if its run waits for nothing else (ns), because the steps
    within the window take longer. With several windows, the least counts. ``ends`` are the expected ends of
    the run's steps in flight."""
    plan = state.runs.plan_of(run)
    found: list[int] = []
    for window in plan.steps[index].windows:
        if window.within_s is not None and window.anchor is not None and not window.of:
            limit = convert_lab_s(state, window.within_s)
            if is_pending(run, window.anchor):
                found.append(_find_shortest_gap(state, run, window.anchor, index) - limit)
    for window, ended in _list_clocks(state, run, index, ends):
        if window.within_s is not None:
            due = ended + convert_lab_s(state, window.within_s)
            found.append(find_start_alone(state, run, index, ends, now) - due)
    return max(0, min(found, default=0))


def _find_shortest_gap(state: LabState, run: RunState, first: int, last: int) -> int:
    """The shortest time between the end of a pending step and the start of a later one (ns), by usual
    durations."""
    plan = state.runs.plan_of(run)
    ends = {first: 0}
    gap = 0
    for step in find_pending_before(run, plan, last):
        before = [ends[b] for b in plan.steps[step].after if b in ends]
        if before:
            gap = max(before)
            ends[step] = gap + find_usual_time(state, plan.steps[step])
    return gap


def _list_clocks(
    state: LabState, run: RunState, index: int, known: Mapping[int, int]
) -> Iterator[tuple[Window, int]]:
    """The windows of a step whose clocks run, and since when (UTC ns). ``known`` are expected ends of
    steps."""
    for window in state.runs.plan_of(run).steps[index].windows:
        ended = known.get(window.anchor) if window.anchor is not None else None
        if ended is None:
            ended = find_anchor(run, window)
        if ended is not None:
            yield window, ended
