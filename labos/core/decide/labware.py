"""A person reports data of labware: the samples in it, or its barcode."""

from __future__ import annotations

import msgspec

from labos.core.bench import Labware
from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.barcodes import LONGEST_BARCODE, find_barcode
from labos.core.decide.lookups import decides_about, expect_labware
from labos.core.ids import LabwareId
from labos.core.labware import BarcodeRead, Sample, SamplesRegistered
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.structs import make_from


class PlateSamples(msgspec.Struct, frozen=True):
    """The samples of one plate; those of a large plate are in ``blob``, not in ``wells``."""

    labware: LabwareId
    count: int
    wells: tuple[Sample, ...] = ()
    blob: str = ""


class RegisterSamples(Command, frozen=True):
    """Register the contents of the wells of plates from a sample sheet. ``sheet`` is the digest of its bytes.
    All plates are registered, or none."""

    sheet: str
    plates: tuple[PlateSamples, ...]
    replace: bool = False


@decides(RegisterSamples)
def register_samples(state: LabState, command: RegisterSamples) -> Decision:
    events: list[Event] = []
    for plate in command.plates:
        labware = expect_labware(state, plate)
        if isinstance(labware, Rejection):
            return labware
        if labware.samples == command.sheet:
            continue
        if labware.samples and not command.replace:
            return Rejection(
                "samples_known",
                f"The samples of {plate.labware} were registered from another sheet.",
                f"Show them with `labos samples show {plate.labware}`; replace them with --replace.",
            )
        events.append(make_from(SamplesRegistered, plate, run="", sheet=command.sheet))
    return events


class NameBarcode(Command, frozen=True):
    """Report the barcode of labware."""

    labware: LabwareId
    barcode: str
    by: str
    replace: bool = False


@decides_about(NameBarcode, expect_labware)
def name_barcode(state: LabState, command: NameBarcode, labware: Labware) -> Decision:
    code = find_barcode(command.barcode)
    if not code:
        return Rejection(
            "bad_barcode",
            f"{command.barcode[:60]!r} is not a barcode.",
            f"A barcode has 1 to {LONGEST_BARCODE} printable characters.",
        )
    holder = state.bench.barcodes.get(code)
    if holder == labware.id:
        return []
    if holder is not None:
        return Rejection("barcode_taken", f"{holder} already has the barcode {code}.", "Check both labels.")
    if labware.barcode and not command.replace:
        return Rejection(
            "barcode_known",
            f"{labware.id} already has the barcode {labware.barcode}.",
            "If its label was replaced, add --replace.",
        )
    return [BarcodeRead(labware.id, "", code, command.by)]
