"""The kernel's two views of the log: the events on disk, and the events it has just decided.

Events are folded into the state as soon as they are decided (*speculation*); replies, requests to nodes and
publications wait until the store confirms that the events are on disk.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.clock import Clock, Ids
from labos.core.canonical import digest
from labos.core.envelope import GENESIS, Envelope, Record, seal
from labos.core.fold import evolve, fold_rows
from labos.core.registry import Event, decode, encode
from labos.core.state import LabState, encode_picture, fold_fingerprint, from_picture
from labos.errors import LogDamaged
from labos.ports import EventStore, Head


class Entry(msgspec.Struct, frozen=True):
    """An event and its record in the log, which may not be written yet."""

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

    def write(self, decided: Event, actor: str, causation: str = "") -> Entry:
        """Fold an event and seal it after the last one. The caller passes the record on to the writer."""
        state = self.state
        payload = encode(decided)
        # Fold the event in its stored form, because later readings fold that form.
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
            correlation=find_correlation(state, event),
            causation=causation,
            digest=digest(payload),
        )
        record = seal(self.head.hash, envelope, payload)
        evolve(state, event, position, recorded_at)
        self.head = Head(self.head.lab, position, record.hash, self.head.epoch, recorded_at)
        return Entry(record, event)


def find_correlation(state: LabState, event: Event) -> str:
    """The experiment or campaign of the run an event belongs to, else the run, else the experiment or
    campaign."""
    name = getattr(event, "run", "")
    run = state.runs.get(name) if name else None
    if run is not None:
        return run.experiment or run.campaign or name
    return getattr(event, "experiment", "") or getattr(event, "campaign", "") or name


def load(
    store: EventStore, *, snapshots: bool = True, begin: LabState | None = None, end: Head | None = None
) -> tuple[LabState, int]:
    """Fold the log: after ``begin`` if that has folded any events, else after the newest usable snapshot.
    Returns the state and the number of folded events. Each record is checked against the chain before it is
    folded, and with ``end``, the head row, that the log ends there. Raises LogTooNew, LogDamaged."""
    state = begin if begin is not None else LabState()
    hash_ = b""
    if snapshots and not state.position:
        found = store.load_snapshot(fold_fingerprint())
        if found is not None:
            state, hash_ = from_picture(found[2]), found[1]
    before = state.position
    try:
        fold_rows(state, store.replay(before, before=hash_, end=end))
    except (msgspec.MsgspecError, TypeError, LookupError, ValueError, AttributeError) as error:
        position = state.position + 1
        raise LogDamaged(
            f"The record at position {position} is as it was recorded, but contradicts the log ({error!r}).",
            position=position,
            remedy="Keep this database as it is; this is a fault of LabOS.",
        ) from error
    if end is not None and state.lab.epoch > end.epoch:
        raise LogDamaged(
            f"The log holds a kernel of epoch {state.lab.epoch}, but its head row says {end.epoch}.",
            position=state.position,
            remedy="Keep this database as it is, and restore the log from a backup.",
        )
    return state, state.position - before


def fold(state: LabState, records: Iterable[Record]) -> None:
    """Fold stored records into a state."""
    for record in records:
        head = record.head
        event = decode(head.type, head.schema, record.payload)
        evolve(state, event, head.position, head.recorded_at)


def find_hash(store: EventStore, position: int) -> bytes:
    """The hash of the log's record at a position; empty if the log is shorter."""
    if not position:
        return GENESIS
    found = next(iter(store.read(position - 1, position)), None)
    return found.hash if found is not None else b""


def snapshot(state: LabState, head: Head) -> tuple[int, bytes, str, bytes]:
    """The arguments of ``EventStore.save_snapshot`` for a state at the end of the log."""
    return head.position, head.hash, fold_fingerprint(), encode_picture(state)
