"""A person's report about labware answers the open questions about this labware."""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.effects import list_carried, list_moved
from labos.core.ids import LabwareId
from labos.core.interventions import Intervention
from labos.core.labware import LabwareObserved, LabwareRemoved
from labos.core.registry import Event
from labos.core.state import LabState

WHERE_IT_IS = ("lost_labware", "failed_run")
"""Questions about the place or the fate of labware."""


def withdraw_answered(state: LabState, events: Sequence[Event], by: str) -> list[Event]:
    """Withdraw the questions that these events answer: all labware of the question was taken away or placed
    by them, or had left the bench before."""
    settled = {labware for event in events if (labware := _find_settled(state, event))}
    return [
        question.withdraw(f"removed, or moved elsewhere, by {by}")
        for question in state.interventions.open.values()
        if (names := _find_asked_for(question)) & settled
        and all(n in settled or n not in state.bench.labware for n in names)
    ]


def _find_settled(state: LabState, event: Event) -> LabwareId | None:
    """The labware that has left the bench by the event, or that stands at a station that is not a hand."""
    if isinstance(event, LabwareObserved):
        return event.labware if state.bench.stations[event.station].spec.kind != "gripper" else None
    return event.labware if isinstance(event, LabwareRemoved) else None


def _find_asked_for(question: Intervention) -> set[LabwareId]:
    """The labware that the question is about; none if some of it has no id yet."""
    if question.kind not in WHERE_IT_IS or any(what.stock for what in list_carried(question.motions)):
        return set()
    return {move.labware for move in list_moved(question.motions)} | {*question.labware}
