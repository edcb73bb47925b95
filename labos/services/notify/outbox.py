"""The messages to send and those that were sent: a small SQLite file beside the log.

It is a separate file, because a second writer in the log's database would delay the kernel. Notices and the
position up to which the log was read are written in one transaction, so a restart neither loses a notice nor
repeats one. The file holds the names of contacts from the contacts file, but no addresses.
"""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Literal

import msgspec

from labos.errors import StoreUnavailable
from labos.services.notify.notices import Notice, SettledNotice
from labos.services.notify.schedule import Due

KEPT_NS = 90 * 86_400 * 1_000_000_000
"""Notices that are settled are deleted after 90 days."""

_TABLES = """
CREATE TABLE IF NOT EXISTS note (name TEXT PRIMARY KEY, value INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS notice (event TEXT PRIMARY KEY, key TEXT NOT NULL, body BLOB NOT NULL,
  at INTEGER NOT NULL, settled TEXT);
CREATE INDEX IF NOT EXISTS notice_key ON notice (key) WHERE settled IS NULL;
CREATE TABLE IF NOT EXISTS delivery (event TEXT NOT NULL, contact TEXT NOT NULL, level INTEGER NOT NULL,
  due_at INTEGER NOT NULL, try_at INTEGER NOT NULL, state TEXT NOT NULL, attempts INTEGER NOT NULL,
  done_at INTEGER NOT NULL, error TEXT NOT NULL, PRIMARY KEY (event, contact, level));
CREATE INDEX IF NOT EXISTS delivery_try ON delivery (try_at) WHERE state = 'waiting';
"""

State = Literal["waiting", "sent", "withdrawn", "given_up"]


class Delivery(msgspec.Struct, frozen=True):
    """A message to one contact. ``due_at`` is the earliest time to send it, ``try_at`` the time of the next
    attempt, ``done_at`` when it was sent or withdrawn (UTC ns, 0 for not yet); ``id`` is the same at every
    attempt."""

    notice: Notice
    contact: str
    level: int
    due_at: int
    try_at: int
    state: State
    attempts: int
    done_at: int
    error: str

    @property
    def id(self) -> str:
        return f"{self.notice.event}.{self.contact}.{self.level}"


class Outbox:
    """The file. One notifier writes it; every process may read it. Calls raise StoreUnavailable."""

    def __init__(self, path: Path, *, create: bool = True) -> None:
        self.path = path
        self._turn = threading.RLock()
        try:
            if create:
                path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                path.touch(mode=0o600)
                self._db = sqlite3.connect(path, timeout=5, isolation_level=None, check_same_thread=False)
                self._db.execute("PRAGMA synchronous=FULL")
                self._db.executescript(_TABLES)
            else:
                uri = f"{path.absolute().as_uri()}?mode=ro"
                self._db = sqlite3.connect(uri, uri=True, timeout=5, isolation_level=None)
        except (OSError, sqlite3.Error) as error:
            raise self._make_unavailable_error(error) from None

    def close(self) -> None:
        self._db.close()

    # -- notices of the log -------------------------------------------------------------------

    def note(self, name: str) -> int | None:
        """A stored number: ``position`` (the log was read up to there), ``epoch`` (that of the last kernel),
        ``closed`` (the last epoch that shut down properly)."""
        rows = self._read_rows("SELECT value FROM note WHERE name = ?", (name,))
        return int(rows[0][0]) if rows else None

    def keep(self, **notes: int) -> None:
        with self._write_transaction():
            self._keep(notes)

    def take_in(
        self, items: Sequence[tuple[Notice, Sequence[Due]] | SettledNotice], now: int, **notes: int
    ) -> None:
        """Store notices with all their messages, and settle those that were answered; all in one
        transaction."""
        with self._write_transaction():
            for item in items:
                if isinstance(item, SettledNotice):
                    self._settle(item, now)
                else:
                    self._add(*item)
            self._keep(notes)

    def is_open(self, key: str) -> bool:
        """Whether people were or will be notified of this, and it is not settled."""
        return bool(self._read_rows("SELECT 1 FROM notice WHERE key = ? AND settled IS NULL", (key,)))

    def _add(self, notice: Notice, dues: Sequence[Due]) -> None:
        body = msgspec.json.encode(notice)
        done = self._db.execute(
            "INSERT OR IGNORE INTO notice VALUES (?, ?, ?, ?, NULL)",
            (notice.event, notice.key, body, notice.at),
        )
        if done.rowcount != 1:
            return  # already stored
        self._db.executemany(
            "INSERT INTO delivery VALUES (?, ?, ?, ?, ?, 'waiting', 0, 0, '')",
            [(notice.event, due.contact, due.level, due.at, due.at) for due in dues],
        )

    def _settle(self, answer: SettledNotice, now: int) -> None:
        match = "substr(key, 1, length(?)) = ?" if answer.all else "? = key AND key = ?"
        about = f"SELECT event FROM notice WHERE {match} AND settled IS NULL"
        if answer.quietly:
            about += " AND event NOT IN (SELECT event FROM delivery WHERE state = 'sent')"
        for (event,) in self._db.execute(about, (answer.key, answer.key)).fetchall():
            self._db.execute("UPDATE notice SET settled = ? WHERE event = ?", (answer.why, event))
            self._db.execute(
                "UPDATE delivery SET state = 'withdrawn', done_at = ? WHERE event = ? AND state = 'waiting'",
                (now, event),
            )

    # -- messages to send --------------------------------------------------------------------

    def list_due(self, now: int) -> list[Delivery]:
        """The messages that may be sent now, oldest first."""
        return self._read_deliveries("WHERE state = 'waiting' AND try_at <= ? ORDER BY try_at, level", (now,))

    def find_next_time(self) -> int | None:
        """The time of the next message."""
        rows = self._read_rows("SELECT min(try_at) FROM delivery WHERE state = 'waiting'", ())
        return None if rows[0][0] is None else int(rows[0][0])

    def mark_sent(self, delivery: Delivery, now: int) -> None:
        self._mark(delivery, "sent", delivery.attempts + 1, now, now, "")

    def mark_failed(
        self, delivery: Delivery, error: str, now: int, try_at: int | None, *, tried: bool = True
    ) -> None:
        """It was not accepted: try again at ``try_at``, or never if there is no such time."""
        attempts = delivery.attempts + tried
        if try_at is None:
            self._mark(delivery, "given_up", attempts, now, now, error)
        else:
            self._mark(delivery, "waiting", attempts, 0, try_at, error)

    def _mark(
        self, delivery: Delivery, state: State, attempts: int, done_at: int, try_at: int, error: str
    ) -> None:
        which = (delivery.notice.event, delivery.contact, delivery.level)
        with self._write_transaction():
            # A message may be withdrawn while it is being sent: it counts as sent.
            self._db.execute(
                "UPDATE delivery SET state = ?, attempts = ?, done_at = ?, try_at = ?, error = ?"
                " WHERE event = ? AND contact = ? AND level = ? AND (state = 'waiting' OR ? = 'sent')",
                (state, attempts, done_at, try_at, error[:500], *which, state),
            )

    # -- questions ---------------------------------------------------------------------------

    def list_deliveries(self, contact: str = "", *, waiting: bool = False, last: int = 50) -> list[Delivery]:
        """The last messages, sent or not, in order."""
        wheres, values = ["1"], []
        if contact:
            wheres.append("contact = ?")
            values.append(contact)
        if waiting:
            wheres.append("state = 'waiting'")
        found = self._read_deliveries(
            f"WHERE {' AND '.join(wheres)} ORDER BY due_at DESC, level DESC, contact LIMIT ?", (*values, last)
        )
        return found[::-1]

    def forget(self, now: int) -> None:
        """Delete notices that have been settled for long."""
        with self._write_transaction():
            over = (now - KEPT_NS,)
            self._db.execute("DELETE FROM delivery WHERE state != 'waiting' AND done_at < ?", over)
            self._db.execute(
                "DELETE FROM notice WHERE at < ? AND (key = '' OR settled IS NOT NULL)"
                " AND event NOT IN (SELECT event FROM delivery)",
                over,
            )

    # -- internal ------------------------------------------------------------------------------

    def _read_deliveries(self, tail: str, values: tuple[object, ...]) -> list[Delivery]:
        rows = self._read_rows(
            "SELECT body, contact, level, due_at, try_at, state, attempts, done_at, error"
            f" FROM delivery JOIN notice USING (event) {tail}",
            values,
        )
        return [Delivery(msgspec.json.decode(row[0], type=Notice), *row[1:]) for row in rows]

    def _read_rows(self, query: str, values: tuple[object, ...]) -> list[tuple[Any, ...]]:
        try:
            with self._turn, closing(self._db.execute(query, values)) as cursor:
                return cursor.fetchall()
        except sqlite3.Error as error:
            raise self._make_unavailable_error(error) from None

    def _keep(self, notes: dict[str, int]) -> None:
        for name, value in notes.items():
            self._db.execute("INSERT OR REPLACE INTO note VALUES (?, ?)", (name, value))

    @contextmanager
    def _write_transaction(self) -> Iterator[None]:
        with self._turn:
            try:
                self._db.execute("BEGIN IMMEDIATE")
                try:
                    yield
                except BaseException:
                    self._db.execute("ROLLBACK")
                    raise
                self._db.execute("COMMIT")
            except sqlite3.Error as error:
                raise self._make_unavailable_error(error) from None

    def _make_unavailable_error(self, error: Exception) -> StoreUnavailable:
        words = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
        return StoreUnavailable(
            f"The notifications in {self.path} are not available: {words}.",
            remedy="Check the disk and that the user who runs LabOS may write there.",
        )
