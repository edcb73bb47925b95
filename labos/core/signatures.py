"""Electronic signatures: a user signs the record of a run, an experiment or a campaign that has ended."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Literal, get_args

from labos.core.ids import RunId
from labos.core.merkle import hash_leaf
from labos.core.registry import Event, event
from labos.core.words import Words

Meaning = Literal["authored", "responsible", "reviewed", "approved", "rejected"]
MEANINGS: tuple[Meaning, ...] = get_args(Meaning)

STREAM = "signatures"
"""The stream of all signatures: the stream of a run ends with the run."""

Kind = Literal["experiment", "campaign"]


@event("run.signed")
class RunSigned(Event, frozen=True):
    """A user has signed the record of an ended run, after confirming their identity (``method``:
    ``password``). The signature covers all records of the run's stream; ``records`` is their number.
    ``digest`` is the SHA-256 over their leaf hashes (RFC 6962), in order. ``meaning``: authored, responsible,
    reviewed, approved or rejected."""

    run: RunId
    by: str
    meaning: str
    records: int
    digest: str
    method: str
    why: Words = ""

    def stream(self) -> str:
        return STREAM


@event("records.signed")
class RecordsSigned(Event, frozen=True):
    """A user has signed the records of an ended experiment or campaign (``kind``), after confirming their
    identity (``method``: ``password``). The signature covers all records of its own stream and of the streams
    of its runs; ``records`` and ``runs`` are their numbers. ``digest`` is the SHA-256 over the records' leaf
    hashes (RFC 6962), in the order of the log. ``meaning``: authored, responsible, reviewed, approved or
    rejected."""

    subject: str
    kind: Kind
    by: str
    meaning: str
    runs: int
    records: int
    digest: str
    method: str
    why: Words = ""

    def stream(self) -> str:
        return STREAM


def make_digest_of_records(envelopes: Iterable[bytes]) -> str:
    """The digest to which a signature is bound: records by their envelopes, in the order of the log."""
    return hashlib.sha256(b"".join(map(hash_leaf, envelopes))).hexdigest()
