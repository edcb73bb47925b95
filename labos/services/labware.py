"""The history of a piece of labware: its places and their times, its owners, and who moved it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from labos.core import labware as b
from labos.core.actions import ActionRequested
from labos.core.envelope import Record
from labos.core.ids import local
from labos.ports import LogQuery
from labos.services.catalogue import Catalogue, read_catalogue
from labos.services.describe import owner_name
from labos.services.log import Log, decode_event


class RecordReference(msgspec.Struct, frozen=True):
    """The position of a record in the log, and its hash."""

    position: int
    hash: str


class LabwareStay(msgspec.Struct):
    """The stay at one place from ``since`` to ``until`` (UTC ns; 0 while it lasts). ``places`` has several
    entries if the place is uncertain, and none if the labware is gone. ``by`` is the cause of the move."""

    places: tuple[str, ...]
    since: int
    by: str
    proof: RecordReference
    until: int = 0
    note: str = ""


class LabwareChange(msgspec.Struct, frozen=True):
    """Another change: of its owner or of a variable."""

    at: int
    what: str
    value: Any
    by: str
    proof: RecordReference


class LabwareHistory(msgspec.Struct):
    """All facts of the log about one piece of labware."""

    id: str
    type: str
    stays: list[LabwareStay] = []
    changes: list[LabwareChange] = []
    owner: str = ""
    variables: dict[str, Any] = {}
    barcode: str = ""
    gone: str = ""

    @property
    def place(self) -> str:
        """Its present place, in words."""
        if self.gone:
            return f"gone: {self.gone}"
        names = [local(place) or "gone" for place in self.stays[-1].places]
        return names[0] if len(names) == 1 else "not known: " + " or ".join(names)


def read_labware_history(log: Log, labware: str, upto: int | None = None) -> LabwareHistory | None:
    """One labware's history up to a position; None if the log does not name it before."""
    query = LogQuery(types=(*_KINDS, ActionRequested.TYPE), mentions=labware, upto=upto)
    return fold_histories(log.select(query), read_catalogue(log, upto)).get(labware)


def list_labware_histories(log: Log, upto: int | None = None) -> dict[str, LabwareHistory]:
    """All labware of the log, in order of its first placement."""
    query = LogQuery(types=(*_KINDS, ActionRequested.TYPE), upto=upto)
    return fold_histories(log.select(query), read_catalogue(log, upto))


def fold_histories(records: Iterable[Record], names: Catalogue) -> dict[str, LabwareHistory]:
    """The histories that follow from records; ``names`` gives runs and steps their names."""
    histories: dict[str, LabwareHistory] = {}
    acts: dict[str, str] = {}
    for record in records:
        event = decode_event(record)
        if isinstance(event, ActionRequested):
            acts[event.action] = _act(event, names)
        elif isinstance(event, b.LabwareEvent):
            if isinstance(event, b.LabwarePlaced):
                histories[event.labware] = LabwareHistory(event.labware, event.type)
            if isinstance(event, b.BarcodeRead):
                _take_away(histories, event)
            story = histories.get(event.labware)
            if story is not None:
                _add(story, event, record, _find_actor(event, record, acts, names))
    return histories


def _add(story: LabwareHistory, event: b.LabwareEvent, record: Record, by: str) -> None:
    at = record.head.recorded_at
    proof = RecordReference(record.head.position, record.hash.hex())

    def stand(places: tuple[str, ...], note: str) -> None:
        if story.stays:
            story.stays[-1].until = at
        story.stays.append(LabwareStay(places, at, by, proof, note=note))

    def change(what: str, value: Any) -> None:
        story.changes.append(LabwareChange(at, what, value, by, proof))

    match event:
        case b.LabwarePlaced():
            origin = f"from the stack {local(event.stack)}" if event.stack else "placed on the bench"
            stand((event.station,), origin)
            story.owner = event.owner
            change("owner", owner_name(event.owner))
        case b.LabwareMoved():
            stand((event.target,), "")
        case b.LabwareObserved():
            stand((event.station,), f"observed by {event.by}")
        case b.LabwareUncertain():
            stand(event.places, event.why)
        case b.LabwareRemoved():
            where = f" at {local(event.where)}" if event.where else ""
            story.gone = f"{event.why}{where}"
            stand((), story.gone)
        case b.LabwareChanged():
            story.variables[event.variable] = event.value
            change(event.variable, event.value)
        case b.BarcodeRead():
            if event.barcode != story.barcode:
                change("barcode", event.barcode)
            story.barcode = event.barcode
        case b.SamplesRegistered():
            change("samples", event.count)
        case b.LabwareHandedOver():
            story.owner = event.owner
            change("owner", owner_name(event.owner))


def _take_away(histories: dict[str, LabwareHistory], event: b.BarcodeRead) -> None:
    """A barcode is on one piece of labware at a time; labware that is gone keeps its own."""
    for story in histories.values():
        if story.barcode == event.barcode and story.id != event.labware and not story.gone:
            story.barcode = ""


def _act(event: ActionRequested, names: Catalogue) -> str:
    step = names.find_step(event.run, event.step)
    key = f", {event.run} #{event.step} {step.key!r}" if step is not None else f", {event.run}"
    return f"{local(event.module)}.{event.name}{key if event.run else ''}"


def _find_actor(event: b.LabwareEvent, record: Record, acts: dict[str, str], names: Catalogue) -> str:
    """The name of the actor: the action that moved it, else the run, else the event's actor; with the
    user."""
    run = names.runs.get(event.run)
    user = f" ({run.user})" if run is not None else ""
    act = acts.get(str(getattr(event, "action", "")))
    if act:
        return f"{act}{user}"
    return f"{event.run}{user}" if event.run else local(record.head.actor)


_KINDS = ("labware",)
