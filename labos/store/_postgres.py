"""PostgreSQL: a lease by the server's clock, and a session lock that shows that its kernel lives."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Sequence
from threading import Lock
from typing import Any
from weakref import WeakSet

import psycopg
from psycopg import Cursor
from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Engine,
    create_engine,
    event,
    func,
    literal,
    literal_column,
    text,
)
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool, QueuePool

from labos.clock import Uuid7Ids
from labos.errors import Refused, StoreUnavailable
from labos.ports import Head, Row
from labos.store._backend import (
    ERASE_WORDS,
    INSERT_WORDS,
    MOVE_HEAD,
    REWRITE_WORDS,
    REWRITING,
    Backend,
    WordChanges,
    make_head_row,
)
from labos.store._tables import event as event_table
from labos.store._url import display_name

CONNECT_TIMEOUT_S = 5
VANISHED_S = 10
LOCK_TIMEOUT_S = 15
IDLE_TRANSACTION_TIMEOUT_S = 5
"""The server ends a writer that stands still inside a transaction (a frozen process). Then the next kernel,
which waits for the head row up to LOCK_TIMEOUT_S, gets it."""

SILENT_S = 2
"""A writer counts as frozen if its lease is over and the server has waited for it this long inside a
transaction."""

_KERNEL_LOCK = 0x4C61624F
"""First half of the advisory lock ("LabO"); the second half is the epoch."""

_COPY_FROM = 20
"""From this number of rows on, COPY is faster than single inserts."""

FORGET_S = 5.0
"""A session that was ended has to be gone after this time."""

LOOK_S = 0.1
"""The pause between two checks of a writer that seems to stand still, by a kernel that claims the log."""

_IN_MID_TRANSACTION = """
SELECT pid, state_change < clock_timestamp() - make_interval(secs => :silent_s) AS silent
FROM pg_stat_activity, head
WHERE datname = current_database() AND left(application_name, 6) = 'labos-'
  AND right(application_name, 2) = '-w' AND wait_event = 'ClientRead' AND xact_start IS NOT NULL
  AND lease_until < extract(epoch FROM clock_timestamp()) * 1000
"""
"""Writers whose lease is over, and for which the server waits inside a transaction. The server ends such a
session by itself only between two statements, but not while it waits for the rows of a COPY or for the rest
of a pipeline."""

STANDBY_SHOWN_S = 5
"""A standby that has not shown for this long that it is ready may have lost its connection: the server cannot
know."""

_STANDBY = "labos standby "

_STANDING_BY = """
SELECT application_name FROM pg_stat_activity
WHERE datname = current_database() AND starts_with(application_name, :prefix)
  AND state_change > clock_timestamp() - make_interval(secs => :shown_s)
ORDER BY application_name
"""

_END_WRITER = """
SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity
WHERE datname = current_database() AND application_name = :writer
"""

_COLUMN_NAMES = ", ".join(f'"{column.name}"' for column in event_table.columns)
_INSERT = f"INSERT INTO event ({_COLUMN_NAMES}) VALUES ({', '.join(['%s'] * len(event_table.columns))})"
_MOVE_HEAD = MOVE_HEAD.replace("?", "%s")

SCRUB_WAITS_S = 2
"""A scrub waits at most this long for readers of the table, because the kernel writes nothing meanwhile and
its lease runs."""

_INSERT_WORDS = INSERT_WORDS.replace("?", "%s")
_ERASE_WORDS = ERASE_WORDS.replace("?", "%s")
# Named by their oid: the tables need not be in the first schema of this role's search path.
_MAY_REWRITE = f"""
SELECT pg_has_role(relowner, 'MEMBER') AS owns,
  coalesce(has_function_privilege(to_regprocedure('{REWRITING}()')::oid, 'EXECUTE'), false) AS granted,
  EXISTS (SELECT 1 FROM pg_stats WHERE schemaname = nspname AND tablename = relname AND attname = 'text')
    AS sampled,
  (SELECT pg_has_role(datdba, 'MEMBER') FROM pg_database WHERE datname = current_database()) AS rules
FROM pg_class JOIN pg_namespace ON pg_namespace.oid = relnamespace WHERE pg_class.oid = 'words'::regclass
"""
_COPY = f"COPY event ({_COLUMN_NAMES}) FROM STDIN (FORMAT BINARY)"
_TYPES = ["int8", "text", "text", "int4", "text", "int4", "int8"] + ["text"] * 4 + ["bytea"] * 3


class PostgresBackend(Backend):
    """The backend for PostgreSQL.

    A kernel holds the advisory lock (LabO, epoch) in a session of its own. The server drops it when the
    kernel's process dies, so a successor finds that lock free and need not wait for the lease; a kernel that
    lives but is cut off or frozen keeps it until the lease expires.
    """

    now_ms: ColumnElement[int] = literal_column(
        "CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)", BigInteger
    )

    def __init__(self, url: URL) -> None:
        self.name = display_name(url)
        # A name for the writer's session, so that exactly this session can be ended.
        self._tag = f"labos-{Uuid7Ids().new()}"
        self._lines = Lines()
        self.writing = _make_engine(url, f"{self._tag}-w", self._lines, writes=True)
        self.reading = _make_engine(url, f"{self._tag}-r", self._lines, writes=False)
        self._keeping = create_engine(
            url,
            poolclass=NullPool,
            isolation_level="AUTOCOMMIT",
            connect_args=_make_arguments(f"{self._tag}-k"),
        )
        event.listen(self._keeping, "connect", self._lines.add)
        self._keeper: Connection | None = None
        self._kept: int | None = None

    # -- one kernel ------------------------------------------------------------------------

    def occupy(self, owner: str) -> None:
        # This is before the transaction of the claim, in which nothing may take long. A lease can end before
        # its kernel has been silent long enough to count as frozen: then the claim waits for that.
        keeper = self._open_keeper()
        give_up = time.monotonic() + 2 * SILENT_S
        while time.monotonic() < give_up:
            found = keeper.execute(text(_IN_MID_TRANSACTION), {"silent_s": SILENT_S}).all()
            for writer in found:
                if writer.silent:
                    keeper.execute(text("SELECT pg_terminate_backend(:pid)"), {"pid": writer.pid})
            if not found:
                return
            time.sleep(LOOK_S)

    def take_over(self, epoch: int, owner: str, remaining_ms: int) -> None:
        keeper = self._open_keeper()
        predecessor_is_gone = _try_lock(keeper, epoch)
        if not predecessor_is_gone and remaining_ms > 0:
            raise Refused(
                f"Another kernel already runs the lab in the {self.name}: {owner or 'unknown'}, "
                f"whose lease lasts {remaining_ms / 1000:.0f} s more.",
                remedy="Stop it first, or give this one a database of its own.",
            )
        if not _try_lock(keeper, epoch + 1):
            raise Refused(
                f"Another kernel is just starting on the {self.name}.", remedy="Try again in a few seconds."
            )
        self._kept = epoch + 1
        if predecessor_is_gone:
            keeper.execute(
                text("SELECT pg_advisory_unlock(:kind, :epoch)"),
                {"kind": _KERNEL_LOCK, "epoch": epoch},
            )

    def vacate(self) -> None:
        self._kept = None
        keeper, self._keeper = self._keeper, None
        if keeper is not None:
            try:
                keeper.invalidate()
            finally:
                keeper.close()

    def keep(self, epoch: int) -> None:
        if self._kept == epoch:
            try:
                self._open_keeper().execute(text("SELECT 1"))
                return
            except DBAPIError:
                self.vacate()
        if _try_lock(self._open_keeper(), epoch):
            self._kept = epoch

    def is_locked(self, connection: Connection, epoch: int) -> bool:
        found = connection.execute(
            text(
                "SELECT 1 FROM pg_locks JOIN pg_database ON pg_database.oid = pg_locks.database "
                "WHERE datname = current_database() AND locktype = 'advisory' AND granted "
                "AND classid = :kind AND objid = :epoch AND objsubid = 2"
            ),
            {"kind": _KERNEL_LOCK, "epoch": epoch},
        )
        return found.first() is not None

    def stand_by(self, name: str) -> None:
        try:
            if self._keeper is None:
                keeper = self._open_keeper()
                keeper.execute(
                    text("SELECT set_config('application_name', :name, false)"), {"name": f"{_STANDBY}{name}"}
                )
            self._open_keeper().execute(text("SELECT 1"))
        except DBAPIError:
            self.vacate()
            raise

    def standbys(self) -> list[str]:
        with self.reading.connect() as connection:
            found = connection.execute(text(_STANDING_BY), {"prefix": _STANDBY, "shown_s": STANDBY_SHOWN_S})
            return [str(name).removeprefix(_STANDBY) for (name,) in found]

    def _open_keeper(self) -> Connection:
        if self._keeper is None:
            self._keeper = self._keeping.connect()
        return self._keeper

    # -- rows ------------------------------------------------------------------------------

    def append(
        self, connection: Connection, expected: Head, after: Head, rows: Sequence[Row], beside: WordChanges
    ) -> bool:
        driver: Any = connection.connection.driver_connection
        with connection.begin() as transaction, driver.cursor() as cursor:
            cursor.execute(_MOVE_HEAD, make_head_row(expected, after))
            if cursor.rowcount != 1:
                transaction.rollback()
                return False
            _insert(cursor, rows, beside)
        return True

    def insert(self, connection: Connection, rows: Sequence[Row], beside: WordChanges) -> None:
        driver: Any = connection.connection.driver_connection
        with driver.cursor() as cursor:
            _insert(cursor, rows, beside)

    def scrub(self) -> str:
        # An erased row stays in the table's file until the file is rewritten: by the owner, or by the
        # function that the owner made for the role of kernels. VACUUM FULL would copy erased rows as long as
        # any session in the database uses an older state of it.
        with self._keeping.connect() as connection:
            may = connection.execute(text(_MAY_REWRITE)).one()
            if not may.owns and not may.granted:
                return (
                    "this role may not rewrite the table `words`; the owner of the tables can allow "
                    "it (labos db writer ROLE) or do it (labos db scrub)"
                )
            try:
                connection.execute(text(f"SET lock_timeout = '{SCRUB_WAITS_S}s'"))
                connection.execute(text(REWRITE_WORDS if may.owns else f"SELECT {REWRITING}()"))
                if may.sampled and may.rules:
                    connection.execute(text("VACUUM FULL pg_statistic"))
            except DBAPIError as error:
                return f"{str(error.orig).strip()}; repeat it when nobody reads there (labos db scrub)"
        if may.sampled and not may.rules:
            return (
                "the server has samples of the texts in its statistics; the owner of the database has to "
                "run VACUUM FULL pg_statistic"
            )
        return ""

    def fetch(self, statement: str, parameters: Sequence[object]) -> list[Row]:
        with self.reading.connect() as connection:
            driver: Any = connection.connection.driver_connection
            cursor: Cursor[Row]
            try:
                with driver.cursor(binary=True) as cursor:
                    cursor.execute(statement.replace("?", "%s"), parameters)
                    return cursor.fetchall()
            except BaseException:
                connection.invalidate()
                raise

    def contains(self, column: ColumnElement[Any], part: str | bytes) -> ColumnElement[bool]:
        if isinstance(part, str):
            return func.strpos(column, part) > 0
        return func.position(literal(part).op("IN")(column)) > 0

    # -- connections -----------------------------------------------------------------------

    def forget(self) -> None:
        # If the connection broke, the server may still be completing the old transaction. When that session
        # is gone, the answer of `head` is final. As long as this is not certain, no answer is.
        give_up = time.monotonic() + FORGET_S
        while True:
            with self.reading.connect() as connection:  # each check uses its own transaction
                left = connection.execute(text(_END_WRITER), {"writer": f"{self._tag}-w"}).scalar_one()
            if not left:
                return
            if time.monotonic() >= give_up:
                raise StoreUnavailable(
                    f"The {self.name} is still carrying out a request of a lost connection.",
                    remedy="Wait until it has finished.",
                )
            time.sleep(LOOK_S / 5)

    def hang_up(self) -> None:
        self._lines.cut()

    def close(self) -> None:
        self.vacate()
        for engine in (self.reading, self.writing, self._keeping):
            engine.dispose()


class Lines:
    """The open connections to a server. They can be closed while a thread waits for an answer: libpq waits
    without a time limit, and the system of a frozen server continues to acknowledge what is sent. Only
    closing the connection wakes the waiting thread."""

    def __init__(self) -> None:
        self._open: WeakSet[psycopg.Connection[Any]] = WeakSet()
        self._lock = Lock()

    def add(self, connection: psycopg.Connection[Any], _record: object = None) -> None:
        """As a listener to SQLAlchemy's ``connect``."""
        with self._lock:
            self._open.add(connection)

    def cut(self) -> None:
        """Close all connections from this side: waiting callers get psycopg's OperationalError."""
        with self._lock:
            lines = list(self._open)
        for line in lines:
            _shut(line)


def _shut(line: psycopg.Connection[Any]) -> None:
    # The connection is closed by a handle of its own: the waiting thread may close it at this moment, and its
    # number may then belong to another file. If the handle is still open afterwards, it belonged to the
    # connection.
    with (
        contextlib.suppress(psycopg.Error, OSError),
        socket.fromfd(line.pgconn.socket, socket.AF_INET, socket.SOCK_STREAM) as handle,
    ):
        if not line.closed:
            handle.shutdown(socket.SHUT_RDWR)


def _insert(cursor: Any, rows: Sequence[Row], beside: WordChanges) -> None:
    if beside.added:
        cursor.executemany(_INSERT_WORDS, beside.added)
    if beside.erased:
        cursor.executemany(_ERASE_WORDS, beside.erased)
    if len(rows) < _COPY_FROM:
        if rows:
            cursor.executemany(_INSERT, rows)
        return
    with cursor.copy(_COPY) as copy:
        copy.set_types(_TYPES)
        for row in rows:
            copy.write_row(row)


def _try_lock(keeper: Connection, epoch: int) -> bool:
    found = keeper.execute(
        text("SELECT pg_try_advisory_lock(:kind, :epoch)"), {"kind": _KERNEL_LOCK, "epoch": epoch}
    )
    return bool(found.scalar_one())


def _make_arguments(name: str) -> dict[str, Any]:
    return {
        "application_name": name,
        "connect_timeout": CONNECT_TIMEOUT_S,
        # For a peer that vanished without closing the connection: while it has not acknowledged what was
        # sent, the system gives up after VANISHED_S (by default only after a quarter of an hour; keepalives
        # do not count then). While its answer is awaited, the system gives up about 5 s later, at the second
        # keepalive. Only the kernel's own limit helps on systems without this option (Windows, macOS), and if
        # the server is frozen while its system lives.
        "tcp_user_timeout": VANISHED_S * 1000,
        "keepalives_idle": 10,
        "keepalives_interval": 5,
        "keepalives_count": 2,
    }


def make_small_engine(url: URL) -> Engine:
    """Connections for data other than the log; they do not affect the kernel's own sessions."""
    return create_engine(
        url, pool_size=2, max_overflow=4, pool_pre_ping=True, connect_args=_make_arguments("labos accounts")
    )


def _make_engine(url: URL, name: str, lines: Lines, *, writes: bool) -> Engine:
    if writes:
        engine = create_engine(url, poolclass=NullPool, connect_args=_make_arguments(name))
        settings = [
            f"SET lock_timeout = '{LOCK_TIMEOUT_S}s'",
            f"SET idle_in_transaction_session_timeout = '{IDLE_TRANSACTION_TIMEOUT_S}s'",
            # A commit is acknowledged only when it is on disk, whatever the server's default; stronger
            # settings stay.
            "SELECT set_config('synchronous_commit', 'on', false) "
            "WHERE current_setting('synchronous_commit') = 'off'",
        ]
    else:
        engine = create_engine(
            url,
            poolclass=QueuePool,
            pool_size=4,
            max_overflow=60,
            pool_pre_ping=True,
            connect_args=_make_arguments(name),
        )
        settings = ["SET default_transaction_read_only = on"]

    @event.listens_for(engine, "connect")
    def configure(connection: psycopg.Connection[Any], record: object) -> None:
        lines.add(connection, record)
        connection.autocommit = True
        for setting in settings:
            connection.execute(setting)
        connection.autocommit = False

    return engine
