"""The log in a SQL database: one class for SQLite and PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

import msgspec
import structlog
from sqlalchemy import Connection, delete, insert, select, update
from sqlalchemy.engine import URL

from labos.core.envelope import Record
from labos.core.ids import LabId
from labos.errors import BadInput, Fenced, Refused, StoreError, StoreUnavailable
from labos.ports import Head, Row
from labos.store._backend import Backend, Holder, WordChanges, find_holder
from labos.store._home import HomeFiles
from labos.store._reader import HASH, LogReader
from labos.store._tables import head, snapshot
from labos.store._words import make_changes, read_erased, read_words

CLOSE_S = 2.0
"""When the store is closed, a write under way may take this long before it is broken off."""

_log = structlog.get_logger(__name__)

_HEAD = select(head.c.lab, head.c.position, head.c.hash, head.c.epoch, head.c.recorded_at)


class SqlEventStore(LogReader):
    """The event store on SQLite or PostgreSQL; implements ``labos.ports.EventStore``.

    Writes (``claim``, ``renew``, ``release``, ``append``, ``save_snapshot``) share one connection
    and wait for each other. Reads use connections of their own and may come from any thread.
    After a StoreUnavailable the next call connects anew.
    """

    def __init__(
        self, url: URL, backend: Backend, *, read_only: bool = False, home: Path | None = None
    ) -> None:
        super().__init__(url, backend, HomeFiles(home))
        self._known: int | None = None
        self._read_only = read_only
        self._turn = Lock()
        self._writer: Connection | None = None
        self._epoch: int | None = None
        self._doubtful = False

    # -- the head --------------------------------------------------------------------------

    def head(self) -> Head:
        """The end of the log. Raises StoreUnavailable.

        For the store that claimed the lab, this waits until an append of its own whose outcome
        was not known has either happened or can no longer happen.
        """
        with self._door:
            if self._epoch is None:
                with self._backend.reading.connect() as connection:
                    row = connection.execute(_HEAD).one()
            else:
                with self._transaction() as connection:
                    row = connection.execute(_HEAD.with_for_update()).one()
        return Head(LabId(row.lab), row.position, row.hash, row.epoch, row.recorded_at)

    @property
    def known_position(self) -> int:
        """The highest position that this lab's log is known to have had when it was opened; 0 if it is not
        known. If it is above the head's position, the log has lost its end, because of a damaged disk or a
        restored older copy. It comes from a note in the lab's folder and from the sealed snapshot, so it may
        be too low. Raises StoreUnavailable."""
        if self._known is None:
            self._known = self._look_for_known()
        return self._known

    def accept_end(self) -> None:
        """A person has compared the bench with this log: its present end counts as complete."""
        self._known = 0
        self._files.begin_notes(0)

    def _look_for_known(self) -> int:
        """The highest known position of this log."""
        note, found = self._files.read_known_end(), self.read_snapshot_row()
        head = self.head()  # read after those two, because a kernel may be writing
        known = 0
        if note is not None and (note.lab == head.lab or not head.position):
            known = note.position
            with self._door:
                rows = self._backend.fetch(HASH, (note.position,))
            if rows and bytes(rows[0][0]).hex() != note.hash:
                _log.warning("log_is_another", position=note.position, hash_in_the_note=note.hash)
        if found is not None and found.genuine:
            known = max(known, found.position)
        if known > head.position:
            _log.error("log_was_longer", position=head.position, known=known)
        return known

    def find_holder(self) -> Holder:
        """The present kernel, and whether it lives. Nothing is written, and no other process waits. Raises
        StoreUnavailable."""
        with self._door:
            return find_holder(self._backend)

    def stand_by(self, name: str) -> None:
        """Show the kernel that a standby is ready; has to be called again every few seconds. Raises
        StoreUnavailable."""
        with self._door:
            self._backend.stand_by(name)

    def stand_down(self) -> None:
        """Stop showing that a standby is ready."""
        with self._door:
            self._backend.vacate()

    def standbys(self) -> list[str]:
        """The standbys that have shown in the last seconds that they are ready. Raises StoreUnavailable."""
        with self._door:
            return self._backend.standbys()

    def claim(self, lab: LabId, owner: str, lease_s: float) -> Head:
        """Become the lab's one kernel: raise the epoch and take the lease.

        ``lab`` is the id for an empty log. Any other log keeps its id, which is in the returned head. Raises
        Refused while another kernel lives, StoreUnavailable.
        """
        self._refuse_if_read_only()
        with self._door:
            self._backend.occupy(owner)
            try:
                with self._transaction() as connection:
                    claimed = self._take_over(connection, lab, owner, lease_s)
            except BaseException:
                self._epoch = None
                self._backend.vacate()
                raise
        self._epoch = claimed.epoch
        self._files.make_key()
        if self._known is None:
            self._known = self._look_for_known()
        self._keep_erasures(claimed.lab)
        # From now on the empty log belongs to a new lab.
        self._files.begin_notes(self._known if claimed.position else 0)
        return claimed

    def _keep_erasures(self, lab: LabId) -> None:
        """Note erasures of a kernel that died before it could note them, and erase again what an older copy
        of the database brought back."""
        try:
            known = self._files.erasures(lab)
        except BadInput as error:
            _log.error("erasures_not_read", why=str(error))
            return
        with self._door, self._backend.reading.connect() as connection:
            erased = read_erased(connection)
            back = read_words(connection, known.keys() - erased.keys())
        self._files.note_erasures(lab, {name: at for name, at in erased.items() if name not in known})
        if back:
            _log.warning("words_erased_again", number=len(back))
            rows = [(b"", known[name], name) for name in back]
            with self._door, self._transaction() as connection:
                self._backend.insert(connection, (), WordChanges((), rows))
            with self._door, self._turn:
                self._backend.scrub()

    def note_erasures(self) -> None:
        """Note in the lab's folder the erasures that are in this database. Raises StoreUnavailable."""
        known = self.erasures()
        with self._door, self._backend.reading.connect() as connection:
            found = {name: at for name, at in read_erased(connection).items() if name not in known}
        self._files.note_erasures(self._lab_id(), found)

    def erasures(self) -> dict[str, int]:
        """The erased words of this lab according to its folder, also of a newer copy of this log: references,
        and positions of the erasing events. Raises BadInput, StoreUnavailable."""
        return self._files.erasures(self._lab_id())

    def _take_over(self, connection: Connection, lab: LabId, owner: str, lease_s: float) -> Head:
        now = self._backend.now_ms
        row = connection.execute(
            _HEAD.add_columns(
                head.c.lease_owner, (head.c.lease_until - now).label("remaining")
            ).with_for_update()
        ).one()
        self._backend.take_over(row.epoch, row.lease_owner, row.remaining)
        kept = LabId(row.lab) if row.position else lab
        connection.execute(
            update(head).values(
                lab=kept, epoch=row.epoch + 1, lease_owner=owner, lease_until=now + int(lease_s * 1000)
            )
        )
        return Head(kept, row.position, row.hash, row.epoch + 1, row.recorded_at)

    def renew(self, epoch: int, lease_s: float) -> None:
        """Keep the lease. Raises Fenced if another kernel has taken over, StoreUnavailable."""
        until = self._backend.now_ms + int(lease_s * 1000)
        with self._door, self._transaction() as connection:
            done = connection.execute(update(head).where(head.c.epoch == epoch).values(lease_until=until))
            if done.rowcount != 1:
                raise self._explain_fenced()
            self._backend.keep(epoch)

    def release(self, epoch: int, *, to_standby: bool = False) -> None:
        """Release the lease. Nothing happens if another kernel has taken over already. With
        ``to_standby``, the head row keeps the name of its last kernel, by which the standby knows that it
        should take over."""
        values = {"lease_until": 0} if to_standby else {"lease_owner": "", "lease_until": 0}
        with self._door:
            try:
                with self._transaction() as connection:
                    connection.execute(update(head).where(head.c.epoch == epoch).values(**values))
            finally:
                self._epoch = None
                self._files.end_notes()
                self._backend.vacate()

    # -- writing ---------------------------------------------------------------------------

    def append(self, expected: Head, records: Sequence[Record]) -> Head:
        """Write records after ``expected``, all or none, synced to disk on return.

        Raises Fenced if the head is not the expected one, or if this store did not claim the lab. Raises
        StoreUnavailable if nothing was written, or if the outcome of the commit is not known (ask ``head``).
        Raises InvariantBroken if the database has such a record already, and ValueError if the records do
        not follow ``expected``. It is never retried.
        """
        if not records:
            return expected
        rows, words = rows_of(expected, records), make_changes(records)
        last = records[-1]
        after = Head(expected.lab, last.head.position, last.hash, expected.epoch, last.head.recorded_at)
        if expected.epoch != self._epoch:
            raise self._explain_fenced()
        with self._door, self._connection() as connection:
            if not self._backend.append(connection, expected, after, rows, words):
                raise self._explain_fenced()
        self._files.note(after)
        if words.erased:
            self._files.note_erasures(after.lab, {row[2]: row[1] for row in words.erased})
        return after

    def scrub(self) -> str:
        """Remove all erased words from the database's files. Returns why some may remain; empty if none does.
        Raises StoreUnavailable."""
        self._refuse_if_read_only()
        with self._door, self._turn:
            return self._backend.scrub()

    def save_snapshot(self, position: int, hash_: bytes, fingerprint: str, data: bytes) -> None:
        """Store a snapshot of the state, sealed with the lab's key; it replaces older ones. Without a key
        nothing is stored, because it would not be used. Raises StoreUnavailable."""
        self._refuse_if_read_only()
        if not self._files.key():
            return
        with self._door, self._transaction() as connection:
            lab = connection.execute(select(head.c.lab)).scalar_one()
            seal = self._files.seal_snapshot(lab, position, hash_, fingerprint, data)
            connection.execute(delete(snapshot))
            connection.execute(insert(snapshot).values((1, position, hash_, fingerprint, seal, data)))

    def hang_up(self) -> None:
        """Break off every call that waits for the database, in any thread; it raises StoreUnavailable. The
        function itself does not wait. Afterwards the outcome of the writer's last transaction is in doubt, as
        after a lost connection: ask ``head``. On SQLite there is no connection to a server; a thread that
        waits for a disk continues to wait."""
        self._backend.hang_up()

    def close(self) -> None:
        """Close every connection, and release the locks that make this process the kernel; the lease itself
        is ended by ``release``. Callers that still wait for the database get StoreUnavailable."""
        mine = self._turn.acquire(timeout=CLOSE_S)
        if not mine:
            self.hang_up()
            mine = self._turn.acquire(timeout=CLOSE_S)
        try:
            self._backend.reading.dispose()
            if mine:  # otherwise a thread hangs in it, and so does the end of the process
                self._drop_writer()
            self._epoch = None
            self._files.end_notes()
            self._backend.close()
        finally:
            if mine:
                self._turn.release()

    # -- inside ----------------------------------------------------------------------------

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        """One exclusive transaction on the writer's connection."""
        with self._connection() as connection, connection.begin():
            yield connection

    @contextmanager
    def _connection(self) -> Iterator[Connection]:
        """The writer's connection. After an unexpected error it is closed, because its effect is not
        known."""
        self._refuse_if_read_only()
        with self._turn:
            if self._writer is None:
                if self._doubtful:
                    self._backend.forget()
                self._writer = self._backend.writing.connect()
                self._doubtful = False
            try:
                yield self._writer
            except (Fenced, Refused):
                raise
            except BaseException:
                self._doubtful = True
                self._drop_writer()
                self._backend.reading.dispose()
                raise

    def _drop_writer(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.invalidate()
            finally:
                writer.close()

    def _explain_fenced(self) -> StoreError:
        return Fenced(
            f"Another kernel has taken over the lab in the {self.name}, or its log has moved on.",
            remedy="This kernel stops; start it again once the other one is stopped.",
        )

    def _refuse_if_read_only(self) -> None:
        if self._read_only:
            raise StoreUnavailable(
                f"The {self.name} was opened for reading only.", remedy="Open it for writing."
            )


def rows_of(expected: Head, records: Sequence[Record]) -> list[Row]:
    """The table's rows. Raises ValueError if the records do not follow the expected head."""
    rows: list[Row] = []
    position = expected.position
    recorded_at = expected.recorded_at
    for record in records:
        at = record.head
        position += 1
        if at.position != position or at.lab != expected.lab or at.recorded_at < recorded_at:
            raise ValueError(
                f"record {at.position} of lab {at.lab!r} at {at.recorded_at} ns does not follow position "
                f"{position - 1} of lab {expected.lab!r} at {recorded_at} ns"
            )
        recorded_at = at.recorded_at
        _lab, *fields = msgspec.structs.astuple(at)  # the columns are in the order of these fields
        rows.append((*fields, record.envelope, record.payload, record.hash))
    return rows
