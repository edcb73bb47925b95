"""Commands ask, ``decide`` answers with events or a rejection. One file per family."""

import msgspec

from labos.core.decide import (
    access,
    actions,
    cancelling,
    control,
    experiments,
    handover,
    interventions,
    lab,
    labware,
    nodes,
    observation,
    runs,
    shorter,
    stock,
    teach,
    verification,
    work,
)
from labos.core.decide._base import DECIDERS, Command, Decision, Rejection
from labos.core.ids import InterventionId
from labos.core.interventions import InterventionRequested
from labos.core.registry import Event
from labos.core.state import LabState

__all__ = [
    "Command",
    "Decision",
    "Rejection",
    "access",
    "actions",
    "cancelling",
    "control",
    "decide",
    "experiments",
    "handover",
    "interventions",
    "lab",
    "labware",
    "nodes",
    "observation",
    "runs",
    "shorter",
    "stock",
    "teach",
    "verification",
    "work",
]


def decide(state: LabState, command: Command) -> Decision:
    """The events that carry out a command, or why it cannot be carried out. Changes nothing."""
    decision = DECIDERS[type(command)](state, command)
    if isinstance(decision, list):
        return _numbered(state, decision)
    return decision


def _numbered(state: LabState, events: list[Event]) -> list[Event]:
    """Give the batch's interventions their ids."""
    number = state.interventions.named
    out: list[Event] = []
    for event in events:
        if isinstance(event, InterventionRequested):
            number += 1
            event = msgspec.structs.replace(event, intervention=InterventionId(f"I{number}"))
        out.append(event)
    return out
