"""Signatures under runs: what they bind to, and whether that still is so."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.envelope import Record
from labos.core.registry import decode
from labos.core.runs import RUN_ENDS, RunSubmitted
from labos.core.signatures import RunSigned, digest_of_records
from labos.errors import NotFound, Refused
from labos.ports import LogQuery
from labos.services.log import Log
from labos.services.times import iso_time
from labos.services.verification import Part


class Signature(msgspec.Struct, frozen=True):
    """One signature. ``records`` and ``digest`` are what was signed; ``holds`` is whether the record of the
    run is the same now. ``at`` in UTC ns, ``time`` the same for people."""

    run: str
    by: str
    meaning: str
    why: str
    method: str
    at: int
    time: str
    position: int
    records: int
    digest: str
    holds: bool


class RunRecord(msgspec.Struct, frozen=True):
    """All records of a run's own stream: how many they are, and their digest."""

    records: int
    digest: str


def record_of(log: Log, run: str) -> RunRecord:
    """The record of a run that has ended. Raises NotFound, Refused."""
    records = list(log.select(LogQuery(streams=(run,))))
    kinds = {record.head.type for record in records}
    if RunSubmitted.TYPE not in kinds:
        raise NotFound(f"There is no run {run!r}.", remedy="List them: labos runs --all")
    if kinds.isdisjoint(RUN_ENDS):
        raise Refused(
            f"The run {run} has not ended: its record is not complete.",
            remedy=f"Wait for its end: labos runs {run}",
        )
    return _digest_of(records)


def signatures_of(log: Log, run: str = "") -> list[Signature]:
    """The signatures under a run, or under all runs, in the order of the log."""
    found: list[Signature] = []
    known: dict[str, RunRecord] = {}
    for record in log.select(LogQuery(types=(RunSigned.TYPE,))):
        event = _event_of(record)
        if run not in ("", event.run):
            continue
        if event.run not in known:
            known[event.run] = _digest_of(log.select(LogQuery(streams=(event.run,))))
        holds = known[event.run] == RunRecord(event.records, event.digest)
        at = record.head.recorded_at
        found.append(
            Signature(
                run=event.run,
                by=event.by,
                meaning=event.meaning,
                why=event.why,
                method=event.method,
                at=at,
                time=iso_time(at),
                position=record.head.position,
                records=event.records,
                digest=event.digest,
                holds=holds,
            )
        )
    return found


def signatures_under(log: Log, run: str) -> list[Signature]:
    """The signatures under a run. Raises NotFound if there never was one."""
    if next(log.select(LogQuery(streams=(run,), last=1)), None) is None:
        raise NotFound(f"There is no run {run!r}.", remedy="List them: labos runs --all")
    return signatures_of(log, run)


def check_signatures(log: Log) -> Part:
    """Whether each signature is under what was signed."""
    found = signatures_of(log)
    broken = [each for each in found if not each.holds]
    faults = tuple(
        f"Position {each.position}: {each.by} signed {each.records} records of {each.run}, and they are "
        "others now."
        for each in broken
    )
    told = f"{len(found)} signatures are under the records that were signed."
    return Part("signatures", len(found), told, faults, tuple(each.position for each in broken))


def _event_of(record: Record) -> RunSigned:
    event = decode(record.head.type, record.head.schema, record.payload)
    assert isinstance(event, RunSigned)
    return event


def _digest_of(records: Iterable[Record]) -> RunRecord:
    envelopes = [record.envelope for record in records]
    return RunRecord(len(envelopes), digest_of_records(envelopes))
