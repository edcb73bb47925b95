"""The kernel's two views of the log: what is written for good, and what it has just decided.

Events are folded into the state as soon as they are decided (*speculation*); replies, requests
to nodes and publications wait until the store says that they are on disk.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from labos.clock import Clock, Ids
from labos.core.canonical import digest
from labos.core.envelope import Envelope, Record, seal
from labos.core.fold import evolve
from labos.core.ids import RunId
from labos.core.registry import Event, decode, encode
from labos.core.state import LabState, fold_fingerprint, from_picture, picture
from labos.ports import EventStore, Head


class Entry(msgspec.Struct, frozen=True):
    """An event and the record that will stand, or stands, for it."""

    record: Record
    event: Event

    @property
    def position(self) -> int:
        return self.record.head.position


class Ledger:
    """Folds and seals events at the speculative end of the log."""

    def __init__(self, state: LabState, head: Head, clock: Clock, ids: Ids) -> None:
        self.state, self.head = state, head
        self._clock, self._ids = clock, ids

    def write(self, events: Sequence[Event], actor: str, causation: str = "") -> list[Entry]:
        """Fold events and seal them behind one another. The first is caused by ``causation``,
        the others by the first. The caller passes the records on to the writer."""
        entries: list[Entry] = []
        state = self.state
        for decided in events:
            payload = encode(decided)
            # What is folded now must be what will be folded again: the event as it is stored.
            event = decode(decided.TYPE, decided.SCHEMA, payload)
            stream = event.stream()
            position = self.head.position + 1
            recorded_at = max(self._clock.now_ns(), state.recorded_at)
            envelope = Envelope(
                lab=self.head.lab,
                position=position,
                id=self._ids.new(),
                stream=stream,
                version=state.versions.get(stream, 0) + 1,
                type=event.TYPE,
                schema=event.SCHEMA,
                recorded_at=recorded_at,
                actor=actor,
                correlation=correlation(state, event),
                causation=entries[0].record.head.id if entries else causation,
                digest=digest(payload),
            )
            record = seal(self.head.hash, envelope, payload)
            evolve(state, event, position, recorded_at)
            self.head = Head(self.head.lab, position, record.hash, self.head.epoch, recorded_at)
            entries.append(Entry(record, event))
        return entries


def correlation(state: LabState, event: Event) -> str:
    """The experiment of the run an event belongs to, else the run, else the experiment."""
    name = getattr(event, "run", "")
    if name:
        run = state.runs.get(name)
        experiment = run.experiment if run is not None else getattr(event, "experiment", "")
        return experiment or name
    return str(getattr(event, "experiment", ""))


def load(store: EventStore, *, snapshots: bool = True, begin: LabState | None = None) -> tuple[LabState, int]:
    """Fold the log, on from ``begin`` if that has come anywhere, else from its newest usable snapshot;
    returns the state and how many events were folded. Raises LogTooNew, LogDamaged."""
    state = begin if begin is not None else LabState()
    if snapshots and not state.position:
        found = store.load_snapshot(fold_fingerprint())
        if found is not None:
            state = from_picture(found[2])
    before = state.position
    replay = getattr(store, "replay", None)
    if replay is None:
        fold(state, store.read(after=before))
    else:  # the same records as plain tuples: see LogReader.replay
        for position, kind, schema, recorded_at, payload in replay(after=before):
            evolve(state, decode(kind, schema, payload), position, recorded_at)
    return state, state.position - before


def fold(state: LabState, records: Iterable[Record]) -> None:
    """Fold stored records into a state."""
    for record in records:
        head = record.head
        event = decode(head.type, head.schema, record.payload)
        evolve(state, event, head.position, head.recorded_at)


def snapshot(state: LabState, head: Head) -> tuple[int, bytes, str, bytes]:
    """The arguments of ``EventStore.save_snapshot`` for a state at the end of the log."""
    return head.position, head.hash, fold_fingerprint(), picture(state)


def run_of(event: Event) -> RunId:
    """The run an event belongs to, empty if none."""
    return RunId(str(getattr(event, "run", "")))
