"""Sample sheets: from the text of a sheet to the events about plates."""

from __future__ import annotations

import asyncio

import msgspec

from labos.core.bench import Labware
from labos.core.canonical import encode_canonical
from labos.core.decide.labware import PlateSamples, RegisterSamples
from labos.core.ids import LabwareId, local
from labos.errors import BadInput, Refused
from labos.http.bodies import SampleSheet
from labos.http.service import LabService
from labos.spec import SpecErrors
from labos.spec.findings import FindingList
from labos.spec.sheet import MOST_FAULTS, SheetLine, check_wells, read_sheet

LARGEST_INLINE = 16 * 1024
"""The largest number of bytes of samples in an event; more of them are stored as a blob."""


async def register_samples(service: LabService, sheet: SampleSheet, by: str) -> dict[str, int]:
    """Register the samples in the wells of plates, all of them or none; returns the number of samples in each
    plate. Raises SpecErrors with the sheet's lines, BadInput, Refused, NotFound."""
    service.expect_role(by, "submitter")
    report = FindingList(sheet.name)
    rows = await service.run_beside(len(sheet.text), read_sheet, sheet.text, report)
    only = _find_plate(service, sheet.labware, sheet.station)
    plates = _sort_by_plate(service, rows, only, report)
    for plate, lines in plates.items():
        item = service.kernel.state.bench.labware[plate]
        kind = service.find_labware_kind(item)
        if kind is not None:  # nothing can be checked for a type without a description
            await service.run_beside(0, check_wells, lines, item.type, kind.wells, report)
    if not rows and not report.errors:
        report.error("The sheet has no rows.", remedy="Write one for each sample.")
    if report.errors:
        raise SpecErrors(report.sort_findings())
    blobs = service.parts.blobs
    # Stored before an event names them.
    kept = await asyncio.to_thread(blobs.put, sheet.text.encode())
    packed = [await asyncio.to_thread(_pack, service, plate, lines) for plate, lines in plates.items()]
    await service.kernel.execute(RegisterSamples(kept, tuple(packed), sheet.replace), by)
    return {str(plate.labware): plate.count for plate in packed}


def _find_plate(service: LabService, labware: str, station: str) -> Labware | None:
    if labware and station:
        raise BadInput("A plate and a station were named.", remedy="Name only one of them.")
    if labware:
        return service.labware(labware)
    if not station:
        return None
    name = service.station(station)
    standing = service.kernel.state.bench.stations[name].labware
    if len(standing) != 1:
        what = f"{len(standing)} pieces of labware stand" if standing else "No labware with a name stands"
        raise Refused(f"{what} at {local(name)}.", remedy="Name the plate: see labos labware --here")
    return service.kernel.state.bench.labware[standing[0]]


def _sort_by_plate(
    service: LabService, rows: list[SheetLine], only: Labware | None, report: FindingList
) -> dict[LabwareId, list[SheetLine]]:
    """The rows of each plate; a row that names no plate of this lab is added to the report."""
    found: dict[LabwareId, list[SheetLine]] = {}
    named: dict[str, Labware | BadInput] = {}
    for row in rows:
        if report.errors >= MOST_FAULTS:
            break
        plate = only
        if row.plate:
            answer = named.get(row.plate) or named.setdefault(row.plate, _find_labware(service, row.plate))
            if isinstance(answer, BadInput):
                report.error(answer.message, row.plate_at, field="plate", remedy=answer.remedy)
                continue
            plate = answer
        if plate is None:
            remedy = "Add a column 'plate', or name the plate beside the sheet."
            report.error("The plate is missing.", row.at, field="plate", remedy=remedy)
        elif only is not None and plate.id != only.id:
            remedy = "Leave its rows out, or name no plate with the sheet."
            report.error(f"This is {plate.id}, not {only.id}.", row.plate_at, field="plate", remedy=remedy)
        else:
            found.setdefault(plate.id, []).append(row)
    return found


def _find_labware(service: LabService, name: str) -> Labware | BadInput:
    try:
        return service.labware(name)
    except BadInput as error:
        return error


def _pack(service: LabService, plate: LabwareId, rows: list[SheetLine]) -> PlateSamples:
    wells = tuple(row.sample for row in rows)
    data = encode_canonical(msgspec.to_builtins(wells))
    if len(data) <= LARGEST_INLINE:
        return PlateSamples(plate, len(wells), wells)
    return PlateSamples(plate, len(wells), blob=service.parts.blobs.put(data))
