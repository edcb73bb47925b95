"""Nodes join, leave and report their state. If a message in the name of a module is not accepted, a person is
notified once."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

from labos.core.decide._base import Command, Decision, InnerCommand, Rejection, Report, decides
from labos.core.decide.lookups import decides_about, find_present_module
from labos.core.decide.shorter import FoundAction, record_journal
from labos.core.decide.steps import doubt
from labos.core.failures import list_failures_since
from labos.core.ids import ModuleName, local
from labos.core.modules import (
    EmergencyStopped,
    Module,
    ModulePutBack,
    ModuleStatus,
    ModuleTakenOut,
    NodeJoined,
    NodeLeft,
    NodeStateChanged,
    StopReported,
)
from labos.core.registry import Event
from labos.core.rules import convert_lab_s, find_give_up_time
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.texts import cut
from labos.core.topics import DoubtfulNode, OutrankedNode
from labos.core.words import Words


class JoinNode(Report, frozen=True):
    """A living node represents a module. ``discovered`` are actions in its journal that the log does not
    have. ``beyond`` is the highest log position that the node has received, if the log ends before it; then
    no action starts before a person has checked the bench."""

    module: ModuleName
    journal: str
    instance: str
    driver: str
    version: str
    about: str
    status: str
    simulated: bool = False
    discovered: tuple[FoundAction, ...] = ()
    beyond: int = 0


class LoseNode(Report, frozen=True):
    """The node of this instance is gone or does not answer; ``stopped``: LabOS ended it."""

    module: ModuleName
    instance: str
    why: str
    stopped: bool = False


class ReportState(Report, frozen=True):
    """A node reports IDLE, BUSY or ERROR."""

    module: ModuleName
    status: str
    error: str = ""


class HearJournal(Report, frozen=True):
    """A module's journal has actions that the log does not have; ``beyond`` as for ``JoinNode``."""

    module: ModuleName
    found: tuple[FoundAction, ...] = ()
    beyond: int = 0


LARGEST_EPOCH = 2**53
"""No kernel ever has a greater epoch: ``labos db restored`` counts seconds."""


class DoubtNode(Report, frozen=True):
    """A message in the name of a module was not accepted; it has no other consequence. For each module at
    most one such question is open, however many messages come."""

    module: ModuleName
    why: str


class OutrankNode(Report, frozen=True):
    """A node obeys a later kernel than this one, although the database says that this one is the lab's
    kernel. So the log may be an older copy. The module is used again when a person has compared the bench
    with the log."""

    module: ModuleName
    epoch: int


class TakeOut(Command, frozen=True):
    """Take a module out of service, until a person puts it back or until a time (UTC ns)."""

    module: ModuleName
    why: Words
    until: int = 0
    now: int = 0


class Quarantine(InnerCommand, frozen=True):
    """Take a module out of service that has failed ``after`` times within ``within_s`` lab seconds."""

    module: ModuleName
    after: int
    within_s: float
    now: int


class PutBack(Command, frozen=True):
    """Put a module back in service."""

    module: ModuleName


class EndOutage(InnerCommand, frozen=True):
    """The end of a module's time out of service has come."""

    module: ModuleName
    now: int


MOST_SILENT = 300
"""The most modules that are recorded as not having confirmed a stop."""

LONGEST_SILENT = 120
"""The most characters of the reason why they did not."""


class RecordStops(Report, frozen=True):
    """A person has stopped modules in an emergency, at these times (UTC ns). If the lab reports its own
    request, ``target`` names the target of this request, and ``silent`` the modules that did not confirm."""

    by: str
    stopped_at: dict[ModuleName, int]
    target: str = ""
    silent: dict[ModuleName, str] = {}


def _expect_known(state: LabState, command: Any) -> Module | Rejection:
    found = state.modules.by_name.get(command.module)
    return found or Rejection(
        "no_module",
        f"No workcell of this lab has a module {local(command.module)}.",
        "Add it to the workcell file and apply it, or start the node under another --name.",
    )


@decides_about(JoinNode, _expect_known)
def join_node(state: LabState, command: JoinNode, module: Module) -> Decision:
    if module.status != ModuleStatus.GONE and module.instance == command.instance:
        return []
    if module.status != ModuleStatus.GONE:
        return Rejection(
            "name_taken",
            f"Two nodes claim the module {local(command.module)}.",
            "Stop one of them; the one that joined first is kept.",
        )
    if module.spec.driver and module.spec.driver != command.driver:
        return Rejection(
            "wrong_driver",
            f"The node that claims {local(command.module)} runs the driver {command.driver!r}; the "
            f"workcell file requires {module.spec.driver!r}.",
            "Start the right driver, or correct the workcell file.",
        )
    return [
        make_from(NodeJoined, command),
        *record_journal(state, command.module, command.discovered, command.beyond),
    ]


@decides_about(LoseNode, find_present_module)
def lose_node(state: LabState, command: LoseNode, module: Module) -> Decision:
    known = module.instance == command.instance
    return [NodeLeft(command.module, command.why, command.stopped)] if known else []


@decides_about(ReportState, find_present_module)
def report_state(state: LabState, command: ReportState, module: Module) -> Decision:
    """Only transitions that no action explains are recorded."""
    status = command.status
    if status == "BUSY" and module.in_flight:
        status = (
            "BUSY" if module.status == ModuleStatus.BUSY else "IDLE"
        )  # the error is over, and the action continues
    if status == module.status and command.error == module.error:
        return []
    return [NodeStateChanged(command.module, status, command.error)]


@decides_about(HearJournal, _expect_known)
def check_journal(state: LabState, command: HearJournal, module: Module) -> Decision:
    return record_journal(state, command.module, command.found, command.beyond)


@decides(DoubtNode)
def doubt_node(state: LabState, command: DoubtNode) -> Decision:
    known = command.module in state.modules.by_name
    if not known or state.interventions.list_about(command.module, DoubtfulNode):
        return []
    name = local(command.module)
    return [
        state.interventions.ask(
            DoubtfulNode(module=command.module),
            f"LabOS ignored a message on the bus in the name of {name}, because it may be false: "
            f"{command.why}. Either a second node uses this name, or a program sends false messages.",
        )
    ]


@decides(OutrankNode)
def outrank_node(state: LabState, command: OutrankNode) -> Decision:
    known = command.module in state.modules.by_name
    if not known or state.interventions.list_about(command.module, OutrankedNode):
        return []
    name, epoch = local(command.module), state.lab.epoch
    if command.epoch > LARGEST_EPOCH:
        what = "No kernel has such an epoch: the node received a false one, and its journal has to be reset"
    else:
        what = (
            "If this database was put back from an older copy, compare the bench with the record, stop the "
            "lab, say labos db restored and start it again. If it was not, another kernel of this lab runs "
            "elsewhere with a copy of its database"
        )
    obeys = f"obeys the kernel of epoch {command.epoch}; this one's is {epoch}"
    return [
        ModuleTakenOut(command.module, f"it {obeys}"),
        state.interventions.ask(
            OutrankedNode(module=command.module),
            f"The node of {name} {obeys}, and the database calls this one the lab's kernel. {what}. "
            "Labware may stand elsewhere than recorded.",
        ),
    ]


@decides_about(TakeOut, _expect_known)
def take_out(state: LabState, command: TakeOut, module: Module) -> Decision:
    if command.until and command.until <= command.now:
        return Rejection("past", "The end of the time out of service is in the past.")
    return _take_out(state, command)


def _take_out(state: LabState, command: TakeOut) -> Iterator[Event]:
    yield ModuleTakenOut(command.module, command.why or "no reason given", command.until)
    for action in list(state.actions.open.values()):
        if action.module == command.module and find_give_up_time(state, action) is not None:
            yield from doubt(state, action, "its node is gone, and the module was taken out of service")


@decides(Quarantine)
def quarantine(state: LabState, command: Quarantine) -> Decision:
    module = state.modules.by_name.get(command.module)
    if module is None or module.out_of_service or command.after < 1:
        return []
    failed = list_failures_since(module, command.now - convert_lab_s(state, command.within_s))
    if len(failed) < command.after:
        return []
    often = f"{len(failed)} times in {command.within_s:g} s"
    why = f"quarantined: it has failed {often}, at last: {failed[-1].what}"
    return [ModuleTakenOut(command.module, why, failures=len(failed))]


@decides_about(PutBack, _expect_known)
def put_back(state: LabState, command: PutBack, module: Module) -> Decision:
    return [ModulePutBack(command.module)] if module.out_of_service else []


@decides(EndOutage)
def end_outage(state: LabState, command: EndOutage) -> Decision:
    back_at = state.modules.back_at.get(command.module)
    return [] if back_at is None or back_at > command.now else [ModulePutBack(command.module)]


@decides(RecordStops)
def record_stops(state: LabState, command: RecordStops) -> Decision:
    """Nodes repeat this report with each heartbeat until they are reset; it is recorded once."""
    known = state.modules.by_name
    stops = command.stopped_at.items()
    fresh = [(name, at) for name, at in stops if name in known and known[name].stopped_at != at]
    events: list[Event] = [EmergencyStopped(name, command.by, at) for name, at in fresh]
    if command.target:
        silent = dict(islice(command.silent.items(), MOST_SILENT))
        silent = {name: cut(why, LONGEST_SILENT) for name, why in silent.items()}
        events.append(StopReported(command.by, command.target, command.stopped_at, silent))
    return events
