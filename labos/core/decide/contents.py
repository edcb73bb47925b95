"""The events that follow when a person reports everything that stands at a station: the record is changed to
match the report."""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.bench import StationState, split_item
from labos.core.decide._base import Rejection
from labos.core.ids import SHARED, LabwareId, StationName, local
from labos.core.labware import (
    GONE,
    LabwareMoved,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    LabwareUncertain,
    StationDeclared,
    StationObserved,
)
from labos.core.registry import Event
from labos.core.state import LabState


def list_recorded(state: LabState, name: StationName) -> list[str]:
    """The labware at a station according to the record, in the form that ``list_contents_events`` accepts."""
    station, labware = state.bench.stations[name], state.bench.labware
    if station.spec.kind == "waste":
        return ["labware"] * station.level
    return [*station.stock, *(_name_with_lid(item, labware[item].lid) for item in station.labware)]


def _name_with_lid(name: str, lid: str) -> str:
    return f"{name}+{lid}" if lid else name


def list_contents_events(
    state: LabState, station: StationState, contents: Sequence[str], by: str
) -> list[Event] | Rejection:
    """The events that change the record of a station to ``contents``, bottom to top. Each entry is the id of
    labware, or the type of labware that the log does not know, with its lid (``P7+P8``). Labware that was
    recorded there and is not in ``contents`` becomes uncertain."""
    name = station.spec.name
    if len(contents) > station.spec.capacity:
        return Rejection(
            "too_many",
            f"{local(name)} holds {station.spec.capacity}, not {len(contents)}.",
            "Declare at most that many pieces.",
        )
    if station.spec.kind == "waste":
        return [StationDeclared(name, tuple(contents))] if len(contents) != station.level else []
    pieces = [split_item(item) for item in contents]
    named = [piece for pair in pieces for piece in pair if piece in state.bench.labware]
    wrong = _refuse_misfit(state, station, pieces, named)
    if wrong:
        return wrong
    if station.spec.kind == "stack":
        return _list_stack_events(state, station, pieces, by)
    return [
        *_remove_missing(station, pieces, by),
        *_place_or_observe(state, station, pieces, by),
        StationObserved(name, by, len(contents)),
    ]


def _refuse_misfit(
    state: LabState, station: StationState, pieces: Sequence[tuple[str, str]], named: Sequence[str]
) -> Rejection | None:
    """Why these pieces cannot stand at the station; None if they can."""
    twice = next((piece for piece in named if named.count(piece) > 1), "")
    if twice:
        return Rejection("twice", f"{twice} is named twice at {local(station.spec.name)}.", "Name it once.")
    for piece in named:
        place = state.bench.labware[LabwareId(piece)].station
        if place in state.shorter.said and place != station.spec.name:
            return Rejection(
                "said_elsewhere",
                f"{piece} was reported at {local(place)} on this round.",
                f"If that was wrong, first report what stands at {local(place)}.",
            )
    for piece, _ in pieces:
        if piece in state.bench.labware:
            continue
        if not station.spec.admits(piece):
            return Rejection(
                "not_accepted",
                f"{local(station.spec.name)} {station.spec.explain_refusal(piece)}.",
                "If it really stands there, remove it first. Use the ids of known labware (labos labware).",
            )
    return None


def _list_stack_events(
    state: LabState, station: StationState, pieces: Sequence[tuple[str, str]], by: str
) -> list[Event] | Rejection:
    """A stack holds nameless pieces, and on top of them labware with names."""
    name, labware = station.spec.name, state.bench.labware
    tall = [index for index, (piece, _) in enumerate(pieces) if piece in labware]
    top = tall[0] if tall else len(pieces)
    if len(tall) != len(pieces) - top:
        return Rejection(
            "buried",
            f"At {local(name)} labware with an id would lie under labware without an id.",
            "Take it out of the stack, or name it by its type.",
        )
    stock = tuple(f"{kind}+{lid}" if lid else kind for kind, lid in pieces[:top])
    events: list[Event] = []
    if list(stock) != station.stock or not station.known:
        events.append(StationDeclared(name, stock))
    above = pieces[top:]
    return [
        *_remove_missing(station, above, by),
        *events,
        *_place_or_observe(state, station, above, by),
        StationObserved(name, by, len(pieces)),
    ]


def _remove_missing(station: StationState, pieces: Sequence[tuple[str, str]], by: str) -> list[Event]:
    """The events for labware that was recorded there and is missing. They come first, so that there is room
    for the other labware."""
    present = {piece for pair in pieces for piece in pair}
    why = f"{by} did not find it at {local(station.spec.name)}"
    return [LabwareUncertain(item, "", (GONE,), why) for item in station.labware if item not in present]


def _place_or_observe(
    state: LabState, station: StationState, pieces: Sequence[tuple[str, str]], by: str
) -> list[Event]:
    """The events for labware with ids, and for labware that gets its id now."""
    name, labware = station.spec.name, state.bench.labware
    events: list[Event] = []
    as_recorded = [plate for plate, _ in pieces] == station.labware
    number = state.bench.named
    for plate, lid in pieces:
        known = labware.get(LabwareId(plate))
        if known is None:
            number += 1
            stands = LabwareId(f"P{number}")
            events.append(LabwarePlaced(stands, "", plate, name, SHARED))
        else:
            stands = known.id
            if not as_recorded or known.maybe:
                events.append(LabwareObserved(stands, "", name, by))
        bears = known.lid if known is not None else LabwareId("")
        sure = bears and not labware[bears].maybe
        if bears and lid and lid != bears:
            events.append(LabwareRemoved(bears, "", GONE, f"{stands} has another lid ({by})"))
        elif bears and not lid and sure:
            events.append(LabwareUncertain(bears, "", (GONE,), f"{by} saw {stands} without a lid"))
        if lid and lid in labware and not (lid == bears and sure):
            before = labware[LabwareId(lid)].station or name
            events.append(LabwareMoved(LabwareId(lid), "", before, name, on=stands))
        elif lid and lid not in labware:
            number += 1
            events.append(LabwarePlaced(LabwareId(f"P{number}"), "", lid, name, SHARED, on=stands))
    return events
