"""State machines: which event changes the status of a run, a step, an action, a node or labware.

The fold makes these changes (``labos.core.fold``); these tables collect them for the reference pages. Tests
compare them with the folds of logs: no other change ever happens.
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
"""The status before something is known to the lab, and after its end."""

AT_REST, IN_USE, UNCERTAIN = "at rest", "in use", "uncertain"
"""Labware that stands at a station, that an action works with, or whose place is unknown."""


class Transition(msgspec.Struct, frozen=True):
    """An event, the possible statuses before it, and the status after it."""

    event: type[Event]
    before: tuple[str, ...]
    after: str


_Q, _A, _C, _L = RunStatus.QUEUED, RunStatus.ACTIVE, RunStatus.CANCELLING, RunStatus.LEAVING
_P, _F, _D, _X = StepStatus.PENDING, StepStatus.IN_FLIGHT, StepStatus.DONE, StepStatus.FAILED
_U, _S = StepStatus.UNKNOWN, StepStatus.SKIPPED
_AR, _AA, _AP, _AU = tuple(ActionStatus)
_IDLE, _BUSY, _ERROR, _GONE = tuple(ModuleStatus)

RUN = (
    Transition(RunSubmitted, (NOT_THERE,), _Q),
    Transition(RunStarted, (_Q,), _A),
    Transition(RunCancelling, (_A, _L), _C),
    Transition(RunLeaving, (_C,), _L),
    Transition(RunCompleted, (_A, _C), NOT_THERE),  # a completion takes precedence over a cancellation
    Transition(RunFailed, (_Q, _A, _C, _L), NOT_THERE),
    Transition(RunCancelled, (_Q, _A, _C, _L), NOT_THERE),
)

STEP = (
    Transition(ActionRequested, (_P,), _F),
    Transition(ActionAccepted, (_U,), _F),
    Transition(ActionReported, (_U,), _F),
    Transition(ActionRejected, (_F, _U), _P),
    Transition(ActionRejected, (_F, _U), _X),
    Transition(ActionSucceeded, (_F, _U), _D),
    Transition(ActionFailed, (_F, _U), _X),
    Transition(ActionUnknown, (_F,), _U),
    Transition(ActionReconciled, (_U,), _D),
    Transition(ActionReconciled, (_U,), _P),
    Transition(ActionReconciled, (_U,), _X),
    Transition(StepUnexpected, (_D,), _X),
    Transition(StepRetried, (_X, _D, _S), _P),
    Transition(StepRecovering, (_S,), _P),
    Transition(StepSkipped, (_P, _X), _S),
    Transition(RunLeaving, (_P, _X), _S),
    Transition(RunLeaving, (_S,), _P),
)

ACTION = (
    Transition(ActionRequested, (NOT_THERE,), _AR),
    Transition(ActionAccepted, (_AR, _AU), _AA),
    Transition(ActionReported, (_AR, _AA, _AU), _AP),
    Transition(ActionUnknown, (_AR, _AA, _AP), _AU),
    Transition(ActionRejected, (_AR, _AA, _AU), NOT_THERE),
    Transition(ActionSucceeded, (_AR, _AA, _AP, _AU), NOT_THERE),
    Transition(ActionFailed, (_AR, _AA, _AP, _AU), NOT_THERE),
    Transition(ActionReconciled, (_AU,), NOT_THERE),
)

NODE = (
    Transition(WorkcellApplied, (NOT_THERE,), _GONE),
    *(Transition(NodeJoined, (_GONE, _IDLE, _BUSY, _ERROR), status) for status in (_IDLE, _BUSY, _ERROR)),
    Transition(NodeLeft, (_IDLE, _BUSY, _ERROR), _GONE),
    *(Transition(NodeStateChanged, (_IDLE, _BUSY, _ERROR), status) for status in (_IDLE, _BUSY, _ERROR)),
    Transition(EmergencyStopped, (_IDLE, _BUSY), _ERROR),
    Transition(WorkcellApplied, (_IDLE, _BUSY, _ERROR, _GONE), NOT_THERE),
)

LABWARE = (
    Transition(LabwarePlaced, (NOT_THERE,), AT_REST),
    Transition(ActionRequested, (AT_REST,), IN_USE),
    Transition(ActionRejected, (IN_USE,), AT_REST),
    Transition(ActionSucceeded, (IN_USE,), AT_REST),
    Transition(ActionFailed, (IN_USE,), AT_REST),
    Transition(ActionReconciled, (IN_USE,), AT_REST),
    Transition(LabwareUncertain, (AT_REST, IN_USE), UNCERTAIN),
    Transition(LabwareObserved, (UNCERTAIN,), AT_REST),
    Transition(LabwareObserved, (UNCERTAIN,), IN_USE),
    Transition(LabwareRemoved, (AT_REST, IN_USE, UNCERTAIN), NOT_THERE),
)

MACHINES: dict[str, tuple[Transition, ...]] = {
    "run": RUN,
    "step": STEP,
    "action": ACTION,
    "node": NODE,
    "labware": LABWARE,
}


def list_arrows(rows: tuple[Transition, ...]) -> Iterator[tuple[str, str, str]]:
    """Event type, status before and status after, for each change."""
    for row in rows:
        for before in row.before:
            if before != row.after:
                yield row.event.TYPE, before, row.after
