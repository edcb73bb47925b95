"""Which event takes a run, a step, an action, a node or labware from which status to which.

The fold does it (``labos.core.fold``); these tables say it in one place, for the reference. Tests hold them
against what the fold makes of logs: nothing happens that is not here.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from labos.core.actions import (
    ActionAccepted,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionReported,
    ActionRequested,
    ActionStatus,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.lab import WorkcellApplied
from labos.core.labware import LabwareObserved, LabwarePlaced, LabwareRemoved, LabwareUncertain
from labos.core.modules import EmergencyStopped, ModuleStatus, NodeJoined, NodeLeft, NodeStateChanged
from labos.core.registry import Event
from labos.core.runs import (
    RunCancelled,
    RunCancelling,
    RunCompleted,
    RunFailed,
    RunLeaving,
    RunStarted,
    RunStatus,
    RunSubmitted,
    StepStatus,
)
from labos.core.steps import StepRecovering, StepRetried, StepSkipped, StepUnexpected

NOT_THERE = ""
"""Before it is known to the lab, and after its end."""

AT_REST, IN_USE, UNCERTAIN = "at rest", "in use", "uncertain"
"""Labware that stands somewhere, with which an action is at work, and of which nobody knows where it is."""


class Row(msgspec.Struct, frozen=True):
    """An event, the statuses in which it may find something, and the one in which it leaves it."""

    event: type[Event]
    before: tuple[str, ...]
    after: str


_Q, _A, _C, _L = RunStatus.QUEUED, RunStatus.ACTIVE, RunStatus.CANCELLING, RunStatus.LEAVING
_P, _F, _D, _X = StepStatus.PENDING, StepStatus.IN_FLIGHT, StepStatus.DONE, StepStatus.FAILED
_U, _S = StepStatus.UNKNOWN, StepStatus.SKIPPED
_AR, _AA, _AP, _AU = tuple(ActionStatus)
_IDLE, _BUSY, _ERROR, _GONE = tuple(ModuleStatus)

RUN = (
    Row(RunSubmitted, (NOT_THERE,), _Q),
    Row(RunStarted, (_Q,), _A),
    Row(RunCancelling, (_A, _L), _C),
    Row(RunLeaving, (_C,), _L),
    Row(RunCompleted, (_A, _C), NOT_THERE),  # a completion wins the race
    Row(RunFailed, (_Q, _A, _C, _L), NOT_THERE),
    Row(RunCancelled, (_Q, _A, _C, _L), NOT_THERE),
)

STEP = (
    Row(ActionRequested, (_P,), _F),
    Row(ActionAccepted, (_U,), _F),
    Row(ActionReported, (_U,), _F),
    Row(ActionRejected, (_F, _U), _P),
    Row(ActionRejected, (_F, _U), _X),
    Row(ActionSucceeded, (_F, _U), _D),
    Row(ActionFailed, (_F, _U), _X),
    Row(ActionUnknown, (_F,), _U),
    Row(ActionReconciled, (_U,), _D),
    Row(ActionReconciled, (_U,), _P),
    Row(ActionReconciled, (_U,), _X),
    Row(StepUnexpected, (_D,), _X),
    Row(StepRetried, (_X, _D, _S), _P),
    Row(StepRecovering, (_S,), _P),
    Row(StepSkipped, (_P, _X), _S),
    Row(RunLeaving, (_P, _X), _S),
    Row(RunLeaving, (_S,), _P),
)

ACTION = (
    Row(ActionRequested, (NOT_THERE,), _AR),
    Row(ActionAccepted, (_AR, _AU), _AA),
    Row(ActionReported, (_AR, _AA, _AU), _AP),
    Row(ActionUnknown, (_AR, _AA, _AP), _AU),
    Row(ActionRejected, (_AR, _AA, _AU), NOT_THERE),
    Row(ActionSucceeded, (_AR, _AA, _AP, _AU), NOT_THERE),
    Row(ActionFailed, (_AR, _AA, _AP, _AU), NOT_THERE),
    Row(ActionReconciled, (_AU,), NOT_THERE),
)

NODE = (
    Row(WorkcellApplied, (NOT_THERE,), _GONE),
    *(Row(NodeJoined, (_GONE, _IDLE, _BUSY, _ERROR), status) for status in (_IDLE, _BUSY, _ERROR)),
    Row(NodeLeft, (_IDLE, _BUSY, _ERROR), _GONE),
    *(Row(NodeStateChanged, (_IDLE, _BUSY, _ERROR), status) for status in (_IDLE, _BUSY, _ERROR)),
    Row(EmergencyStopped, (_IDLE, _BUSY), _ERROR),
    Row(WorkcellApplied, (_IDLE, _BUSY, _ERROR, _GONE), NOT_THERE),
)

LABWARE = (
    Row(LabwarePlaced, (NOT_THERE,), AT_REST),
    Row(ActionRequested, (AT_REST,), IN_USE),
    Row(ActionRejected, (IN_USE,), AT_REST),
    Row(ActionSucceeded, (IN_USE,), AT_REST),
    Row(ActionFailed, (IN_USE,), AT_REST),
    Row(ActionReconciled, (IN_USE,), AT_REST),
    Row(LabwareUncertain, (AT_REST, IN_USE), UNCERTAIN),
    Row(LabwareObserved, (UNCERTAIN,), AT_REST),
    Row(LabwareObserved, (UNCERTAIN,), IN_USE),
    Row(LabwareRemoved, (AT_REST, IN_USE, UNCERTAIN), NOT_THERE),
)

MACHINES: dict[str, tuple[Row, ...]] = {
    "run": RUN,
    "step": STEP,
    "action": ACTION,
    "node": NODE,
    "labware": LABWARE,
}


def arrows(rows: tuple[Row, ...]) -> Iterator[tuple[str, str, str]]:
    """Event type, status before and status after, of each change."""
    for row in rows:
        for before in row.before:
            if before != row.after:
                yield row.event.TYPE, before, row.after
