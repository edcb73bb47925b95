"""Which samples are in which wells, according to sample sheets."""

from __future__ import annotations

import msgspec

from labos.core.labware import Sample, SamplesRegistered
from labos.core.wells import well_key
from labos.errors import LogDamaged
from labos.ports import BlobReader, LogQuery
from labos.services.log import Log, decode_events


class Registration(msgspec.Struct, frozen=True):
    """The content of one sheet for one plate; ``position`` is its position in the log."""

    labware: str
    sheet: str
    position: int
    at: int
    by: str
    samples: tuple[Sample, ...]
    """In the order of the plate: A1, A2, A10, B1."""


def list_registrations(
    log: Log, blobs: BlobReader, labware: str, upto: int | None = None
) -> list[Registration]:
    """The sheets of a plate, in order; the last one is valid. Raises NotFound and LogDamaged for a blob that
    is missing or changed."""
    query = LogQuery(types=(SamplesRegistered.TYPE,), mentions=labware, upto=upto)
    found: list[Registration] = []
    for event, head in decode_events(log.select(query)):
        if isinstance(event, SamplesRegistered) and event.labware == labware:
            samples = event.wells or _unpack(blobs, event.blob, head.position)
            wells = tuple(sorted(samples, key=lambda sample: well_key(sample.well)))
            found.append(
                Registration(event.labware, event.sheet, head.position, head.recorded_at, head.actor, wells)
            )
    return found


def _unpack(blobs: BlobReader, blob: str, position: int) -> tuple[Sample, ...]:
    try:
        return msgspec.json.decode(blobs.get(blob), type=tuple[Sample, ...])
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise LogDamaged(f"The blob {blob} holds no samples ({error}).", position=position) from None
