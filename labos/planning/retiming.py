"""Corrects the times of an order by rehearsals.

The lab's own order for windows comes from a timetable of slots (``window_timetable``). Durations are rounded
there, so the times of the order can be a little wrong. A rehearsal shows when each step can really start. If
a window is missed in it, the step that starts the window's clock is put off, and the order is rehearsed
again.

Some windows cannot be kept in any order, because the steps within them take longer. They do not count here.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from labos.core.model import MAIN
from labos.core.rules import convert_lab_s
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested
from labos.planning.forecast import find_run, find_unavoidable_delay, is_pending
from labos.planning.player import FAR, Player, Step
from labos.planning.rehearsal import Advice, RehearsalResult, play
from labos.planning.scene import Scene

EXACT_S = 0.01
"""The largest delay of a start or an end that still counts as exact (lab seconds)."""

MOST_REHEARSALS = 4
"""The most rehearsals for the times of one order."""

Ends = Mapping[str, Mapping[int, int]]
"""The expected ends of the steps in flight (UTC ns), by run and step."""


def rehearse(
    state: LabState, cell: str, starts: Mapping[Step, int], now: int
) -> tuple[RehearsalResult, Ends] | None:
    """The result of a rehearsal in which the runs named in ``starts`` go to their ends, and no step starts
    before its time (UTC ns); with the ends of the steps in flight now. None if a step that is left has no
    time."""
    scene = Scene(state, cell, now)
    ends = scene.list_ends()
    players: list[Player] = []
    for name in dict.fromkeys(run for run, _ in starts):
        run = find_run(state, name)
        steps = state.runs.plan_of(run).steps
        left = [i for i, step in enumerate(steps) if step.part == MAIN and is_pending(run, i)]
        if any((name, index) not in starts for index in left):
            return None
        players.append(Player(state, run, {**ends.get(name, {})}, free=True, first=left))
    return play(scene, players, Advice(not_before={**starts})), ends


def list_avoidable_misses(state: LabState, result: RehearsalResult, ends: Ends, now: int) -> dict[Step, int]:
    """The steps that miss their window in a rehearsal although this can be avoided, and by how much (ns)."""
    slack = convert_lab_s(state, EXACT_S)
    found: dict[Step, int] = {}
    for (name, step), late in result.late.items():
        surely = find_unavoidable_delay(state, find_run(state, name), step, ends.get(name, {}), now)
        if late > surely + slack:
            found[name, step] = late - surely
    return found


def correct_times(state: LabState, order: OrderSuggested, now: int) -> OrderSuggested:
    """The order, made just now, with the times at which its steps can really start, so that no window is
    missed which can be kept. The order itself if such times are not found."""
    starts = {(str(one.run), one.step): one.start for one in order.steps}
    for _ in range(MOST_REHEARSALS if starts else 0):
        rehearsed = rehearse(state, order.workcell, starts, now)
        if rehearsed is None:
            return order
        result, ends = rehearsed
        starts = {who: max(at, result.starts.get(who, at)) for who, at in starts.items()}
        missed = list_avoidable_misses(state, result, ends, now)
        if not missed:
            return _set_times(order, starts)
        if not _put_off_clocks(state, starts, missed):
            return order
    return order


def _put_off_clocks(state: LabState, starts: dict[Step, int], missed: Mapping[Step, int]) -> bool:
    """Put off the steps that start the clocks of missed windows, each by as much as its window is missed.
    False if a clock runs already, or if a step never starts."""
    for (name, step), late in missed.items():
        windows = state.runs.plan_of(find_run(state, name)).steps[step].windows
        limited = [window for window in windows if window.within_s is not None]
        clocks = {(name, w.anchor) for w in limited if w.anchor is not None and not w.of}
        pending = [who for who in starts if who in clocks]
        if not pending or late >= FAR // 2:
            return False
        for who in pending:
            starts[who] += late
    return True


def _set_times(order: OrderSuggested, starts: Mapping[Step, int]) -> OrderSuggested:
    """The order with other times of its steps. If it ends later, it is valid for longer."""
    steps = [
        msgspec.structs.replace(one, start=starts.get((str(one.run), one.step), one.start))
        for one in order.steps
    ]
    steps.sort(key=lambda one: (one.start, one.run, one.step))
    longer = steps[-1].start - order.steps[-1].start
    return msgspec.structs.replace(order, steps=tuple(steps), until=order.until + max(0, longer))
