"""Records for a fold: each is checked against the chain before it is used.

So a damaged or manipulated database is detected here, and not by its consequences in the lab. The check
covers the hash (and therefore the envelope, and its link to the record before), the payload's digest, and the
columns that a fold uses against the envelope. The other columns only serve queries; ``find_first_damage``
checks them too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from operator import itemgetter

import msgspec

from labos.core.envelope import decode_folded
from labos.errors import LogDamaged
from labos.ports import Row

COLUMNS = 'position, type, "schema", recorded_at, payload, envelope, hash'
REMEDY = (
    "This record and all records after it were not used. Run `labos verify` for details, keep this "
    "database as it is, and restore the log from a backup."
)

_FOLDED = itemgetter(slice(0, 5))
_sha256 = hashlib.sha256


class CheckedRows:
    """Takes rows of ``COLUMNS``, and gives (position, type, schema, recorded_at, payload). ``hash`` is the
    hash of the last correct row; at first it is the hash of the record before the first row."""

    def __init__(self, name: str, lab: str, before: bytes) -> None:
        self._name, self._lab = name, lab
        self.hash = before

    def check(self, rows: Sequence[Row]) -> Iterator[Row]:
        """Raises LogDamaged at the first row that differs from what was recorded; the rows before it are
        given."""
        number = self._count_good(rows)
        # One call checks all of them: a Python step for each would cost as much as its check.
        yield from map(_FOLDED, rows if number == len(rows) else rows[:number])
        if number < len(rows):
            raise report_damage(self._name, rows[number][0], _find_fault(rows[number], self.hash, self._lab))

    def _count_good(self, rows: Sequence[Row]) -> int:
        """The number of rows, from the first one on, that are as recorded."""
        previous, lab, decode, sha256 = self.hash, self._lab, decode_folded, _sha256
        number = 0
        try:
            for position, kind, schema, recorded_at, payload, envelope, stored in rows:
                if sha256(previous + envelope).digest() != stored:
                    break
                head = decode(envelope)
                if (
                    sha256(payload).hexdigest() != head.digest
                    or head.position != position
                    or head.type != kind
                    or head.schema != schema
                    or head.recorded_at != recorded_at
                    or head.lab != lab
                ):
                    break
                previous = stored
                number += 1
        except (TypeError, ValueError, msgspec.MsgspecError):
            pass  # ``_find_fault`` finds the field
        self.hash = previous
        return number


def _find_fault(row: Row, previous: bytes, lab: str) -> str:
    """The fault of a row, with the name of the field."""
    position, kind, schema, recorded_at, payload, envelope, stored = row
    # SQLite allows values of any type in a column.
    fields = {"envelope": envelope, "payload": payload, "hash": stored}
    wrong = [name for name, value in fields.items() if not isinstance(value, bytes)]
    if wrong:
        return f"a column holds a value of the wrong type ({', '.join(wrong)})"
    if _sha256(previous + envelope).digest() != stored:
        return "its envelope or its hash was changed after it was recorded, or the record before it was"
    try:
        head = decode_folded(envelope)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return f"its envelope cannot be read ({error})"
    if head.lab != lab:
        return f"it is of the lab {head.lab}, but the head row says {lab}"
    if _sha256(payload).hexdigest() != head.digest:
        return "its payload is not the one that was recorded"
    columns = {"position": position, "type": kind, "schema": schema, "recorded_at": recorded_at}
    wrong = [name for name, value in columns.items() if getattr(head, name) != value]
    return f"its stored columns contradict its envelope ({', '.join(wrong)})"


def report_damage(name: str, position: int, fault: str) -> LogDamaged:
    """The error for a record that is not as recorded."""
    return LogDamaged(
        f"The record at position {position} of the {name} is damaged: {fault}.",
        position=position,
        remedy=REMEDY,
    )
