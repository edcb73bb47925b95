"""Reading the log, by the reader's own connections, from any thread."""

from __future__ import annotations

import hmac
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import msgspec
import structlog
from sqlalchemy import ColumnElement, Integer, Select, and_, func, literal_column, or_, select, true
from sqlalchemy.engine import URL

from labos.core.envelope import GENESIS, Envelope, Record, decode_folded
from labos.core.structs import make_from
from labos.core.users import ON_BEHALF
from labos.core.words import Kept
from labos.errors import LogDamaged
from labos.ports import Head, LogQuery, Row, StoredSnapshot, StoredWords
from labos.store import _checked
from labos.store._backend import Backend
from labos.store._checked import CheckedRows, report_damage
from labos.store._errors import TranslatedErrors
from labos.store._home import SEAL, HomeFiles
from labos.store._tables import event, head, snapshot, words
from labos.store._url import display_name
from labos.store._words import read_kept, read_words

_log = structlog.get_logger(__name__)

_CHUNK = 500
"""The number of records that a reader fetches at once. Between chunks it holds neither a connection nor a
snapshot, so a slow reader never prevents a checkpoint of the WAL."""

_COLUMNS = ", ".join(f'"{column.name}"' for column in event.columns)
_READ = f"SELECT {_COLUMNS} FROM event WHERE position > ? ORDER BY position LIMIT "
_REPLAY = f"SELECT {_checked.COLUMNS} FROM event WHERE position > ? ORDER BY position LIMIT "
HASH = "SELECT hash, envelope FROM event WHERE position = ?"
_BEHIND = "SELECT position FROM event WHERE position > ? ORDER BY position LIMIT 1"
# The limit is part of the text. PostgreSQL plans a prepared statement without its parameters, and for an
# unknown limit it would read the whole rest of the log.
_LIMIT = literal_column(str(_CHUNK), Integer)


class LogReader:
    """The reading half of the event store. No call holds a connection while its caller works with the
    results."""

    def __init__(self, url: URL, backend: Backend, files: HomeFiles) -> None:
        self._files = files
        self._said_unused = False
        self.name = display_name(url)
        self._backend = backend
        self._door = TranslatedErrors(url)
        self.answered = 0
        """Increases while a ``replay`` makes progress."""

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        """Records in order, from ``after + 1`` to ``upto`` or the end. Raises StoreUnavailable,
        LogDamaged where a position is missing."""
        lab = ""
        for rows in self._read_chunks(_READ, after, upto):
            lab = lab or self._lab_id()
            for row in rows:
                yield Record(Envelope(lab, *row[:11]), *row[11:])

    def replay(
        self, after: int = 0, upto: int | None = None, *, before: bytes = b"", end: Head | None = None
    ) -> Iterator[Row]:
        """The data of each record for a fold, as plain tuples: (position, type, schema, recorded_at,
        payload). Each record is checked against the chain before it is given.

        ``before`` is the hash that the chain must have at ``after``; if it is not given, the log's own hash
        is not checked. With ``end`` (the head row), the log must end exactly there: at that position, with
        that hash, without further records. Raises StoreUnavailable, LogDamaged with the position.
        """
        upto = end.position if end is not None else upto
        start, recorded_at = self._read_chain_at(after)
        if before and before != start:
            raise report_damage(self.name, after, "its hash is not the known one")
        checked: CheckedRows | None = None
        position = after
        for rows in self._read_chunks(_REPLAY, after, upto):
            self.answered += 1
            checked = checked or CheckedRows(self.name, self._lab_id(), start)
            yield from checked.check(rows)
            position, recorded_at = rows[-1][0], rows[-1][3]
        if end is not None:
            self._expect_end(end, position, checked.hash if checked is not None else start, recorded_at)

    def _expect_end(self, end: Head, position: int, hash_: bytes, recorded_at: int) -> None:
        """Raises LogDamaged if the end of a log that was read up to a position does not match its head
        row."""
        if position != end.position:
            fault = f"it is missing, but by the head row the log ends at {end.position}"
            raise report_damage(self.name, position + 1, fault)
        if hash_ != end.hash:
            fault = "the head row has another hash than this record, which is the last one"
            raise report_damage(self.name, position, fault)
        with self._door:
            rows = self._backend.fetch(_BEHIND, (position,))
        if rows:
            fault = f"it is after the end of the log, which is {position} by the head row"
            raise report_damage(self.name, rows[0][0], fault)
        if recorded_at != end.recorded_at:
            fault = "the head row has another time (recorded_at) than this record, which is the last one"
            raise report_damage(self.name, position, fault)

    def _read_chain_at(self, position: int) -> tuple[bytes, int]:
        """The hash of the log at a position, and the time at which that record was made. Raises LogDamaged if
        there is no such record, or if it belongs to another lab than the head row."""
        if not position:
            return GENESIS, 0
        with self._door:
            rows = self._backend.fetch(HASH, (position,))
        if not rows:
            raise self._report_gap(position)
        hash_, envelope = rows[0]
        try:
            at = decode_folded(envelope)
        except (TypeError, ValueError, msgspec.MsgspecError) as error:
            raise report_damage(self.name, position, f"its envelope cannot be read ({error})") from None
        if at.lab != (lab := self._lab_id()):
            raise report_damage(
                self.name, position, f"it is of the lab {at.lab}, but the head row says {lab}"
            )
        return bytes(hash_), at.recorded_at

    def _read_chunks(self, statement: str, after: int, upto: int | None) -> Iterator[list[Row]]:
        """Rows in chunks. Raises LogDamaged where a position is missing."""
        while upto is None or after < upto:
            limit = _CHUNK if upto is None else min(_CHUNK, upto - after)
            with self._door:
                rows = self._backend.fetch(f"{statement}{limit}", (after,))
            if not rows:
                return
            if rows[-1][0] != after + len(rows):
                missing = next(at for at, row in enumerate(rows, after + 1) if row[0] != at)
                yield rows[: missing - after - 1]
                raise self._report_gap(missing)
            yield rows
            after += len(rows)
            if len(rows) < limit:
                return

    def _report_gap(self, missing: int) -> LogDamaged:
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
        statement = make_selection(query, self._backend.contains)
        after, lab = query.after, ""
        if query.last is not None:
            positions = statement.with_only_columns(event.c.position).order_by(event.c.position.desc())
            newest = positions.limit(max(query.last, 0)).subquery().c.position
            ends = select(func.min(newest).label("first"), func.max(newest).label("last"))
            with self._door, self._backend.reading.connect() as connection:
                span = connection.execute(ends).one()
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

    def words_of(self, references: Iterable[str]) -> dict[str, Kept]:
        """The words that are stored beside the log for these references, including erased ones. References
        without words are left out. Raises StoreUnavailable."""
        with self._door, self._backend.reading.connect() as connection:
            return read_words(connection, references)

    def words_by(self, user: str) -> list[tuple[int, str]]:
        """Position and reference of all words of a user that were not erased. Raises StoreUnavailable."""
        theirs = or_(event.c.actor == user, event.c.actor.endswith(f"{ON_BEHALF}{user}", autoescape=True))
        query = (
            select(words.c.position, words.c.reference)
            .join(event, event.c.position == words.c.position)
            .where(words.c.erased_at == 0, theirs)
            .order_by(words.c.position)
        )
        with self._door, self._backend.reading.connect() as connection:
            return [(row.position, row.reference) for row in connection.execute(query)]

    def all_words(self) -> Iterator[StoredWords]:
        """All words, including erased ones, in the order of their references. Raises StoreUnavailable."""
        after = ""
        while True:
            query = select(words).where(words.c.reference > after).order_by(words.c.reference).limit(_CHUNK)
            with self._door, self._backend.reading.connect() as connection:
                rows = connection.execute(query).all()
            for row in rows:
                yield StoredWords(read_kept(row), row.position, row.erased_at)
            if len(rows) < _CHUNK:
                return
            after = rows[-1].reference

    def list_caused_by(self, prefix: str, last: int) -> list[tuple[int, str]]:
        """Positions and causations of those of the ``last`` records whose causation begins with ``prefix``.
        Raises StoreUnavailable."""
        first = select(head.c.position - last).scalar_subquery()
        wanted = (event.c.position > first, event.c.causation.startswith(prefix, autoescape=True))
        statement = select(event.c.position, event.c.causation).where(*wanted).order_by(event.c.position)
        with self._door, self._backend.reading.connect() as connection:
            return [(row.position, row.causation) for row in connection.execute(statement)]

    def load_snapshot(self, fingerprint: str) -> tuple[int, bytes, bytes] | None:
        """(position, hash, data) of the snapshot for this fold code, if it has a seal by this lab's key. A
        snapshot without a correct seal is not used, which is reported once. Raises StoreUnavailable;
        LogDamaged if the snapshot is genuine and the log has another record at its position."""
        found = self.read_snapshot_row()
        if found is None or not found.genuine:
            if found is not None:
                self._warn_unused(found.fault)
            return None
        if found.on_log is None:
            self._warn_unused(f"it is of position {found.position}, which is after the end of the log")
            return None
        if found.on_log != found.hash:
            fault = "its hash differs from the sealed snapshot of this position"
            raise report_damage(self.name, found.position, fault)
        return (found.position, found.hash, found.data) if found.fingerprint == fingerprint else None

    def read_snapshot_row(self) -> StoredSnapshot | None:
        """The content of the table of snapshots, genuine or not. Raises StoreUnavailable."""
        at = snapshot.outerjoin(event, event.c.position == snapshot.c.position)
        query = select(snapshot, event.c.hash.label("on_log"), head.c.lab).select_from(at).join(head, true())
        with self._door, self._backend.reading.connect() as connection:
            row = connection.execute(query).first()
        if row is None:
            return None
        try:
            seal = self._files.seal_snapshot(row.lab, row.position, row.hash, row.fingerprint, row.data)
            genuine = bool(seal) and hmac.compare_digest(seal, row.digest)
        except (TypeError, AttributeError, ValueError):  # SQLite allows values of any type in a column
            seal, genuine = "-", False
        tampered = not genuine and bool(seal) and str(row.digest).startswith(SEAL)
        if genuine:
            fault = ""
        elif not seal:
            fault = "the key for checking it is missing from this lab's folder"
        elif tampered:
            fault = "its seal was made with another key, or its content was changed"
        else:
            fault = "it has no seal"
        return make_from(StoredSnapshot, row, genuine=genuine, tampered=tampered, fault=fault)

    def flaw(self) -> str:
        """The fault that the database itself finds in its tables and indexes, in its own words; empty if it
        finds none, or cannot check (PostgreSQL). Raises StoreUnavailable."""
        with self._door, self._backend.reading.connect() as connection:
            return self._backend.flaw(connection)

    def _warn_unused(self, why: str) -> None:
        if not self._said_unused:
            self._said_unused = True
            _log.warning(
                "snapshot_not_used", why=why, instead="the state is computed from the beginning of the log"
            )

    def _lab_id(self) -> str:
        """The lab's id, from the head row. It is constant as soon as there is a record."""
        with self._door, self._backend.reading.connect() as connection:
            return str(connection.execute(select(head.c.lab)).scalar_one())


Contains = Callable[[Any, str | bytes], ColumnElement[bool]]


def make_selection(query: LogQuery, contains: Contains) -> Select[Any]:
    """The rows that a query selects, except for ``after``, ``last`` and their order."""
    c = event.c
    conditions: list[ColumnElement[bool]] = []
    if query.after:
        conditions.append(c.position > query.after)
    if query.upto is not None:
        conditions.append(c.position <= query.upto)
    if query.types:
        conditions.append(or_(*(_match_type(name) for name in query.types)))
    if query.streams:
        conditions.append(c.stream.in_(query.streams))
    if query.correlation:
        conditions.append(c.correlation == query.correlation)
    if query.actor:
        conditions.append(c.actor == query.actor)
    if query.mentions:
        # In a payload the text has the form of JSON.
        quoted = msgspec.json.encode(query.mentions)[1:-1]
        beside = select(words.c.position).where(contains(words.c.text, query.mentions))
        matches = (contains(c.payload, quoted), contains(c.stream, query.mentions), c.position.in_(beside))
        conditions.append(or_(*matches))
    if query.since_ns is not None:
        conditions.append(c.recorded_at >= query.since_ns)
    if query.until_ns is not None:
        conditions.append(c.recorded_at < query.until_ns)
    return select(event).where(*conditions)


def _match_type(name: str) -> ColumnElement[bool]:
    """A type, or every type of a family: all names between ``name.`` and ``name/``, the next character in
    byte order. A range uses the index, and has no wildcards."""
    family = name.rstrip(".*")
    return or_(event.c.type == family, and_(event.c.type >= f"{family}.", event.c.type < f"{family}/"))
