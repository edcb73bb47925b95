"""What SQLite and PostgreSQL do differently; everything else is in ``_event_store``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import msgspec
from sqlalchemy import ColumnElement, Connection, Engine, select

from labos.ports import Head
from labos.store._tables import head

Row = tuple[Any, ...]


class WordChanges(msgspec.Struct, frozen=True):
    """What records do to the words beside them: rows that are added, and parameters of ``ERASE_WORDS``."""

    added: Sequence[Row] = ()
    erased: Sequence[Row] = ()


INSERT_WORDS = "INSERT INTO words (reference, position, salt, text, erased_at) VALUES (?, ?, ?, ?, ?)"
ERASE_WORDS = "UPDATE words SET salt = ?, text = '', erased_at = ? WHERE reference = ?"

REWRITE_WORDS = (
    "ALTER TABLE words ALTER COLUMN text SET STATISTICS 0, "
    "ALTER COLUMN text TYPE text COLLATE \"C\" USING text || ''"
)
"""Writes the table into a new file, without the rows that are no more. The server takes no samples of the
texts for its planner: they would stand in its catalogue."""

REWRITING = "labos_rewrite_words"
"""The function by which a role that does not own the table has that done."""

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
    """The part of the store that knows its database."""

    reading: Engine
    """Connections for readers; they cannot write and never make the writer wait."""

    writing: Engine
    """Makes the one connection that writes; a transaction on it is immediately exclusive."""

    now_ms: ColumnElement[int]
    """The database's clock, milliseconds since 1970."""

    def occupy(self, owner: str) -> None:
        """Before a claim: take what only one kernel can hold. Raises Refused."""

    def take_over(self, epoch: int, owner: str, remaining_ms: int) -> None:
        """Inside a claim, with the head row locked: make sure that the kernel of ``epoch`` is
        gone, and show that the kernel of ``epoch + 1`` lives. Raises Refused."""

    def vacate(self) -> None:
        """Give back what ``occupy`` and ``take_over`` took."""

    def keep(self, epoch: int) -> None:
        """At every renewal: take again what a lost connection dropped."""

    def is_locked(self, connection: Connection, epoch: int) -> bool:
        """Whether the kernel of this epoch still holds what only a living one can hold; asked by
        a reader. True if there is no telling."""

    def stand_by(self, name: str) -> None:
        """Show that somebody of this name stands by."""

    def standbys(self) -> list[str]:
        """The names of those who stand by."""

    def append(
        self, connection: Connection, expected: Head, after: Head, rows: Sequence[Row], beside: WordChanges
    ) -> bool:
        """In one exclusive transaction move the head from ``expected`` to ``after``, add rows
        of the event table, in the order of its columns, and do what follows for words. False, and nothing
        done, if the head is
        another. By plain statements: SQLAlchemy would take longer over each than the database."""

    def insert(self, connection: Connection, rows: Sequence[Row], beside: WordChanges) -> None:
        """Add rows of the event table, and do what follows for words, inside the transaction that the caller
        began."""

    def scrub(self) -> str:
        """Let nothing of what was erased stand anywhere in the database's files. Returns why it may still;
        empty if it does not."""

    def fetch(self, statement: str, parameters: Sequence[object]) -> list[Row]:
        """Rows of a plain statement (``?`` marks), by a reader's connection, without the cost
        that SQLAlchemy adds to each row."""

    def contains(self, column: ColumnElement[Any], part: str | bytes) -> ColumnElement[bool]:
        """Whether a column of text or bytes contains this text or these bytes, exactly."""

    def flaw(self, connection: Connection) -> str:
        """What the database itself finds wrong with its tables and indices; empty if nothing, or if it has
        no means to tell."""

    def forget(self) -> None:
        """Before the writer connects again after an error: end what the server may still do for
        its old connection. Raises StoreUnavailable, or the driver's error, if that is not sure."""

    def hang_up(self) -> None:
        """End every connection from this side, even if somebody waits on it. From any thread; waits for
        nothing."""

    def close(self) -> None: ...


class Holder(msgspec.Struct, frozen=True):
    """Who is the kernel by the head row (empty: the lab was given back), for how long its lease still
    runs, and whether it holds what only a living kernel can hold."""

    owner: str
    lease_left_s: float
    locked: bool

    @property
    def living(self) -> bool:
        return bool(self.owner) and self.lease_left_s > 0 and self.locked


def find_holder(backend: Backend) -> Holder:
    """Asked by a reader: nobody waits for it."""
    with backend.reading.connect() as connection:
        left = (head.c.lease_until - backend.now_ms).label("left")
        row = connection.execute(select(head.c.lease_owner, head.c.epoch, left)).one()
        left_s = row.left / 1000
        return Holder(
            str(row.lease_owner or ""), left_s, left_s > 0 and backend.is_locked(connection, row.epoch)
        )
