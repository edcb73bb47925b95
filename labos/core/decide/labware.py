"""What a person says of labware: which samples are in it."""

from __future__ import annotations

import msgspec

from labos.core.bench import Sample, SamplesRegistered
from labos.core.decide._base import Command, Decision, Rejection, decides, fitting
from labos.core.ids import LabwareId
from labos.core.registry import Event
from labos.core.state import LabState


class PlateSamples(msgspec.Struct, frozen=True):
    """The samples of one plate; those of a large plate are in ``blob``, not in ``wells``."""

    labware: LabwareId
    count: int
    wells: tuple[Sample, ...] = ()
    blob: str = ""


class RegisterSamples(Command, frozen=True):
    """Say what the wells of plates hold, by a sheet (the digest of its bytes). All of it or
    nothing."""

    sheet: str
    plates: tuple[PlateSamples, ...]
    replace: bool = False


@decides(RegisterSamples)
def register_samples(state: LabState, command: RegisterSamples) -> Decision:
    events: list[Event] = []
    for plate in command.plates:
        labware = state.bench.labware.get(plate.labware)
        if labware is None:
            return Rejection("no_labware", f"No labware {plate.labware} stands on the bench.")
        if labware.samples == command.sheet:
            continue
        if labware.samples and not command.replace:
            return Rejection(
                "samples_known",
                f"The samples of {plate.labware} are known from another sheet.",
                f"Look at them with `labos samples show {plate.labware}`; replace them with --replace.",
            )
        events.append(
            SamplesRegistered(plate.labware, "", command.sheet, plate.count, plate.wells, plate.blob)
        )
    return fitting(events)
