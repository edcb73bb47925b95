"""The differences between SQLite and PostgreSQL; everything else is in ``_event_store``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import msgspec
from sqlalchemy import ColumnElement, Connection, Engine, select

from labos.ports import Head, Row
from labos.store._tables import head


class WordChanges(msgspec.Struct, frozen=True):
    """The changes of the words beside the log by new records: rows to add, and parameters of
    ``ERASE_WORDS``."""

    added: Sequence[Row] = ()
    erased: Sequence[Row] = ()


INSERT_WORDS = "INSERT INTO words (reference, position, salt, text, erased_at) VALUES (?, ?, ?, ?, ?)"
ERASE_WORDS = "UPDATE words SET salt = ?, text = '', erased_at = ? WHERE reference = ?"

REWRITE_WORDS = (
    "ALTER TABLE words ALTER COLUMN text SET STATISTICS 0, "
    "ALTER COLUMN text TYPE text COLLATE \"C\" USING text || ''"
)
"""Writes the table into a new file, without deleted rows. The server must not take samples of the texts for
its planner: they would be stored in its catalogue."""

REWRITING = "labos_rewrite_words"
"""The function with which a role that does not own the table has it rewritten."""

MOVE_HEAD = (
    "UPDATE head SET position = ?, hash = ?, recorded_at = ? "
    "WHERE position = ? AND hash = ? AND epoch = ? AND lab = ?"
)


def make_head_row(expected: Head, after: Head) -> Row:
    """The parameters of ``MOVE_HEAD``."""
    return (
        after.position,
        after.hash,
        after.recorded_at,
        expected.position,
        expected.hash,
        expected.epoch,
        expected.lab,
    )


class Backend(Protocol):
    """The part of the store that depends on the database. What a database does not need does nothing."""

    reading: Engine
    """Connections for readers. They cannot write, and the writer never waits for them."""

    writing: Engine
    """Makes the single connection that writes; its transactions are exclusive from their begin."""

    now_ms: ColumnElement[int]
    """The database's clock, milliseconds since 1970."""

    def occupy(self, owner: str) -> None:
        """Take the lock that only one kernel can hold; called before a claim. Raises Refused."""

    def take_over(self, epoch: int, owner: str, remaining_ms: int) -> None:
        """Make sure that the kernel of ``epoch`` is gone, and show that the kernel of ``epoch + 1`` lives.
        Called inside a claim, while the head row is locked. Raises Refused."""
        return None

    def vacate(self) -> None:
        """Release what ``occupy`` and ``take_over`` took."""

    def keep(self, epoch: int) -> None:
        """Take again what a lost connection released; called at every renewal."""
        return None

    def is_locked(self, connection: Connection, epoch: int) -> bool:
        """Whether the kernel of this epoch still holds the lock of a living kernel; called by readers. True
        if this cannot be found out."""

    def stand_by(self, name: str) -> None:
        """Show that a standby of this name is ready."""
        return None

    def standbys(self) -> list[str]:
        """The names of the standbys that are ready."""
        return []

    def append(
        self, connection: Connection, expected: Head, after: Head, rows: Sequence[Row], beside: WordChanges
    ) -> bool:
        """In one exclusive transaction, move the head from ``expected`` to ``after``, add rows of the event
        table in the order of its columns, and make the changes of words. Returns False, and changes nothing,
        if the head is a different one. It uses plain statements, because SQLAlchemy would take longer for
        each than the database."""

    def insert(self, connection: Connection, rows: Sequence[Row], beside: WordChanges) -> None:
        """Add rows of the event table, and make the changes of words, inside the transaction that the caller
        began."""

    def scrub(self) -> str:
        """Remove all erased data from the database's files. Returns why some may remain; empty if none
        does."""

    def fetch(self, statement: str, parameters: Sequence[object]) -> list[Row]:
        """The rows of a plain statement (``?`` marks), by a reader's connection, without SQLAlchemy's cost
        for each row."""

    def contains(self, column: ColumnElement[Any], part: str | bytes) -> ColumnElement[bool]:
        """Whether a column of text or bytes contains exactly this text or these bytes."""

    def flaw(self, connection: Connection) -> str:
        """The fault that the database itself finds in its tables and indexes; empty if it finds none, or
        cannot check."""
        return ""

    def forget(self) -> None:
        """End the work that the server may still do for the writer's old connection; called before the
        writer connects again after an error. Raises StoreUnavailable, or the driver's error, if this is
        not certain."""
        return None

    def hang_up(self) -> None:
        """Close every connection from this side, even if a thread waits for an answer on it. May be called
        from any thread; it does not wait."""
        return None

    def close(self) -> None: ...


class Holder(msgspec.Struct, frozen=True):
    """The kernel that holds the lab according to the head row (empty: the lab was given back), the remaining
    time of its lease, and whether it holds the lock of a living kernel."""

    owner: str
    lease_left_s: float
    locked: bool

    @property
    def living(self) -> bool:
        return bool(self.owner) and self.lease_left_s > 0 and self.locked


def find_holder(backend: Backend) -> Holder:
    """Called by readers; no other connection waits for it."""
    with backend.reading.connect() as connection:
        left = (head.c.lease_until - backend.now_ms).label("left")
        row = connection.execute(select(head.c.lease_owner, head.c.epoch, left)).one()
        left_s = row.left / 1000
        return Holder(
            str(row.lease_owner or ""), left_s, left_s > 0 and backend.is_locked(connection, row.epoch)
        )
