"""The notice for people that follows from an event, if any."""

from __future__ import annotations

import msgspec

from labos.core.envelope import Envelope
from labos.core.ids import local, module_key
from labos.core.interventions import (
    InterventionOverdue,
    InterventionRequested,
    InterventionResolved,
)
from labos.core.lab import KernelStarted
from labos.core.modules import ModulePutBack, ModuleTakenOut, NodeJoined, NodeLeft, NodeStateChanged
from labos.core.registry import Event
from labos.core.runs import RunFailed
from labos.core.steps import WindowBreached
from labos.core.topics import PlannedWork
from labos.services.describe import describe

TYPES = tuple(
    kind.TYPE
    for kind in (
        InterventionRequested,
        InterventionResolved,
        InterventionOverdue,
        WindowBreached,
        NodeJoined,
        NodeLeft,
        NodeStateChanged,
        ModuleTakenOut,
        ModulePutBack,
        KernelStarted,
        RunFailed,
    )
)
"""The events that a notifier reads."""

MILD = ("failed_run", "lost_experiment", "approval")
"""Questions that can wait: their subject has ended and holds only its own labware, or it has not begun."""

KERNEL = "kernel"


class Notice(msgspec.Struct, frozen=True):
    """A text for people. ``event`` is the id of the event that caused it; ``key`` is the key of its answer
    (empty: it asks nothing); ``urgent``: the lab, or a part of it, stands still until a person acts."""

    event: str
    position: int
    at: int
    topic: str
    key: str
    title: str
    text: str
    urgent: bool = False


class SettledNotice(msgspec.Struct, frozen=True):
    """The subject of an earlier notice is settled: no other person has to be notified. ``all``: this holds
    for every notice whose key begins with this one; ``quietly``: only for notices that have not been sent
    yet."""

    key: str
    why: str
    all: bool = False
    quietly: bool = False


def read_event(event: Event, head: Envelope) -> Notice | SettledNotice | None:
    """The notice that follows from an event, or the notice that it settles."""
    match event:
        case InterventionRequested():
            return _make_question_notice(event, head)
        case InterventionResolved():
            return SettledNotice(intervention_key(event.intervention), describe(event, head))
        case InterventionOverdue():
            key, title = intervention_key(event.intervention), f"{event.intervention}: work is overdue"
            return _make_notice(event, head, "interventions", key, title, urgent=True)
        case WindowBreached():
            return _make_notice(event, head, "windows", "", f"{event.run} missed a time window")
        case RunFailed():
            return _make_notice(event, head, "runs", "", f"{event.run} failed")
        case ModuleTakenOut(failures=failures) if failures:
            key, title = quarantine_key(event.module), f"{local(event.module)} is quarantined"
            return _make_notice(event, head, "modules", key, title, urgent=True)
        case ModulePutBack():
            return SettledNotice(quarantine_key(event.module), describe(event, head))
        case NodeLeft() if not event.stopped:
            return _make_notice(
                event, head, "modules", module_key(event.module), f"{local(event.module)} is gone"
            )
        case NodeStateChanged() | NodeJoined():
            if event.status == "ERROR":
                title = f"{local(event.module)} reports an error"
                return _make_notice(event, head, "modules", module_key(event.module), title)
            return SettledNotice(module_key(event.module), describe(event, head))
    return None


def intervention_key(intervention: str) -> str:
    return f"intervention:{intervention}"


def quarantine_key(module: str) -> str:
    return f"quarantine:{module}"


def report_kernel_death(event: str, position: int, at: int, why: str) -> Notice:
    """The kernel has stopped by itself; ``event`` is the event of its start."""
    text = (
        f"The kernel has stopped: {why}\n\nNo step starts until it runs again. Instruments finish "
        "their present actions.\n\nStart it with: labos up"
    )
    return Notice(f"{event}.stopped", position, at, "kernel", KERNEL, "the kernel has stopped", text, True)


def report_kernel_gone(head: Envelope, before: int, epoch: int) -> Notice:
    """A kernel has started after an earlier one that did not shut down properly."""
    text = (
        f"The kernel (epoch {before}) ended without closing the lab. Another one (epoch {epoch}) has "
        "started and continues from the log; it asks about outcomes that are not known."
    )
    title = "the kernel had stopped and runs again"
    return Notice(head.id, head.position, head.recorded_at, "kernel", "", title, text)


def _make_question_notice(event: InterventionRequested, head: Envelope) -> Notice:
    planned = event.kind == PlannedWork.KIND
    lines = [event.text, "", "When it is done:" if planned else "Answer with one of:"]
    if planned:
        lines.append(f"  labos confirm {event.intervention}   (or --not-done)")
    for choice in () if planned else event.choices:
        lines.append(f"  labos resolve {event.intervention} {choice.name}   {choice.consequence}")
    key = intervention_key(event.intervention)
    title = f"{event.intervention}: {'work for you' if planned else 'the lab asks you'}"
    urgent = event.kind not in MILD and not planned
    return _make_notice(event, head, "interventions", key, title, "\n".join(lines), urgent=urgent)


def _make_notice(
    event: Event, head: Envelope, topic: str, key: str, title: str, text: str = "", *, urgent: bool = False
) -> Notice:
    text = text or describe(event, head)
    return Notice(head.id, head.position, head.recorded_at, topic, key, title, text, urgent)
