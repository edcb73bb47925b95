"""The labware that an event concerns."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from labos.audit._rows import RowChanges
from labos.audit._work_tables import ACTIONS
from labos.core.actions import ActionEvent, ActionRequested
from labos.core.interventions import InterventionRequested
from labos.core.labware import LabwareEvent, StationObserved
from labos.core.registry import Event


def list_touched(rows: RowChanges, event: Event) -> Iterable[str]:
    """The ids of the labware of an event, each once. Later events of an action concern the labware of its
    request."""
    if isinstance(event, LabwareEvent):
        on = getattr(event, "on", "")
        return {event.labware, on} if on else (event.labware,)
    if isinstance(event, ActionRequested):
        return labware_of(event.effects)
    if isinstance(event, ActionEvent):
        names: Iterable[str] = rows.get(ACTIONS, event.action)["labware"]
        return names
    if isinstance(event, InterventionRequested):
        return {*event.labware, *labware_of(event.motions)}
    if isinstance(event, StationObserved) and event.labware:
        return (event.labware,)
    return ()


def labware_of(effects: Iterable[Any]) -> list[str]:
    """The labware in effects, including lids and their plates, in order and each once."""
    found: dict[str, bool] = {}
    for effect in effects:
        for field in ("labware", "plate"):
            name = getattr(effect, field, "")
            if name:
                found[str(name)] = True
    return list(found)
