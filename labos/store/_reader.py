"""Reading the log: by connections of the reader's own, from any thread."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

from sqlalchemy import Integer, literal_column, select
from sqlalchemy.engine import URL

from labos.core.envelope import Envelope, Record
from labos.errors import LogDamaged
from labos.ports import LogQuery
from labos.store._backend import Backend, Row
from labos.store._errors import Door
from labos.store._select import positions_of_last, selection
from labos.store._tables import event, head, snapshot
from labos.store._url import display_name

_CHUNK = 500
"""Records a reader fetches at once. Between chunks it holds neither connection nor snapshot, so
a slow reader never keeps the WAL from being checkpointed."""

_COLUMNS = ", ".join(f'"{column.name}"' for column in event.columns)
_READ = f"SELECT {_COLUMNS} FROM event WHERE position > ? ORDER BY position LIMIT "
_REPLAY = (
    'SELECT position, type, "schema", recorded_at, payload FROM event '
    "WHERE position > ? ORDER BY position LIMIT "
)
# The limit is part of the text: PostgreSQL plans a statement that it prepared without knowing its
# parameters, and reads the whole rest of the log for a limit that it does not know.
_LIMIT = literal_column(str(_CHUNK), Integer)


class LogReader:
    """The reading half of the event store. No call holds a connection while its caller looks at
    what it got."""

    def __init__(self, url: URL, backend: Backend) -> None:
        self.name = display_name(url)
        self._backend = backend
        self._door = Door(url)
        self.answered = 0
        """Goes up while a ``replay`` gets on."""

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        """Records in order, from ``after + 1`` to ``upto`` or the end. Raises StoreUnavailable,
        LogDamaged where a position is missing."""
        lab = ""
        for rows in self._chunks(_READ, after, upto):
            lab = lab or self._lab_id()
            for row in rows:
                yield Record(Envelope(lab, *row[:11]), *row[11:])

    def replay(self, after: int = 0, upto: int | None = None) -> Iterator[Row]:
        """What a fold needs of each record, as plain tuples: (position, type, schema, recorded_at,
        payload).

        Twice as fast as ``read``. Raises like it.
        """
        for rows in self._chunks(_REPLAY, after, upto):
            self.answered += 1
            yield from rows

    def _chunks(self, statement: str, after: int, upto: int | None) -> Iterator[list[Row]]:
        """Rows in pieces. Raises LogDamaged where a position is missing."""
        while upto is None or after < upto:
            limit = _CHUNK if upto is None else min(_CHUNK, upto - after)
            with self._door:
                rows = self._backend.fetch(f"{statement}{limit}", (after,))
            if not rows:
                return
            if rows[-1][0] != after + len(rows):
                missing = next(at for at, row in enumerate(rows, after + 1) if row[0] != at)
                yield rows[: missing - after - 1]
                raise self._gap(missing)
            yield rows
            after += len(rows)
            if len(rows) < limit:
                return

    def _gap(self, missing: int) -> LogDamaged:
        return LogDamaged(
            f"The record at position {missing} is missing from the {self.name}.",
            position=missing,
            remedy="Restore the log from a backup.",
        )

    def select(self, query: LogQuery) -> Iterator[Record]:
        """Records that a query selects, in order. Raises StoreUnavailable.

        ``types`` holds types or families (``action`` selects every ``action.…``); ``mentions``
        selects records whose stream or payload contains that text; ``since_ns`` is the first
        moment that counts, ``until_ns`` the first that does not.
        """
        statement = selection(query, self._backend.contains)
        after, lab = query.after, ""
        if query.last is not None:
            with self._door, self._backend.reading.connect() as connection:
                span = connection.execute(positions_of_last(statement, query.last)).one()
            if span.first is None:
                return
            after = span.first - 1
            statement = statement.where(event.c.position <= span.last)
        while True:
            chunk = statement.where(event.c.position > after).order_by(event.c.position).limit(_LIMIT)
            with self._door, self._backend.reading.connect() as connection:
                rows = connection.execute(chunk).all()
            lab = lab or (self._lab_id() if rows else "")
            for row in rows:
                yield Record(Envelope(lab, *row[:11]), *row[11:])
            if len(rows) < _CHUNK:
                return
            after = rows[-1].position

    def load_snapshot(self, fingerprint: str) -> tuple[int, bytes, bytes] | None:
        """(position, hash, data) of the snapshot of this fold, if its hash is still the log's
        hash at that position and its data are whole. Raises StoreUnavailable."""
        at = snapshot.join(
            event, (event.c.position == snapshot.c.position) & (event.c.hash == snapshot.c.hash)
        )
        query = (
            select(snapshot.c.position, snapshot.c.hash, snapshot.c.data, snapshot.c.digest)
            .select_from(at)
            .where(snapshot.c.fingerprint == fingerprint)
        )
        with self._door, self._backend.reading.connect() as connection:
            row = connection.execute(query).first()
        if row is None or hashlib.sha256(row.data).hexdigest() != row.digest:
            return None
        return row.position, row.hash, row.data

    def _lab_id(self) -> str:
        """The lab, from the head row. Ask once there is a record: from then on it is constant."""
        with self._door, self._backend.reading.connect() as connection:
            return str(connection.execute(select(head.c.lab)).scalar_one())
