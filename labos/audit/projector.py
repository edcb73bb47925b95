"""Carries a log over into the tables beside it, from where they are.

Rows and position are written in one transaction, so whenever the projector dies, nothing of the log is left
out and nothing comes twice. Nothing of it writes to the log, or is waited for by the kernel.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from labos.audit._rows import Rows, seconds
from labos.audit.database import AuditDatabase, Mark
from labos.audit.projection import Projection
from labos.ports import BlobStore, Head
from labos.services.log import Log

BATCH = 10_000
"""Events that are written at once."""

Tell = Callable[[int, int], None]
"""Is told how far the tables are, and how far the log."""


class Projector:
    """Several may work on the same tables: whoever comes second begins again where the first one is."""

    def __init__(self, log: Log, database: AuditDatabase, blobs: BlobStore | None = None) -> None:
        self._log, self._database = log, database
        self._rows = Rows(database.load)
        self._projection = Projection(self._rows, blobs)
        self._remembered = Mark()
        """What the rows in memory are of."""

    def catch_up(self, tell: Tell | None = None) -> int:
        """Carry over all that is in the log now; returns its position. Tables that are of another log, or
        know more than this one, are made anew. Raises StoreUnavailable, LogTooNew, LogDamaged."""
        head = self._log.head()
        mark = self._database.prepare()
        if not self._is_of(mark, head):
            self._database.reset()
            mark = self._database.mark()
        if mark != self._remembered:  # another projector has been here
            self._rows.forget()
        with _no_search_for_cycles():
            while mark.position < head.position:
                mark = self._carry(mark, min(mark.position + BATCH, head.position))
                if tell is not None:
                    tell(mark.position, head.position)
        return mark.position

    def _carry(self, mark: Mark, upto: int) -> Mark:
        """One batch; returns where the tables are then."""
        after = mark
        try:
            for record in self._log.read(mark.position, upto):
                self._projection.take(record)
            head = record.head
            after = Mark(head.lab, head.position, record.hash.hex(), seconds(head.recorded_at))
            written = self._database.write(mark, after, self._rows)
        except BaseException:
            self._rows.forget()
            raise
        if written:
            self._rows.written()
            self._remembered = after
            return after
        self._rows.forget()
        return self._database.mark()

    def _is_of(self, mark: Mark, head: Head) -> bool:
        """Whether the tables come from this log."""
        if not mark.position:
            return True
        if mark.position > head.position:
            return False
        record = next(self._log.read(mark.position - 1, mark.position), None)
        return record is not None and record.hash.hex() == mark.hash


@contextmanager
def _no_search_for_cycles() -> Iterator[None]:
    """Rows hold no cycles, and there are many: to look for some again and again takes a third of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
