"""The events of labware and of its stations."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.ids import LabwareId, ModuleName, Owner, RunId, StationName
from labos.core.registry import Event, event
from labos.core.words import Words

GONE = StationName("")
"""The place of labware that is off the bench."""


class LabwareEvent(Event, frozen=True):
    """``run`` is the run to which the event belongs, if any."""

    labware: LabwareId
    run: str

    def stream(self) -> str:
        return self.run or self.labware


class StationEvent(Event, frozen=True):
    STREAM = "station"
    station: StationName


@event("station.declared")
class StationDeclared(StationEvent, frozen=True):
    """A person reports the labware at a station: labware types, from bottom to top. Pieces of a stack have no
    id until they are taken."""

    contents: tuple[str, ...]


@event("station.emptied")
class WasteEmptied(StationEvent, frozen=True):
    """A person emptied a waste station, so all its room is free again. This event is no longer written;
    `station.unloaded` has replaced it."""


@event("station.loaded")
class StationLoaded(StationEvent, frozen=True):
    """A person put labware of a lot on top of a stack. It has no id until it is taken. ``awaited`` lists the
    runs that waited for it."""

    type: str
    count: int
    lot: str = ""
    awaited: tuple[RunId, ...] = ()


@event("station.unloaded")
class StationUnloaded(StationEvent, frozen=True):
    """A person took labware without an id away: from the top of a stack, or out of a waste station.
    ``awaited`` lists the runs that waited for room."""

    count: int
    awaited: tuple[RunId, ...] = ()


@event("station.observed")
class StationObserved(StationEvent, frozen=True):
    """A sensor or a person observed a station. ``count`` is the number of pieces that stand there (0: it is
    empty; null: at least one). ``labware`` and ``type`` say what was recognised. ``by`` is the module or the
    person that observed. The resulting changes are events after this one."""

    by: str
    count: int | None = None
    labware: LabwareId = LabwareId("")
    type: str = ""


@event("labware.placed")
class LabwarePlaced(LabwareEvent, frozen=True):
    """Labware gets its id. It was taken from a stack (``stack``), or a person put it on the bench and may
    have named its ``lot``. A lid that came with its plate lies ``on`` it."""

    type: str
    station: StationName
    owner: Owner
    stack: StationName = StationName("")
    action: str = ""
    lot: str = ""
    on: LabwareId = LabwareId("")


@event("labware.moved")
class LabwareMoved(LabwareEvent, frozen=True):
    """Labware moved from one station to another. A lid was taken off its plate, or put ``on`` a plate.
    Labware that lies on the moved labware moves with it."""

    source: StationName
    target: StationName
    action: str = ""
    on: LabwareId = LabwareId("")


@event("labware.removed")
class LabwareRemoved(LabwareEvent, frozen=True):
    """Labware has left the bench: it was discarded, or a person took it away."""

    where: StationName
    why: str
    action: str = ""


@event("labware.uncertain")
class LabwareUncertain(LabwareEvent, frozen=True):
    """Labware may be at any of these places (a gripper is a place; empty string: off the bench). A lid may
    lie ``on`` a plate at one of them."""

    places: tuple[StationName, ...]
    why: str
    action: str = ""
    on: LabwareId = LabwareId("")


@event("labware.observed")
class LabwareObserved(LabwareEvent, frozen=True):
    """A sensor or a person (``by``) saw the labware."""

    station: StationName
    by: str


@event("labware.changed")
class LabwareChanged(LabwareEvent, frozen=True):
    """A variable of the labware, such as ``sealed``, has a new value."""

    variable: str
    value: Any
    action: str = ""


@event("labware.handed_over")
class LabwareHandedOver(LabwareEvent, frozen=True):
    """Labware has a new owner. If a person gave it, ``by`` names the person and ``note`` says why. ``lent``:
    a run may use it, and it goes back to its owner when the run ends."""

    owner: Owner
    by: str = ""
    note: Words = ""
    lent: bool = False


@event("labware.barcode_read")
class BarcodeRead(LabwareEvent, frozen=True):
    """Labware has this barcode, and no other labware has it. ``by`` is the module that read it or the person
    who reported it."""

    barcode: str
    by: str
    action: str = ""


@event("liquid.transferred")
class LiquidTransferred(LabwareEvent, frozen=True):
    """Liquid went from a well or reservoir of a module (``liquid``) into wells of the labware: one volume
    (µL) per well, from these lots. If it is not ``certain``, the action failed part of the way."""

    module: ModuleName
    liquid: str
    wells: tuple[str, ...]
    volumes_ul: tuple[float, ...]
    lots: tuple[str, ...] = ()
    certain: bool = True
    action: str = ""


@event("liquid.drawn")
class LiquidDrawn(LabwareEvent, frozen=True):
    """Liquid left wells of the labware: one volume (µL) per well. If it is not ``certain``, the action failed
    part of the way, and the wells may hold as much as before."""

    module: ModuleName
    wells: tuple[str, ...]
    volumes_ul: tuple[float, ...]
    certain: bool = True
    action: str = ""


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of a well. ``volume_ul`` is null if it was not given."""

    well: str
    sample: str
    volume_ul: float | None = None


@event("labware.samples_registered")
class SamplesRegistered(LabwareEvent, frozen=True):
    """A sample sheet says which samples are in the wells of the labware. It replaces an earlier sheet.
    ``sheet`` is the digest of the sheet itself, a blob. If there are too many wells for the log, ``wells`` is
    empty and ``blob`` is the digest of their JSON list."""

    sheet: str
    count: int
    wells: tuple[Sample, ...] = ()
    blob: str = ""
