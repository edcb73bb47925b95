"""The timetable of a workcell where clocks run: the runs inside and queued runs, as chains of slots.

A workcell has a timetable only if the steps of each run follow one another, and its windows count from steps
of the same run. No run may use doors, setpoints or holds, or have a step for a person.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import msgspec

from labos.core.actions import Action, ActionStatus
from labos.core.effects import Carrying, Consumes, Needs
from labos.core.ids import RunId, deck_key, run_owner
from labos.core.model import MAIN, Plan, PlanStep
from labos.core.rules import convert_lab_s
from labos.core.runs import IN_FLIGHT, PENDING, SETTLED, RunState, RunStatus, find_anchor, find_holds
from labos.core.state import LabState
from labos.planning.chains import Chain, Leg, SlotTable
from labos.planning.forecast import find_usual_time
from labos.planning.outline import Task, Ways
from labos.planning.taken import find_station
from labos.planning.window_waits import WaitSpan, share_waits

MOST_SLOTS = 2048
"""The most slots that all steps take together, with the waits between them."""

SLOTS_S = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 300.0, 900.0, 3600.0)
"""The possible lengths of a slot (lab seconds). The shortest that needs at most ``MOST_SLOTS`` is used."""

KNOWN = (Carrying, Needs, Consumes)
"""The effects that the timetable can represent. With any other effect there is no timetable."""


class StepChain(msgspec.Struct, frozen=True):
    """The main ``steps`` of a plan, by index, if they follow one another. ``least`` and ``most`` are the
    shortest and the longest wait of the run before each of them (ns of wall time; None: no limit).
    ``lengths`` are the usual times of all steps of the plan (ns of wall time)."""

    lengths: tuple[int, ...]
    steps: tuple[int, ...]
    least: tuple[int, ...]
    most: tuple[int | None, ...]


class PlannedRun(msgspec.Struct):
    """A run in the timetable."""

    run: RunState
    first: int
    """The position in ``line`` of its first step that has not started."""
    line: StepChain
    chain: Chain
    end: int
    """When its step in flight ends (UTC ns); now if it has none."""
    limit: int = 0
    """The number of younger runs that may still start before it."""


class PlannedCell(msgspec.Struct):
    """The runs in the timetable (``members``), the oldest first, and the ``table`` without them. ``slot`` is
    the length of a slot (ns of wall time); the first slot begins ``now`` (UTC ns)."""

    members: dict[RunId, PlannedRun]
    table: SlotTable
    slot: int
    now: int


def lay_out_runs(
    state: LabState, cell: str, ways: Ways, runs: Sequence[RunState], now: int
) -> PlannedCell | None:
    """The runs of a workcell, inside and queued, as chains. None if a run is no chain, is held or cancelled,
    or has a step of unknown outcome."""
    lines: list[tuple[RunState, StepChain, tuple[Task, ...]]] = []
    for run in runs:
        if run.has_started and (run.status != RunStatus.ACTIVE or find_holds(run)):
            return None
        line = _read_line(state, state.runs.plan_of(run))
        if line is None:
            return None
        lines.append((run, line, ways.read(state, run.plan)))
    total = sum(line.lengths[step] for _, line, _ in lines for step in line.steps)
    total += sum(sum(line.least) for _, line, _ in lines)
    slot = _choose_slot(state, [time for _, line, _ in lines for time in line.lengths], total)
    flying = {(a.run, a.step): a for a in state.actions.list_in_cell(cell)}
    members: dict[RunId, PlannedRun] = {}
    for run, line, tasks in lines:
        member = _make_member(state, run, line, tasks, ways, slot, now, flying)
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


def _read_line(state: LabState, plan: Plan) -> StepChain | None:
    """The main steps of a plan as a chain. None if they do not follow one another, if a window counts from
    another run, if the windows contradict one another, or if the timetable cannot represent the plan."""
    if plan.holds or any(not isinstance(effect, KNOWN) for step in plan.steps for effect in step.effects):
        return None  # doors, setpoints and the like are not in the timetable
    lengths = tuple(find_usual_time(state, step) for step in plan.steps)
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
            between = sum(lengths[i] for i in steps[first:number])
            # If the steps in a window last longer than the window, its last step follows at once.
            left = None if window.within_s is None else convert_lab_s(state, window.within_s) - between
            limit = None if left is None else max(0, left)
            spans.append(WaitSpan(first, number, convert_lab_s(state, window.wait_s) - between, limit))
    waits = share_waits(len(steps), spans)
    return None if waits is None else StepChain(lengths, tuple(steps), *waits)


def _choose_slot(state: LabState, lengths: Iterable[int], total: int) -> int:
    """The length of a slot (ns of wall time): the greatest common divisor of all durations if that needs at
    most ``MOST_SLOTS``, else one of ``SLOTS_S``, or longer if all of these are too short."""
    whole = math.gcd(*lengths)
    if whole and total <= MOST_SLOTS * whole:
        return whole
    return next(
        (slot for slot in (convert_lab_s(state, s) for s in SLOTS_S) if total <= MOST_SLOTS * slot),
        max(1, total // MOST_SLOTS),
    )


def _count_slots(time: int, slot: int) -> int:
    """The number of slots for a time, rounded up. An excess of up to a twentieth of a slot does not count."""
    return max(0, -(-(time - slot // 20) // slot))


def _make_member(
    state: LabState,
    run: RunState,
    line: StepChain,
    tasks: tuple[Task, ...],
    ways: Ways,
    slot: int,
    now: int,
    flying: dict[tuple[RunId, int], Action],
) -> PlannedRun | None:
    """A run in the timetable. None if a started step follows a pending one, or has no known outcome."""
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
        end = max(now, action.requested_at + line.lengths[index])
        in_progress = tasks[index].takes
    if statuses:
        if any(statuses[index] != PENDING for index in line.steps[first:]):
            return None
        begins = _count_slots(end - now, slot)
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
        if statuses and number == first:
            least, most = _since_clocks(state, run, plan, line, first, end)
        takes = dict.fromkeys(k for k in (*task.takes, *task.gets) if ways.room[k] == 1)
        holds = tuple(key for key, count in held.items() if count > 0 and ways.room[key] == 1)
        wait = _count_slots(least, slot)
        longest = None if most is None else max(wait, most // slot)
        legs.append(
            Leg(
                tuple(k for k in takes if k not in holds),
                holds,
                max(1, _count_slots(line.lengths[index], slot)),
                wait,
                longest,
            )
        )
        _carry(held, task, is_over=True)
    keeps = tuple(key for key, count in held.items() if count > 0 and ways.room[key] == 1)
    early = 0
    if begins and legs:
        early = _find_early(state, plan.steps[line.steps[first - 1]], legs[0].most, slot)
    legs = _add_early(state, [plan.steps[index] for index in line.steps[first:]], legs, slot)
    return PlannedRun(run, first, line, Chain(tuple(legs), begins, in_progress, keeps, early), end)


def _add_early(state: LabState, steps: Sequence[PlanStep], legs: Sequence[Leg], slot: int) -> list[Leg]:
    """The legs of steps, each with how much too early it may end."""
    most = [*(leg.most for leg in legs[1:]), None]
    return [
        msgspec.structs.replace(leg, early=_find_early(state, step, limit, slot))
        for step, leg, limit in zip(steps, legs, most, strict=False)
    ]


def _find_early(state: LabState, step: PlanStep, most: int | None, slot: int) -> int:
    """How much earlier than usual a step may end, less the ``most`` that the next step may wait (slots). 0 if
    that may wait without a limit, or while too few durations of the step are known."""
    known = state.lengths.estimate(step, state.lab.pace) if most is not None else None
    return 0 if known is None or most is None else _count_slots(known.usual - known.low - most * slot, slot)


def _carry(held: dict[int, int], task: Task, *, is_over: bool) -> None:
    """Update what a run holds: after a step (``is_over``), or while the step is in progress."""
    for key in task.gets:
        held[key] = held.get(key, 0) + 1
    for key in task.frees if is_over else ():
        held[key] = max(0, held.get(key, 0) - 1)


def _since_clocks(
    state: LabState,
    run: RunState,
    plan: Plan,
    line: StepChain,
    first: int,
    end: int,
) -> tuple[int, int | None]:
    """The shortest and the longest wait of a run before its ``first`` step that has not started (ns; None: no
    limit). They follow from the clocks that run at ``end``."""
    least, most = 0, None
    for later in range(first, len(line.steps)):
        for window in plan.steps[line.steps[later]].windows:
            assert window.anchor is not None  # _read_line excludes clocks of other runs
            anchor = line.steps.index(window.anchor)
            ended = find_anchor(run, window)
            if ended is None and anchor == first - 1:
                ended = end
            if ended is None or anchor >= first or run.is_breached(line.steps[later]):
                continue
            between = sum(line.lengths[i] for i in line.steps[first:later])
            behind = slice(first + 1, later + 1)
            waits = sum(line.least[behind])
            least = max(least, ended + convert_lab_s(state, window.wait_s) - between - waits - end)
            if window.within_s is not None:
                waits = sum(limit or 0 for limit in line.most[behind])
                left = max(0, ended + convert_lab_s(state, window.within_s) - between - waits - end)
                most = left if most is None else min(most, left)
    return least, most
