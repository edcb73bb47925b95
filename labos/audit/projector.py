"""Projects a log to its tables, from their present position. Rows and position are written in one
transaction, so that nothing is left out or repeated if the projector dies at any time. It does not write to
the log, and the kernel does not wait for it.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import structlog

from labos.audit._rows import RowChanges, convert_to_seconds
from labos.audit.database import AuditDatabase, Mark
from labos.audit.projection import Projection
from labos.core.erasure import WordsErased
from labos.ports import BlobStore, Head
from labos.services.log import Log

BATCH = 10_000
"""The number of events in a batch."""

_log = structlog.get_logger(__name__)

ShowProgress = Callable[[int, int], None]
"""Called with the position of the tables and of the log."""


class _WordsErased(Exception):
    """The tables may hold words that were erased."""


class Projector:
    """Several projectors may work on the same tables: the second continues at the position of the first. With
    a ``ShownLog``, the tables contain people's words until these are erased."""

    def __init__(self, log: Log, database: AuditDatabase, blobs: BlobStore | None = None) -> None:
        self._log, self._database = log, database
        self._rows = RowChanges(database.load)
        self._projection = Projection(self._rows, blobs)
        self._remembered = Mark()
        """The mark to which the rows in memory belong."""

    def catch_up(self, show_progress: ShowProgress | None = None) -> int:
        """Project all events in the log; returns its position. Tables of another log, or with more events
        than this one, are made again; so are tables that may contain words which were erased since. Raises
        StoreUnavailable, LogTooNew, LogDamaged."""
        head = self._log.head()
        mark = self._database.prepare()
        if not self._is_of(mark, head):
            self._database.reset()
            mark = self._database.mark()
        if mark != self._remembered:  # another projector has written meanwhile
            self._rows.forget()
        begun = mark.position
        with _pause_cycle_search():
            while mark.position < head.position:
                try:
                    mark = self._carry(mark, min(mark.position + BATCH, head.position), begun)
                except _WordsErased:
                    mark = self._forget_erased()
                    begun = 0  # records that are read from now on do not contain them
                if show_progress is not None:
                    show_progress(mark.position, head.position)
        return mark.position

    def _carry(self, mark: Mark, upto: int, begun: int) -> Mark:
        """Project one batch; returns the mark of the tables. Raises _WordsErased if words were erased that
        the tables, which were at ``begun`` before, may contain."""
        after = mark
        try:
            for record in self._log.read(mark.position, upto):
                if begun and record.head.type == WordsErased.TYPE:
                    raise _WordsErased
                self._projection.take(record)
            head = record.head
            after = Mark(head.lab, head.position, record.hash.hex(), convert_to_seconds(head.recorded_at))
            written = self._database.write(mark, after, self._rows)
        except BaseException:
            self._rows.forget()
            raise
        if written:
            self._rows.mark_written()
            self._remembered = after
            return after
        self._rows.forget()
        return self._database.mark()

    def _forget_erased(self) -> Mark:
        """Make the tables again without erased words, because it is not known which rows contain them."""
        self._rows.forget()
        if left := self._database.forget():
            _log.warning("erased_words_may_be_left", why=left)
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
def _pause_cycle_search() -> Iterator[None]:
    """Switch off the search for reference cycles: there are many rows without cycles, and the search would
    take a third of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
