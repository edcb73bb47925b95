"""Actions in flight: from the request in the log to the result in the log."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Literal

import msgspec

from labos.core.effects import AnyEffect
from labos.core.ids import ActionId, ModuleName, RunId, StationName, workcell_of
from labos.core.registry import Event, event

EffectsDone = Literal["all", "none", "partial", "unknown"]

FailureKind = Literal["software", "operational", "experiment"]
"""The paper's classes of failure: ``software`` is reported by the device, ``operational`` is observed from
outside, ``experiment`` is a result out of range."""


class ActionEvent(Event, frozen=True):
    """Every action event names run, step, module and attempt, so that it can be read on its own."""

    action: ActionId
    run: RunId
    step: int
    module: ModuleName
    attempt: int

    def stream(self) -> str:
        return self.run or self.module


@event("action.requested")
class ActionRequested(ActionEvent, frozen=True):
    """The kernel requests an action. The event is on disk before anything is sent. ``attempt`` counts how
    often the same action was sent. ``journal`` is the node's journal for which the request is meant.
    ``effects`` name the labware that they concern. ``together`` are all actions that the device carries out
    at once with this one, this one included; empty if it carries out this one alone."""

    epoch: int
    journal: str
    name: str
    args: dict[str, Any]
    effects: tuple[AnyEffect, ...]
    exclusive: bool = True
    files: dict[str, str] = {}
    together: tuple[ActionId, ...] = ()


@event("action.accepted")
class ActionAccepted(ActionEvent, frozen=True):
    """The node has stored the attempt in its journal and carries it out."""


@event("action.rejected")
class ActionRejected(ActionEvent, frozen=True):
    """The node refused the action before anything moved. With ``final``, it would refuse again; otherwise the
    step waits for another attempt."""

    why: str
    final: bool = True


@event("action.reported")
class ActionReported(ActionEvent, frozen=True):
    """The device reports success. The action counts as succeeded when observers have confirmed what stands at
    the stations ``looks`` now. ``ended_ns`` is as in ``action.succeeded``."""

    looks: tuple[StationName, ...]
    result: Any = None
    ended_ns: int = 0


@event("action.succeeded")
class ActionSucceeded(ActionEvent, frozen=True):
    """The action succeeded; its effects follow as further events. ``ended_ns`` is the end by the node's own
    clock (UTC ns). It is 0 if the node reported no time, or a time before the request."""

    result: Any = None
    ended_ns: int = 0


@event("action.failed")
class ActionFailed(ActionEvent, frozen=True):
    """The action failed; ``effects`` says how much of it took place. ``kind`` is ``software`` if the device
    reported an error. It is ``operational`` if the device reported a collision, or if it reported success and
    an observer saw something else."""

    error: str
    effects: EffectsDone
    kind: FailureKind = "software"


@event("action.unknown")
class ActionUnknown(ActionEvent, frozen=True):
    """It is unknown whether the action was done. A sensor or a person has to find out."""

    why: str


@event("action.reconciled")
class ActionReconciled(ActionEvent, frozen=True):
    """An action's unknown outcome is now known; ``by`` names the person or module that reported it. If the
    action was done, ``result`` is the value that later steps read."""

    effects: EffectsDone
    by: str
    result: Any = None


ActionEnd = ActionRejected | ActionSucceeded | ActionFailed | ActionReconciled
"""The events with which an action ends."""


@event("action.evidence")
class ActionEvidence(ActionEvent, frozen=True):
    """A result arrived after the outcome of the action had already been settled."""

    succeeded: bool
    effects: EffectsDone
    settled_as: EffectsDone
    error: str = ""


@event("action.discovered")
class ActionDiscovered(Event, frozen=True):
    """A node's journal has an action that the log does not have: the log has lost its end. ``position`` is
    the position of its request (0: not known). ``effects`` are its planned effects on labware; null if the
    journal does not have them."""

    STREAM = "module"
    action: ActionId
    module: ModuleName
    name: str
    status: str
    position: int = 0
    effects: tuple[AnyEffect, ...] | None = None


class ActionStatus(StrEnum):
    """The progress of an action that has not ended. ``REPORTED``: its device has reported success, and an
    observer still has to confirm it. ``UNKNOWN``: a sensor or a person has to find out how it ended."""

    REQUESTED = "requested"
    ACCEPTED = "accepted"
    REPORTED = "reported"
    UNKNOWN = "unknown"


class Action(msgspec.Struct):
    """An action that has not ended. ``looks`` are the stations that observers have to confirm after the
    device has reported success; ``result`` and ``ended_ns`` are from this report. ``together`` are all
    actions that its device carries out at once with this one, this one included."""

    id: ActionId
    run: RunId
    step: int
    module: ModuleName
    attempt: int
    epoch: int
    journal: str
    name: str
    args: dict[str, Any]
    effects: tuple[AnyEffect, ...]
    exclusive: bool
    files: dict[str, str]
    position: int
    requested_at: int
    status: ActionStatus = ActionStatus.REQUESTED
    looks: tuple[StationName, ...] = ()
    result: Any = None
    ended_ns: int = 0
    together: tuple[ActionId, ...] = ()


class Settled(msgspec.Struct):
    """How an unknown action was reconciled."""

    module: ModuleName
    effects: EffectsDone


class Actions(msgspec.Struct):
    """Open actions, and the last ended ones. ``settled`` keeps the last reconciled actions, to judge late
    results. ``ended`` keeps the last ended actions of each module; their nodes may not have received the
    acknowledgement yet. ``in_cell`` is an index of the open actions by the workcell of their module."""

    open: dict[ActionId, Action] = {}
    settled: dict[ActionId, Settled] = {}
    discovered: dict[ActionId, ModuleName] = {}
    ended: dict[ModuleName, list[ActionId]] = {}
    in_cell: dict[str, dict[ActionId, bool]] = {}

    def list_in_cell(self, cell: str) -> list[Action]:
        """The open actions of a workcell's modules, in the order in which they were requested."""
        return [self.open[name] for name in self.in_cell.get(cell, ())]

    def is_any_moving(self, cell: str) -> bool:
        """Whether an action of a workcell's modules is under way whose outcome is not in doubt."""
        return any(action.status != ActionStatus.UNKNOWN for action in self.list_in_cell(cell))


CLOCK_SKEW_NS = 10_000_000_000
"""The times of a node are not used if its clock differs by more than this."""


def explain_disbelief(action: Action, module: str, journal: str, attempt: int) -> str:
    """Why a message is no proof of how an action ended; empty if it is one. The message has to come from the
    module that got the request. It has to name the journal for which the request was meant, and the attempt
    that was sent last. Otherwise the kernel has to ask the node first."""
    if module != action.module:
        return f"{action.module} has this action, not {module}"
    if journal != action.journal:
        return f"the request was for journal {action.journal}, not for {journal}"
    if attempt != action.attempt:
        return f"the last attempt sent is {action.attempt}, not {attempt}"
    return ""


def find_device_time(action: Action, ended_ns: int, now: int) -> int:
    """The end of an action by its node's clock (UTC ns). It is 0 if the node reported no time or an
    impossible one: long before the request, or in the future."""
    possible = action.requested_at - CLOCK_SKEW_NS <= ended_ns <= now + CLOCK_SKEW_NS
    return ended_ns if possible else 0


SETTLED_KEPT = 256

ENDED_KEPT = 32


def fold_action_requested(actions: Actions, event: ActionRequested, at: int, position: int) -> None:
    actions.open[event.action] = Action(  # written out: ``make_from`` takes six times as long
        id=event.action,
        run=event.run,
        step=event.step,
        module=event.module,
        attempt=event.attempt,
        epoch=event.epoch,
        journal=event.journal,
        name=event.name,
        args=event.args,
        effects=event.effects,
        exclusive=event.exclusive,
        files=event.files,
        position=position,
        requested_at=at,
        together=event.together,
    )
    actions.in_cell.setdefault(workcell_of(event.module), {})[event.action] = True


def fold_action_accepted(actions: Actions, event: ActionAccepted, at: int) -> None:
    actions.open[event.action].status = ActionStatus.ACCEPTED


def fold_action_reported(actions: Actions, event: ActionReported, at: int) -> None:
    action = actions.open[event.action]
    action.status, action.looks = ActionStatus.REPORTED, event.looks
    action.result, action.ended_ns = event.result, event.ended_ns


def fold_action_unknown(actions: Actions, event: ActionUnknown, at: int) -> None:
    actions.open[event.action].status = ActionStatus.UNKNOWN


def fold_action_ended(
    actions: Actions, event: ActionRejected | ActionSucceeded | ActionFailed, at: int
) -> None:
    _end(actions, event)


def _end(actions: Actions, event: ActionEvent) -> None:
    action = actions.open.pop(event.action)
    here = actions.in_cell.get(workcell_of(action.module))
    if here is not None:
        here.pop(event.action, None)
    ended = actions.ended.setdefault(event.module, [])
    ended.append(event.action)
    if len(ended) > ENDED_KEPT:
        del ended[0]


def fold_action_reconciled(actions: Actions, event: ActionReconciled, at: int) -> None:
    _end(actions, event)
    actions.settled[event.action] = Settled(event.module, event.effects)
    while len(actions.settled) > SETTLED_KEPT:
        del actions.settled[next(iter(actions.settled))]


def fold_action_evidence(actions: Actions, event: ActionEvidence, at: int) -> None:
    actions.settled.pop(event.action, None)


def fold_action_discovered(actions: Actions, event: ActionDiscovered, at: int) -> None:
    actions.discovered[event.action] = event.module
