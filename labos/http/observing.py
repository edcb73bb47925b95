"""Reports of people about the bench: the content of a station, and the owner of labware."""

from __future__ import annotations

import msgspec

from labos.core.decide.handover import HandOver
from labos.core.decide.observation import ObserveStation
from labos.core.ids import SHARED, LabwareId, Owner
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.labware import LabwareObserved, LabwareRemoved, LabwareUncertain
from labos.core.registry import Event
from labos.core.topics import Choice
from labos.errors import NotFound
from labos.http.service import LabService

EMPTY = "empty"


class QuestionAsked(msgspec.Struct, frozen=True):
    id: str
    text: str
    choices: tuple[Choice, ...]


class ObservationResult(msgspec.Struct, frozen=True):
    """The consequences of an observation: labware that was ``found``, with its station; labware that is
    ``gone``; ``uncertain`` labware with its possible places; and the questions that are ``answered`` and
    ``asked``."""

    station: str
    found: dict[str, str]
    gone: list[str]
    uncertain: dict[str, tuple[str, ...]]
    answered: list[str]
    asked: list[QuestionAsked]


async def observe(service: LabService, station: str, what: str, by: str) -> ObservationResult:
    """A person saw ``what`` at a station: ``empty``, a number, labware by its id or barcode, a labware type,
    or (no words) something. Returns the consequences. Raises NotFound, Refused."""
    place = service.station(station)
    events = await service.kernel.execute(_sight(service, place, what.strip(), by), by)
    return ObservationResult(
        station=place,
        found={e.labware: e.station for e in events if isinstance(e, LabwareObserved)},
        gone=[e.labware for e in events if isinstance(e, LabwareRemoved)],
        uncertain={e.labware: e.places for e in events if isinstance(e, LabwareUncertain)},
        answered=[e.intervention for e in events if isinstance(e, InterventionResolved)],
        asked=[
            QuestionAsked(e.intervention, e.text, e.choices)
            for e in events
            if isinstance(e, InterventionRequested)
        ],
    )


def _sight(service: LabService, place: str, what: str, by: str) -> ObserveStation:
    known = service.kernel.state.bench
    seen = ObserveStation(service.station(place), by)
    if not what:
        return seen
    if what == EMPTY or what.isdecimal():
        return ObserveStation(seen.station, by, 0 if what == EMPTY else int(what))
    labware = known.barcodes.get(what, LabwareId(what))
    if labware in known.labware:
        return ObserveStation(seen.station, by, labware=labware)
    types = service.list_labware_types()
    if what in types:
        return ObserveStation(seen.station, by, kind=what)
    raise NotFound(
        f"{what!r} is neither labware on the bench nor a labware type.",
        remedy=f"Give empty, a number, an id such as P7, a barcode, or one of {', '.join(types)}.",
    )


async def give(
    service: LabService, labware: str, to: str, by: str, *, force: bool = False, note: str = ""
) -> list[Event]:
    """Give labware to another owner: ``user:NAME``, ``experiment:E3`` or ``shared``. Raises NotFound,
    Refused."""
    item = service.labware(labware)
    heir = SHARED if to == SHARED else Owner(to)
    return await service.kernel.execute(HandOver(item.id, heir, by, force, note), by)
