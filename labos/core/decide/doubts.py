"""Somebody who speaks for a module is not believed: a person is told, once."""

from __future__ import annotations

from labos.core.decide._base import Decision, Report, decides
from labos.core.ids import ModuleName, local
from labos.core.interventions import UNNUMBERED, Choice, InterventionRequested
from labos.core.modules import ModuleTakenOut
from labos.core.state import LabState

DOUBTFUL_NODE = "doubtful_node"
"""Words on the bus that the lab did not believe."""

OUTRANKED_NODE = "outranked_node"
"""A node that obeys a later kernel than this one."""

LARGEST_EPOCH = 2**53
"""No kernel ever has a greater one: ``labos db restored`` counts seconds."""


class DoubtNode(Report, frozen=True):
    """Something was said in the name of a module that is not believed; nothing follows from it. However much
    of it comes, one question is open for each module."""

    module: ModuleName
    why: str


class OutrankNode(Report, frozen=True):
    """A node obeys a later kernel than this one, whom the database calls the lab's kernel: the log may be an
    older copy. The module is used again when a person has compared the bench with the log."""

    module: ModuleName
    epoch: int


@decides(DoubtNode)
def doubt_node(state: LabState, command: DoubtNode) -> Decision:
    if command.module not in state.modules.by_name or _is_asked(state, DOUBTFUL_NODE, command.module):
        return []
    name = local(command.module)
    return [
        InterventionRequested(
            UNNUMBERED,
            DOUBTFUL_NODE,
            command.module,
            f"What was said on the bus in the name of {name} is not believed, and nothing was done about it: "
            f"{command.why}. Either a second node uses this name, or somebody sends false messages.",
            (Choice("checked", f"Somebody has looked at which processes speak for {name}."),),
            module=command.module,
        )
    ]


@decides(OutrankNode)
def outrank_node(state: LabState, command: OutrankNode) -> Decision:
    known = command.module in state.modules.by_name
    if not known or _is_asked(state, OUTRANKED_NODE, command.module):
        return []
    name, epoch = local(command.module), state.lab.epoch
    if command.epoch > LARGEST_EPOCH:
        what = "No kernel has such an epoch: the node was given a false one, and its journal has to be reset"
    else:
        what = (
            "If this database was put back from an older copy, compare the bench with the record, stop the "
            "lab, say labos db restored and start it again. If it was not, another kernel of this lab runs "
            "elsewhere with a copy of its database"
        )
    obeys = f"obeys the kernel of epoch {command.epoch}; this one's is {epoch}"
    return [
        ModuleTakenOut(command.module, f"it {obeys}"),
        InterventionRequested(
            UNNUMBERED,
            OUTRANKED_NODE,
            command.module,
            f"The node of {name} {obeys}, and the database calls this one the lab's kernel. {what}. "
            "Labware may stand elsewhere than recorded.",
            (Choice("checked", f"The bench was compared with the record; {name} is used again."),),
            module=command.module,
        ),
    ]


def _is_asked(state: LabState, kind: str, module: ModuleName) -> bool:
    return any(q.kind == kind and q.module == module for q in state.interventions.open.values())
