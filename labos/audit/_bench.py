"""Labware as rows, with its present and earlier places; the labware of an event; and calibrations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from labos.audit._bench_tables import CALIBRATIONS, LOT_USES, MOVES
from labos.audit._bench_tables import LABWARE_TABLE as LABWARE
from labos.audit._rows import Row, RowChanges
from labos.audit._work_tables import ACTIONS
from labos.core import labware as b
from labos.core.actions import ActionEvent, ActionRequested
from labos.core.days import end_of
from labos.core.envelope import Envelope
from labos.core.ids import module_of
from labos.core.interventions import InterventionRequested
from labos.core.labware import LabwareEvent, StationObserved
from labos.core.modules import ModuleCalibrated
from labos.core.registry import Event


def on_placed(rows: RowChanges, event: b.LabwarePlaced, head: Envelope, at: float) -> None:
    row = rows.put(
        LABWARE,
        event,
        station="",
        variables={"lot": event.lot} if event.lot else {},
        samples={},
        placed_at_s=at,
        placed_position=head.position,
    )
    _settle(rows, row, event.station, event.on)
    _note(rows, event, head, at, "placed", event.stack, event.station, event.on)
    if event.lot:
        about = (
            event.lot,
            "labware",
            module_of(event.stack),
            event.type,
            event.labware,
            event.run,
            event.action,
        )
        rows.add(LOT_USES, head.position, 0, at, *about)


def on_moved(rows: RowChanges, event: b.LabwareMoved, head: Envelope, at: float) -> None:
    _settle(rows, rows.change(LABWARE, event.labware), event.target, event.on)
    _note(rows, event, head, at, "moved", event.source, event.target, event.on)


def on_observed(rows: RowChanges, event: b.LabwareObserved, head: Envelope, at: float) -> None:
    row = rows.change(LABWARE, event.labware)
    source = row["station"]
    on = row["lies_on"] if rows.get(LABWARE, row["lies_on"])["station"] == event.station else ""
    _settle(rows, row, event.station, on)
    _note(rows, event, head, at, "observed", source, event.station, on, why=f"observed by {event.by}")


def on_uncertain(rows: RowChanges, event: b.LabwareUncertain, head: Envelope, at: float) -> None:
    row = rows.change(LABWARE, event.labware)
    source = row["station"]
    row["station"], row["maybe"] = "", list(event.places)
    if event.on:
        _lay_on(rows, row, event.on)
    _note(rows, event, head, at, "uncertain", source, "", event.on, event.places, event.why)


def on_removed(rows: RowChanges, event: b.LabwareRemoved, head: Envelope, at: float) -> None:
    """A plate leaves together with its lid; a lid that may be elsewhere stays uncertain."""
    row = rows.change(LABWARE, event.labware)
    source = row["station"]
    lid = rows.change(LABWARE, row["lid"])
    if lid["maybe"] is not None:
        _take_off_plate(rows, lid)
    else:
        _leave(rows, lid, event.why, head, at)
    _leave(rows, row, event.why, head, at)
    _note(rows, event, head, at, "removed", source or event.where, "", why=event.why)


def on_changed(rows: RowChanges, event: b.LabwareChanged, head: Envelope, at: float) -> None:
    row = rows.change(LABWARE, event.labware)
    row["variables"] = {**row["variables"], event.variable: event.value}


def on_handed_over(rows: RowChanges, event: b.LabwareHandedOver, head: Envelope, at: float) -> None:
    row = rows.update(LABWARE, event.labware, owner=event.owner)
    rows.update(LABWARE, row["lid"], owner=event.owner)


def on_barcode_read(rows: RowChanges, event: b.BarcodeRead, head: Envelope, at: float) -> None:
    rows.update(LABWARE, event.labware, barcode=event.barcode)


def on_loaded(rows: RowChanges, event: b.StationLoaded, head: Envelope, at: float) -> None:
    if event.lot:
        module = module_of(event.station)
        rows.add(LOT_USES, head.position, 0, at, event.lot, "loaded", module, event.type, "", "", "")


def on_calibrated(rows: RowChanges, event: ModuleCalibrated, head: Envelope, at: float) -> None:
    rows.put(
        CALIBRATIONS,
        event,
        calibration=f"{event.module}@{head.position}",
        position=head.position,
        recorded_by=event.by,
        at_s=at,
        ends_at_s=float(end_of(event.until)) if event.until else None,
    )


def _settle(rows: RowChanges, row: Row, station: str, on: str) -> None:
    _take_off_plate(rows, row)
    row["maybe"] = None
    if on:
        row["station"] = ""
        _lay_on(rows, row, on)
    else:
        row["station"] = station


def _lay_on(rows: RowChanges, lid: Row, plate: str) -> None:
    _take_off_plate(rows, lid)
    lid["lies_on"] = plate
    rows.update(LABWARE, plate, lid=lid["labware"])


def _take_off_plate(rows: RowChanges, lid: Row) -> None:
    rows.update(LABWARE, lid["lies_on"], lid="")
    lid["lies_on"] = ""


def _leave(rows: RowChanges, row: Row, why: str, head: Envelope, at: float) -> None:
    _take_off_plate(rows, row)
    row["station"], row["maybe"] = "", None
    row["gone_at_s"], row["gone"], row["gone_position"] = at, why, head.position


def _note(
    rows: RowChanges,
    event: b.LabwareEvent,
    head: Envelope,
    at: float,
    kind: str,
    source: str,
    target: str,
    on: str = "",
    places: Sequence[str] | None = None,
    why: str = "",
) -> None:
    by = (event.run, getattr(event, "action", ""), head.actor, why)
    maybe = None if places is None else list(places)
    rows.add(MOVES, head.position, at, event.labware, kind, source, "" if on else target, on, maybe, *by)


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
