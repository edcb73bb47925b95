"""Signatures for runs, experiments and campaigns: which records were signed, and whether these are
unchanged."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import msgspec

from labos.core.campaigns import CampaignCompleted, CampaignSubmitted
from labos.core.envelope import Record
from labos.core.experiments import ExperimentEnded, ExperimentStarted
from labos.core.registry import decode
from labos.core.runs import RUN_ENDS, RunSubmitted
from labos.core.signatures import RecordsSigned, RunSigned, make_digest_of_records
from labos.core.structs import make_from
from labos.errors import NotFound, Refused
from labos.ports import LogQuery
from labos.services.log import Log
from labos.services.times import iso_time
from labos.services.verification import VerifiedPart

Kind = Literal["run", "experiment", "campaign"]
BEGINS: dict[str, Kind] = {
    RunSubmitted.TYPE: "run",
    ExperimentStarted.TYPE: "experiment",
    CampaignSubmitted.TYPE: "campaign",
}
"""The first event of each kind of stream that can be signed."""
ENDS: dict[Kind, frozenset[str]] = {
    "run": frozenset(RUN_ENDS),
    "experiment": frozenset({ExperimentEnded.TYPE}),
    "campaign": frozenset({CampaignCompleted.TYPE}),
}
LISTS: dict[Kind, str] = {
    "run": "List them: labos runs --all",
    "experiment": "List them: labos experiments --all",
    "campaign": "List them: labos campaign list --all",
}
AT_ONCE = 500
"""The number of streams in one query to the database."""
SIGNED = (RunSigned.TYPE, RecordsSigned.TYPE)


class Signature(msgspec.Struct, frozen=True):
    """One signature for the record of a run, an experiment or a campaign (``kind``), the ``subject``. For a
    run, ``run`` is the same id, else empty; ``runs`` is the number of runs that belong to it. ``records`` and
    ``digest`` are the number and the digest of the signed records; ``holds``: the record is still the same.
    ``at`` is the time in UTC ns, and ``time`` is the same time as text."""

    subject: str
    kind: Kind
    run: str
    by: str
    meaning: str
    why: str
    method: str
    at: int
    time: str
    position: int
    runs: int
    records: int
    digest: str
    holds: bool


class Signed(msgspec.Struct, frozen=True):
    """The content of a signature: the records of a run's own stream; for an experiment or a campaign, the
    records of its stream and of the streams of all its ``runs``. Their number and their digest."""

    kind: Kind
    runs: int
    records: int
    digest: str


def record_of(log: Log, subject: str, kind: Kind) -> Signed:
    """The record of a run, experiment or campaign that has ended. Raises NotFound, Refused."""
    records = list(log.select(LogQuery(streams=(subject,))))
    if find_kind_in(records) != kind:
        raise NotFound(f"There is no {kind} {subject!r}.", remedy=LISTS[kind])
    if ENDS[kind].isdisjoint(record.head.type for record in records):
        raise Refused(
            f"The {kind} {subject} has not ended: its record is not complete.",
            remedy=f"Wait for its end: labos {'campaign show' if kind == 'campaign' else 'runs'} {subject}",
        )
    return _digest_subject(log, subject, kind)


def list_runs(log: Log, subject: str, upto: int | None = None) -> tuple[str, ...]:
    """The runs of an experiment or a campaign that were submitted up to a position, in the order of the
    log."""
    submitted = log.select(LogQuery(types=(RunSubmitted.TYPE,), correlation=subject, upto=upto))
    return tuple(record.head.stream for record in submitted if record.head.stream != subject)


def find_kind(log: Log, subject: str) -> Kind:
    """The kind of the record that this name stands for. Raises NotFound."""
    found = find_kind_in(log.select(LogQuery(streams=(subject,))))
    if found is None:
        raise NotFound(
            f"There is no run, experiment or campaign {subject!r}.", remedy="List runs: labos runs --all"
        )
    return found


def list_signatures(log: Log, subject: str = "") -> list[Signature]:
    """The signatures for a run, an experiment or a campaign, or all signatures, in the order of the log."""
    found: list[Signature] = []
    known: dict[str, Signed] = {}
    for record in log.select(LogQuery(types=SIGNED)):
        head = record.head
        event = decode(head.type, head.schema, record.payload)
        kind: Kind
        if isinstance(event, RecordsSigned):
            name, kind, runs = event.subject, event.kind, event.runs
        else:
            assert isinstance(event, RunSigned)
            name, kind, runs = event.run, "run", 0
        if subject not in ("", name):
            continue
        if name not in known:
            known[name] = _digest_subject(log, name, kind)
        signature = make_from(
            Signature,
            event,
            subject=name,
            kind=kind,
            run=name if kind == "run" else "",
            at=head.recorded_at,
            time=iso_time(head.recorded_at),
            position=head.position,
            runs=runs,
            holds=known[name] == Signed(kind, runs, event.records, event.digest),
        )
        found.append(signature)
    return found


def check_signatures(log: Log) -> VerifiedPart:
    """Whether the signed records of each signature are unchanged."""
    found = list_signatures(log)
    broken = [
        (
            f"Position {each.position}: {each.by} signed {each.records} records of {each.subject}, but "
            "these records have changed.",
            each.position,
        )
        for each in found
        if not each.holds
    ]
    result = f"{len(found)} signatures match their records."
    return VerifiedPart.sum_up("signatures", len(found), result, broken)


def _digest_subject(log: Log, subject: str, kind: Kind) -> Signed:
    runs = () if kind == "run" else list_runs(log, subject)
    envelopes = [record.envelope for record in _read_records(log, (subject, *runs))]
    return Signed(kind, len(runs), len(envelopes), make_digest_of_records(envelopes))


def _read_records(log: Log, streams: tuple[str, ...]) -> list[Record]:
    """All records of these streams, in the order of the log."""
    found = [
        record
        for at in range(0, len(streams), AT_ONCE)
        for record in log.select(LogQuery(streams=streams[at : at + AT_ONCE]))
    ]
    return sorted(found, key=lambda record: record.head.position)


def find_kind_in(stream: Iterable[Record]) -> Kind | None:
    """The kind of a stream, by its first event."""
    return next((BEGINS[record.head.type] for record in stream if record.head.type in BEGINS), None)
