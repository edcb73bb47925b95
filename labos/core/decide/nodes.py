"""Nodes come and go and report their state."""

from __future__ import annotations

from labos.core.actions import ActionDiscovered
from labos.core.decide._base import Command, Decision, Rejection, Report, decides
from labos.core.decide.steps import doubting
from labos.core.failures import since
from labos.core.ids import ActionId, ModuleName, local
from labos.core.interventions import UNNUMBERED, Choice, InterventionRequested
from labos.core.modules import (
    EmergencyStopped,
    ModulePutBack,
    ModuleTakenOut,
    NodeJoined,
    NodeLeft,
    NodeStateChanged,
)
from labos.core.registry import Event
from labos.core.rules import lab_ns, missed_at
from labos.core.state import LabState


class JoinNode(Report, frozen=True):
    """A living node answers for a module. ``discovered`` are actions that its journal knows and the
    log does not; ``beyond`` is the position up to which it was told of things, if the log does not
    hold all of that. Nothing is started on the module before a person has looked."""

    module: ModuleName
    journal: str
    instance: str
    driver: str
    version: str
    about: str
    status: str
    simulated: bool = False
    discovered: tuple[tuple[ActionId, str, str], ...] = ()
    beyond: int = 0


class LoseNode(Report, frozen=True):
    """The node of that instance is gone or silent; ``stopped``: it was told to end."""

    module: ModuleName
    instance: str
    why: str
    stopped: bool = False


class ReportState(Report, frozen=True):
    """A node says IDLE, BUSY or ERROR."""

    module: ModuleName
    status: str
    error: str = ""


class DiscoverAction(Report, frozen=True):
    """A node's journal holds an action that the log does not."""

    module: ModuleName
    action: ActionId
    name: str
    status: str


class TakeOut(Command, frozen=True):
    """Take a module out of service, until it is put back or until a time (UTC ns)."""

    module: ModuleName
    why: str
    until: int = 0
    now: int = 0


class Quarantine(Command, frozen=True):
    """Take a module out of service that has failed ``after`` times within ``within_s`` lab seconds."""

    module: ModuleName
    after: int
    within_s: float
    now: int


class PutBack(Command, frozen=True):
    """Put a module back in service."""

    module: ModuleName


class EndOutage(Command, frozen=True):
    """The time has come until which a module was taken out of service."""

    module: ModuleName
    now: int


class RecordStop(Report, frozen=True):
    """A node says that somebody stopped it in an emergency."""

    module: ModuleName
    by: str
    stopped_at: int


def _unknown(module: ModuleName) -> Rejection:
    return Rejection(
        "no_module",
        f"No workcell of this lab has a module {local(module)}.",
        "Add it to the workcell file and apply it, or start the node under another --name.",
    )


@decides(JoinNode)
def join_node(state: LabState, command: JoinNode) -> Decision:
    module = state.modules.by_name.get(command.module)
    if module is None:
        return _unknown(command.module)
    if module.status != "GONE" and module.instance == command.instance:
        return []
    if module.status != "GONE":
        return Rejection(
            "name_taken",
            f"Two nodes claim the module {local(command.module)}.",
            "Stop one of them; the one that joined first is kept.",
        )
    if module.spec.driver and module.spec.driver != command.driver:
        return Rejection(
            "wrong_driver",
            f"The node that claims {local(command.module)} runs the driver {command.driver!r}; "
            f"the workcell wants {module.spec.driver!r}.",
            "Start the right driver, or correct the workcell file.",
        )
    joined = NodeJoined(
        command.module,
        command.journal,
        command.instance,
        command.driver,
        command.version,
        command.about,
        command.status,
        command.simulated,
    )
    events: list[Event] = [joined]
    for action, name, status in command.discovered:
        if action not in state.actions.discovered and action not in state.actions.open:
            events += _discovered(command.module, action, name, status)
    if command.beyond and not _asked_about(state, command.module):
        events += _behind(command.module, command.beyond, state.position)
    return events


@decides(LoseNode)
def lose_node(state: LabState, command: LoseNode) -> Decision:
    module = state.modules.by_name.get(command.module)
    if module is None or module.status == "GONE" or module.instance != command.instance:
        return []
    return [NodeLeft(command.module, command.why, command.stopped)]


@decides(ReportState)
def report_state(state: LabState, command: ReportState) -> Decision:
    """Only transitions that no action explains are worth an event."""
    module = state.modules.by_name.get(command.module)
    if module is None or module.status == "GONE":
        return []
    status = command.status
    if status == "BUSY" and module.in_flight:
        status = "IDLE" if module.status == "IDLE" else module.status
    if status == module.status and command.error == module.error:
        return []
    return [NodeStateChanged(command.module, status, command.error)]


@decides(DiscoverAction)
def discover_action(state: LabState, command: DiscoverAction) -> Decision:
    if command.action in state.actions.discovered or command.action in state.actions.open:
        return []
    if command.module not in state.modules.by_name:
        return _unknown(command.module)
    return _discovered(command.module, command.action, command.name, command.status)


def _discovered(module: ModuleName, action: ActionId, what: str, status: str) -> list[Event]:
    """The node did what the log does not know: nothing is started on it before a person has looked."""
    return [
        ActionDiscovered(action, module, what, status),
        ModuleTakenOut(module, f"its journal knows an action {what!r} that the log does not"),
        _compare(
            module, action, f"{local(module)} carried out {what!r} ({status}), which this log does not know"
        ),
    ]


def _behind(module: ModuleName, beyond: int, end: int) -> list[Event]:
    """The node was told of more than the log holds, and has forgotten what it did up to there."""
    return [
        ModuleTakenOut(module, f"it was told of a log up to position {beyond}, which this one lacks"),
        _compare(
            module,
            str(module),
            f"{local(module)} was told that the log holds everything up to position {beyond}; this log does "
            f"not (it ends at {end}), and the node no longer knows what it did meanwhile",
        ),
    ]


def _compare(module: ModuleName, subject: str, found: str) -> InterventionRequested:
    return InterventionRequested(
        UNNUMBERED,
        "discovered_action",
        subject,
        f"{found}: the log was probably restored from an older copy. "
        "Labware may stand elsewhere than recorded.",
        (Choice("checked", f"The bench was compared with the record; {local(module)} is used again."),),
        module=module,
    )


@decides(TakeOut)
def take_out(state: LabState, command: TakeOut) -> Decision:
    if command.module not in state.modules.by_name:
        return _unknown(command.module)
    if command.until and command.until <= command.now:
        return Rejection("past", "The time until which it is to be out of service is over already.")
    refused = _asked_about(state, command.module)
    if refused:
        return refused
    events: list[Event] = [ModuleTakenOut(command.module, command.why or "no reason given", command.until)]
    for action in state.actions.open.values():
        if action.module == command.module and missed_at(state, action) is not None:
            events += doubting(state, action, "its node is gone, and the module was taken out of service")
    return events


@decides(Quarantine)
def quarantine(state: LabState, command: Quarantine) -> Decision:
    module = state.modules.by_name.get(command.module)
    if module is None or module.out_of_service or command.after < 1:
        return []
    failed = since(module, command.now - lab_ns(state, command.within_s))
    if len(failed) < command.after:
        return []
    often = f"{len(failed)} times in {command.within_s:g} s"
    why = f"quarantined: it has failed {often}, at last: {failed[-1].what}"
    return [ModuleTakenOut(command.module, why, failures=len(failed))]


@decides(PutBack)
def put_back(state: LabState, command: PutBack) -> Decision:
    module = state.modules.by_name.get(command.module)
    if module is None:
        return _unknown(command.module)
    if not module.out_of_service:
        return []
    return _asked_about(state, command.module) or [ModulePutBack(command.module)]


def _asked_about(state: LabState, module: ModuleName) -> Rejection | None:
    """A module whose journal knows more than the log comes back by an answer only."""
    for question in state.interventions.open.values():
        if question.kind == "discovered_action" and question.module == module:
            return Rejection(
                "asked",
                f"{local(module)} is out of service: {state.modules.by_name[module].out_of_service}.",
                f"Answer {question.id} first.",
            )
    return None


@decides(EndOutage)
def end_outage(state: LabState, command: EndOutage) -> Decision:
    back_at = state.modules.back_at.get(command.module)
    return [] if back_at is None or back_at > command.now else [ModulePutBack(command.module)]


@decides(RecordStop)
def record_stop(state: LabState, command: RecordStop) -> Decision:
    """Nodes tell it again with each heartbeat until they are reset: it is written once."""
    module = state.modules.by_name.get(command.module)
    if module is None:
        return _unknown(command.module)
    if command.stopped_at == module.stopped_at:
        return []
    return [EmergencyStopped(command.module, command.by, command.stopped_at)]
