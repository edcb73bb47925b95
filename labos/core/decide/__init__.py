"""Commands ask, ``decide`` answers with events or a rejection. One file per family."""

import msgspec

from labos.core.decide import (
    access,
    actions,
    cancelling,
    control,
    doubts,
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
from labos.core.decide._base import DECIDERS, UNFIT, Command, Decision, Rejection, Report, recordable
from labos.core.decide.limits import bare_report, cut_report, misfit
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
    "doubts",
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
    if isinstance(command, Report):
        command = cut_report(command)
    elif fault := misfit(command):
        return fault
    decision = _decide(state, command)
    if isinstance(command, Report) and isinstance(decision, Rejection) and decision.code == UNFIT:
        return _decide(state, bare_report(command))  # what has happened is recorded, if without the words
    return decision


def _decide(state: LabState, command: Command) -> Decision:
    decision = DECIDERS[type(command)](state, command)
    return recordable(_numbered(state, decision)) if isinstance(decision, list) else decision


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
