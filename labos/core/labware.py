"""What can happen to labware and to the stations where it stands: the events of the bench."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.ids import LabwareId, ModuleName, Owner, RunId, StationName
from labos.core.registry import Event, event
from labos.core.words import Words


class LabwareEvent(Event, frozen=True):
    """``run`` is the run in whose course it happened, if any."""

    labware: LabwareId
    run: str

    def stream(self) -> str:
        return self.run or self.labware


@event("station.declared")
class StationDeclared(Event, frozen=True):
    """A person says what stands at a station: labware types, bottom to top. Items of a stack
    stay nameless until they are taken."""

    station: StationName
    contents: tuple[str, ...]

    def stream(self) -> str:
        return self.station


@event("station.emptied")
class WasteEmptied(Event, frozen=True):
    """Somebody emptied a waste: there is room in it again for as much as it holds. Not written any
    more: what is taken out of a waste is unloaded."""

    station: StationName

    def stream(self) -> str:
        return self.station


@event("station.loaded")
class StationLoaded(Event, frozen=True):
    """A person put labware of a lot on top of a stack; it stays nameless until it is taken.
    ``awaited`` are the runs that could not go on without it."""

    station: StationName
    type: str
    count: int
    lot: str = ""
    awaited: tuple[RunId, ...] = ()

    def stream(self) -> str:
        return self.station


@event("station.unloaded")
class StationUnloaded(Event, frozen=True):
    """A person took nameless labware away: from the top of a stack, or out of a waste. ``awaited`` are
    the runs that could not go on before there was room."""

    station: StationName
    count: int
    awaited: tuple[RunId, ...] = ()

    def stream(self) -> str:
        return self.station


@event("station.observed")
class StationObserved(Event, frozen=True):
    """A sensor or a person looked at a station. ``count`` is how many pieces stand there (0: it is
    empty; null: at least one), ``labware`` and ``type`` what was recognised; ``by`` is the module or
    the person that looked. What follows from it stands behind it as events of its own."""

    station: StationName
    by: str
    count: int | None = None
    labware: LabwareId = LabwareId("")
    type: str = ""

    def stream(self) -> str:
        return self.station


@event("labware.placed")
class LabwarePlaced(LabwareEvent, frozen=True):
    """Labware gets its name: taken from a stack (``stack``) or put on the bench by a person, who
    may say of which ``lot`` it is. A lid that came with its plate lies ``on`` it."""

    type: str
    station: StationName
    owner: Owner
    stack: StationName = StationName("")
    action: str = ""
    lot: str = ""
    on: LabwareId = LabwareId("")


@event("labware.moved")
class LabwareMoved(LabwareEvent, frozen=True):
    """From station to station; a lid off its plate, or ``on`` one. What lies on it comes along."""

    source: StationName
    target: StationName
    action: str = ""
    on: LabwareId = LabwareId("")


@event("labware.removed")
class LabwareRemoved(LabwareEvent, frozen=True):
    """It has left the bench: into waste, or carried away."""

    where: StationName
    why: str
    action: str = ""


@event("labware.uncertain")
class LabwareUncertain(LabwareEvent, frozen=True):
    """It may be at any of these places (a gripper is a place; empty string: gone). A lid may lie
    ``on`` a plate at one of them."""

    places: tuple[StationName, ...]
    why: str
    action: str = ""
    on: LabwareId = LabwareId("")


@event("labware.observed")
class LabwareObserved(LabwareEvent, frozen=True):
    """A sensor or a person saw it; ``by`` says who."""

    station: StationName
    by: str


@event("labware.changed")
class LabwareChanged(LabwareEvent, frozen=True):
    """A variable of the labware, such as ``sealed``."""

    variable: str
    value: Any
    action: str = ""


@event("labware.handed_over")
class LabwareHandedOver(LabwareEvent, frozen=True):
    """It belongs to somebody else from now on. Where a person gave it, ``by`` names them and
    ``note`` says why. ``lent``: to a run that works on it, at whose end it is again whose it was."""

    owner: Owner
    by: str = ""
    note: Words = ""
    lent: bool = False


@event("labware.barcode_read")
class BarcodeRead(LabwareEvent, frozen=True):
    """It bears this barcode, and no other labware does; ``by`` is the module that read it or the
    person who said so."""

    barcode: str
    by: str
    action: str = ""


@event("liquid.transferred")
class LiquidTransferred(LabwareEvent, frozen=True):
    """Liquid went from a well or reservoir of a module (``liquid``) into wells of the labware, one
    volume (µL) a well, of these lots. Where it is not ``certain`` the action failed half-way."""

    module: ModuleName
    liquid: str
    wells: tuple[str, ...]
    volumes_ul: tuple[float, ...]
    lots: tuple[str, ...] = ()
    certain: bool = True
    action: str = ""


@event("liquid.drawn")
class LiquidDrawn(LabwareEvent, frozen=True):
    """Liquid left wells of the labware, one volume (µL) a well. Where it is not ``certain`` the action
    failed half-way, and the wells may hold as much as before."""

    module: ModuleName
    wells: tuple[str, ...]
    volumes_ul: tuple[float, ...]
    certain: bool = True
    action: str = ""


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a well holds; ``volume_ul`` is null where nobody said."""

    well: str
    sample: str
    volume_ul: float | None = None


@event("labware.samples_registered")
class SamplesRegistered(LabwareEvent, frozen=True):
    """A sheet says which samples are in its wells; an earlier sheet counts no more. ``sheet`` is the
    digest of the sheet itself, a blob. Where there are too many wells for the log, ``wells`` is
    empty and ``blob`` names the JSON list of them."""

    sheet: str
    count: int
    wells: tuple[Sample, ...] = ()
    blob: str = ""
