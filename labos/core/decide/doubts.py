"""A message in the name of a module that is not accepted: a person is notified once."""

from __future__ import annotations

from labos.core.decide._base import Decision, Report, decides
from labos.core.ids import ModuleName, local
from labos.core.modules import ModuleTakenOut
from labos.core.state import LabState
from labos.core.topics import DoubtfulNode, OutrankedNode, Topic

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


@decides(DoubtNode)
def doubt_node(state: LabState, command: DoubtNode) -> Decision:
    if command.module not in state.modules.by_name or _is_asked(state, DoubtfulNode, command.module):
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
    if not known or _is_asked(state, OutrankedNode, command.module):
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


def _is_asked(state: LabState, topic: type[Topic], module: ModuleName) -> bool:
    return any(question.module == module for question in state.interventions.open_about(topic))
