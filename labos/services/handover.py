"""The handover to the next shift: what runs, what waits for which person, what will be used up next, and how
long the lab worked without intervention.

Everything is computed from the log at one moment. Only the runs that ended, and the time without human
intervention, are counted from the start of the shift.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from labos.core.bench import Labware
from labos.core.ids import find_owning_run, local
from labos.core.interventions import Intervention
from labos.core.labware import LabwareHandedOver
from labos.core.modules import ModuleStatus
from labos.core.runs import DONE, RunState, count_in_play, list_statuses
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import PlannedWork
from labos.planning.scheduler import Scheduler
from labos.services.history import fold_state_at
from labos.services.inventory import Inventory, count_inventory, list_shortfalls
from labos.services.log import Log, decode_events
from labos.services.runs import RunBook
from labos.services.times import iso_time
from labos.services.twh import Meter, Twh
from labos.services.waits import QUEUED_JUDGED, list_reasons, list_unknown_reasons


class OpenRun(msgspec.Struct, frozen=True):
    """A run that has not ended: what it does (``doing``), or why it does not continue (``waits``). ``stuck``
    if it can continue only after a person acts or a device comes back."""

    run: str
    workflow: str
    user: str
    experiment: str
    status: str
    done: int
    steps: int
    doing: tuple[str, ...] = ()
    waits: tuple[str, ...] = ()
    stuck: bool = False


class RunEnded(msgspec.Struct, frozen=True):
    run: str
    workflow: str
    user: str
    status: str
    ended_at: int
    why: str = ""


class OpenQuestion(msgspec.Struct, frozen=True):
    """A question or task that waits for a person: planned work of the operator ``of``, or a question of the
    lab."""

    id: str
    of: str
    run: str
    text: str
    answer: str
    asked_at: int
    due_at: int
    overdue: bool


class UnavailableModule(msgspec.Struct, frozen=True):
    """A module that cannot be used; ``until`` is when it becomes available by itself (UTC ns; 0: it does
    not)."""

    module: str
    status: str
    why: str
    until: int = 0


class ManualAccess(msgspec.Struct, frozen=True):
    """A person who works in a workcell by hand."""

    workcell: str
    by: str
    since: int


class IdleLabware(msgspec.Struct, frozen=True):
    """Labware that no run uses: a person has to know that it is there. ``maybe`` are its possible places if
    its place is not known; ``given_by`` is the user who handed it over in this shift."""

    labware: str
    type: str
    station: str
    owner: str
    maybe: tuple[str, ...] = ()
    given_by: str = ""


class Shortage(msgspec.Struct, frozen=True):
    """Material of which the runs that have not ended will not have enough, and where it is missing first."""

    what: str
    run: str
    workflow: str
    step: str
    at: int


class ExpiredPack(msgspec.Struct, frozen=True):
    """A pack after its expiry date."""

    module: str
    resource: str
    lot: str
    left: float
    expires: str


class Handover(msgspec.Struct, frozen=True):
    """A lab between two shifts; ``since`` and ``until`` in UTC ns. ``twh`` is the time without human
    intervention of this shift alone."""

    lab: str
    pace: float
    position: int
    since: int
    until: int
    running: tuple[OpenRun, ...]
    queued: tuple[OpenRun, ...]
    queued_in_all: int
    ended: tuple[RunEnded, ...]
    questions: tuple[OpenQuestion, ...]
    away: tuple[UnavailableModule, ...]
    held: tuple[ManualAccess, ...]
    labware: tuple[IdleLabware, ...]
    runs_out: tuple[Shortage, ...]
    expired: tuple[ExpiredPack, ...]
    twh: Twh


def read_handover(log: Log, since: int, until: int, *, kernel_runs: bool = True) -> Handover:
    """The report on a shift from ``since`` to ``until`` (UTC ns). Only while a kernel runs, runs may wait for
    an order that is not in the log. Raises LogTooNew, LogDamaged."""
    meter = Meter()
    book = RunBook(meter.names)
    given: dict[str, str] = {}
    begun = False
    for event, head in decode_events(log.read()):
        if not begun and head.recorded_at >= since:
            # If the lab is younger than its shift, the shift begins with the first event.
            begun, since = True, head.recorded_at if head.position == 1 else since
            meter.start_over(since)
        meter.add(event, head)
        book.add(event, head)
        if begun and isinstance(event, LabwareHandedOver) and event.by:
            given[event.labware] = event.by
    if not begun:
        meter.start_over(since)
    state = fold_state_at(log)
    left = count_inventory(state, until, iso_time(until)[:10])
    queued = list(state.runs.queued.values())
    return Handover(
        lab=meter.names.lab,
        pace=state.lab.pace,
        position=state.position,
        since=since,
        until=until,
        running=tuple(_run(state, run, until, kernel_runs) for run in state.runs.active.values()),
        queued=tuple(_run(state, run, until, kernel_runs) for run in queued[:QUEUED_JUDGED]),
        queued_in_all=len(queued),
        ended=tuple(
            make_from(RunEnded, story, run=story.id)
            for story in book.runs.values()
            if story.over and story.ended_at >= since
        ),
        questions=tuple(_make_question(asked) for asked in state.interventions.open.values()),
        away=tuple(_list_unavailable(state)),
        held=tuple(
            ManualAccess(cell, access.by, access.asked_at) for cell, access in state.lab.access.items()
        ),
        labware=tuple(
            _make_idle_labware(item, given) for item in state.bench.labware.values() if _is_left(item)
        ),
        runs_out=tuple(
            make_from(Shortage, out, what=local(name).replace(":", " "))
            for name, out in list_shortfalls(left)
        ),
        expired=tuple(_list_expired(left)),
        twh=meter.report(until).lab,
    )


def _run(state: LabState, run: RunState, now: int, kernel_runs: bool) -> OpenRun:
    plan = state.runs.plan_of(run)
    doing = tuple(
        f"{plan.steps[action.step].key!r} on {local(action.module)}"
        for action in state.actions.open.values()
        if action.run == run.id
    )
    waits = [] if doing else list_reasons(state, run, now, Scheduler())
    if not waits and not doing and kernel_runs:
        waits = list_unknown_reasons(state, run, now)
    status = "paused" if run.paused else run.status
    return make_from(
        OpenRun,
        run,
        run=run.id,
        status=status,
        done=run.statuses.count(DONE),
        steps=count_in_play(plan, list_statuses(plan, run)),
        doing=doing,
        waits=tuple(dict.fromkeys(reason.why for reason in waits)),
        stuck=any(reason.blocked for reason in waits),
    )


def _make_question(asked: Intervention) -> OpenQuestion:
    planned = asked.kind == PlannedWork.KIND
    choices = " | ".join(choice.name for choice in asked.choices)
    return make_from(
        OpenQuestion,
        asked,
        of=local(asked.module) if planned else "",
        answer=f"labos confirm {asked.id}" if planned else f"labos resolve {asked.id} {choices}",
        asked_at=asked.requested_at,
    )


def _list_unavailable(state: LabState) -> Iterator[UnavailableModule]:
    for name, module in state.modules.by_name.items():
        back_at = state.modules.back_at.get(name, 0)
        if module.out_of_service:
            yield UnavailableModule(local(name), "out of service", module.out_of_service, back_at)
        elif module.status in (ModuleStatus.GONE, ModuleStatus.ERROR):
            yield UnavailableModule(local(name), module.status, module.error)


def _is_left(item: Labware) -> bool:
    """Labware without a run as its owner, and all labware whose place is not known; a lid belongs to its
    plate."""
    return bool(item.maybe) or not (find_owning_run(item.owner) or item.on)


def _make_idle_labware(item: Labware, given: dict[str, str]) -> IdleLabware:
    maybe = tuple(local(place) or "gone" for place in item.maybe)
    station = "" if maybe else local(item.station)
    return IdleLabware(item.id, item.type, station, item.owner, maybe, given.get(item.id, ""))


def _list_expired(left: Inventory) -> Iterator[ExpiredPack]:
    for resource in left.resources:
        for lot in resource.lots:
            if lot.expired:
                yield ExpiredPack(local(resource.module), resource.resource, lot.lot, lot.left, lot.expires)
