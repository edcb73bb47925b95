"""The lines of a node's journal: ``<CRC-32> <JSON list of records>``.

A journal in an older form is read as it is: records and fields are only ever added, with a default.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import msgspec

from labos.core.effects import AnyEffect
from labos.errors import JournalDamaged
from labos.node.protocol import Outcome

FORMAT = 1

REMEDY = "Check what stands on the bench, then move the journal away; the node starts a new one."


class Record(msgspec.Struct, frozen=True, tag_field="t", omit_defaults=True):
    """A record of the node's memory."""


class Opened(Record, frozen=True, tag="journal"):
    """The first record."""

    id: str
    format: int


class Bound(Record, frozen=True, tag="lab"):
    """The node belongs to this lab."""

    lab: str


class EpochRaised(Record, frozen=True, tag="epoch"):
    epoch: int


class Restarted(Record, frozen=True, tag="restarted"):
    """The node started again; the actions that were running were interrupted."""


class Accepted(Record, frozen=True, tag="accepted"):
    """This attempt will be carried out as soon as this record is on disk. In a compacted journal, it may have
    been ``interrupted`` since. ``effects`` are its planned effects on labware; journals of earlier versions
    do not have them."""

    action: str
    attempt: int
    position: int
    name: str
    interrupted: bool = False
    effects: tuple[AnyEffect, ...] | None = None


class Handled(Record, frozen=True, tag="handle"):
    """The device's own id of the attempt."""

    action: str
    attempt: int
    handle: str


class Ended(Record, frozen=True, tag="ended"):
    action: str
    attempt: int
    outcome: Outcome


class Voided(Record, frozen=True, tag="void"):
    """No attempt of this action up to ``attempt`` may start any more."""

    action: str
    attempt: int
    position: int


class Pruned(Record, frozen=True, tag="pruned"):
    """The lab has recorded the end of everything requested up to ``position``; a kernel of ``epoch``
    acknowledged it (0: not noted). In a compacted journal, ``seen`` is the greatest position of any request
    that the node has seen, including forgotten ones."""

    position: int
    epoch: int = 0
    seen: int = 0


class Rewound(Record, frozen=True, tag="rewound"):
    """The lab's log was restored from an older copy: requests of a kernel of ``epoch`` are counted from after
    ``position``. Requests of older kernels are fenced. ``seen`` is as in ``Pruned``."""

    position: int
    epoch: int
    seen: int = 0


class TakenUp(Record, frozen=True, tag="taken_up"):
    """The device continues an interrupted action."""

    action: str
    attempt: int


class GivenUp(Record, frozen=True, tag="given_up"):
    """It cannot be found out how a running attempt ended."""

    action: str
    attempt: int
    why: str


class Withdrawn(Record, frozen=True, tag="withdrawn"):
    """An acceptance that could not be written: nothing moved, and the attempt is void."""

    action: str
    attempt: int


class Corrected(Record, frozen=True, tag="corrected"):
    """A person has corrected an epoch or an acknowledged position that no kernel of the lab can have sent.
    ``by`` is the person, ``at_ns`` the time (UTC ns), ``why`` the reason."""

    epoch: int
    position: int
    by: str
    at_ns: int
    why: str


AnyRecord = (
    Opened
    | Bound
    | EpochRaised
    | Restarted
    | Accepted
    | Handled
    | Ended
    | Voided
    | Pruned
    | Rewound
    | TakenUp
    | GivenUp
    | Withdrawn
    | Corrected
)
_encode = msgspec.json.Encoder().encode
_decode = msgspec.json.Decoder(list[AnyRecord]).decode


# -- lines -----------------------------------------------------------------------------------


def encode(record: Record) -> bytes:
    """One record, in the form of a line. Raises ValueError for text that is not Unicode."""
    return _encode(record)


def write_line(records: Iterable[bytes]) -> bytes:
    """One line of a journal, of encoded records."""
    body = b"[%b]" % b",".join(records)
    return b"%08x %b\n" % (zlib.crc32(body), body)


def read_lines(data: bytes) -> tuple[list[Record], bytes]:
    """All records, and the bytes that contain them without a torn end. Raises JournalDamaged."""
    records: list[Record] = []
    start = 0
    while start < len(data):
        newline = data.find(b"\n", start)
        line = data[start:] if newline < 0 else data[start:newline]
        body = _check_body(line)
        if body is None and newline < 0:
            # Perhaps only the newline at its end is missing, and it was already answered.
            line = line[:-1]
            body = _check_body(line)
        if body is None:
            # After a power cut, the last write may have no end, or sectors of zeros in it.
            if newline < 0 or (newline + 1 == len(data) and b"\0" in line):
                return records, data[:start]
            raise JournalDamaged(
                f"The node's journal is damaged at byte {start}, so what the device did is unknown.",
                remedy=REMEDY,
            )
        try:
            records.extend(_decode(body))
        except (msgspec.MsgspecError, RecursionError) as error:
            raise JournalDamaged(
                f"The node's journal has a record at byte {start} that this LabOS cannot read: {error}.",
                remedy="Install the LabOS that wrote it.",
            ) from error
        if newline < 0:
            return records, data[:start] + line + b"\n"
        start = newline + 1
    return records, data


def _check_body(line: bytes) -> bytes | None:
    """The line's content if its checksum is right."""
    checksum, _, body = line.partition(b" ")
    return body if checksum == b"%08x" % zlib.crc32(body) else None
