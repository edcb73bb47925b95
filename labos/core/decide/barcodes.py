"""The events that follow when a barcode was read, and the question if it contradicts the log."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.actions import Action
from labos.core.bench import Labware, remove_labware
from labos.core.effects import Reads
from labos.core.ids import LabwareId, local
from labos.core.labware import GONE, BarcodeRead, LabwareObserved, LabwareUncertain
from labos.core.registry import Event
from labos.core.runs import RunPaused
from labos.core.state import LabState
from labos.core.topics import Barcode

LONGEST_BARCODE = 128


def find_barcode(result: Any) -> str:
    """The barcode in a result; empty if none could be read."""
    found = result.get("barcode") if isinstance(result, dict) else result
    text = found.strip() if isinstance(found, str) else ""
    return text if text.isprintable() and len(text) <= LONGEST_BARCODE else ""


def record_barcodes(state: LabState, action: Action, result: Any, by: str = "") -> list[Event]:
    """The events that follow from the barcode that an action read. If it contradicts the log, two things
    become uncertain: the place of the labware, and the other labware with this barcode. Only steps that need
    this labware wait. ``by`` is the person or module that reported the barcode, if it is not the acting
    module."""
    code = find_barcode(result)
    if not code:
        return []
    for effect in action.effects:
        labware = state.bench.labware.get(effect.labware) if isinstance(effect, Reads) else None
        if labware is None or not labware.station:
            continue
        holder = state.bench.barcodes.get(code)
        if holder == labware.id or (holder is None and not labware.barcode):
            who = by or local(action.module)
            return [BarcodeRead(labware.id, action.run, code, who, action.id)]
        other = state.bench.labware[holder] if holder is not None else None
        return _report_contradiction(state, action, labware, other, code)
    return []


def _report_contradiction(
    state: LabState, action: Action, labware: Labware, other: Labware | None, code: str
) -> list[Event]:
    place = local(labware.station)
    reading = f"{local(action.module)} read the barcode {code} at {place}, where {labware.id} should stand."
    known = f" {labware.id} bears {labware.barcode}." if labware.barcode else ""
    events: list[Event] = []
    places = (labware.station, GONE)
    topic = Barcode(
        run=action.run,
        module=action.module,
        action=action.id,
        labware=labware.id,
        station=labware.station,
        barcode=code,
    )
    if other is not None:
        known += f" {code} is the barcode of {other.id}, recorded at {_describe_place(other)}."
        if other.station and not other.moving:
            topic = msgspec.structs.replace(topic, other=other.id, elsewhere=other.station)
            places = (labware.station, other.station)
            why = f"its barcode was read at {place}"
            both = (other.station, labware.station)
            events.append(LabwareUncertain(other.id, action.run, both, why, action.id))
    why = f"another barcode ({code}) was read at its place"
    return [
        LabwareUncertain(labware.id, action.run, places, why, action.id),
        *events,
        state.interventions.ask(topic, f"{reading}{known} What stands there?"),
    ]


def _describe_place(labware: Labware) -> str:
    if labware.moving:
        return "a module that works on it"
    return local(labware.station) or " or ".join(local(place) or "nowhere" for place in labware.maybe)


def settle_barcode(state: LabState, topic: Barcode, choice: str, by: str) -> list[Event]:
    """The events that follow when a person has checked the plate. Labware that was found or taken away
    meanwhile is not changed."""
    labware, other = find_uncertain(state, topic.labware), find_uncertain(state, topic.other)
    here = topic.station
    events: list[Event] = []
    if other is not None:
        there = other.maybe[0] if choice not in ("swapped", "other") else here
        events.append(LabwareObserved(other.id, "", there, by))
    if choice in ("swapped", "other"):
        # If the other plate is shared, the run might use it as if it were its own.
        run = state.runs.get(topic.run)
        events += [RunPaused(run.id)] if run is not None and not run.paused else []
    if labware is None:
        return events
    if choice in ("gone", "other"):
        why = f"not where it was recorded ({by})"
        return [*events, *remove_labware(state.bench, labware.id, "", GONE, why)]
    place = other.maybe[0] if choice == "swapped" and other is not None else here
    events.append(LabwareObserved(labware.id, "", place, by))
    if choice == "relabelled":
        events.append(BarcodeRead(labware.id, "", topic.barcode, by))
    return events


def find_uncertain(state: LabState, name: LabwareId) -> Labware | None:
    """The labware, if its place is uncertain."""
    labware = state.bench.labware.get(name)
    return labware if labware is not None and labware.maybe else None
