"""A process that updates the search index and answers queries, so that the kernel's process does neither. It
reads a line of JSON for each query and writes one. It ends when its input ends. Like every projector, it may
be killed at any time.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

import msgspec

from labos.audit.database import open_audit
from labos.audit.find import LogPlace, Refusal, SearchQuery, SearchReply, SearchResult, find
from labos.audit.projector import Projector
from labos.audit.query import open_asker
from labos.clock import SystemClock
from labos.errors import BadInput, LabosError, StoreUnavailable
from labos.store import open_blobs, open_store

ENOUGH_S = 4.0
"""The longest time for updating the index before an answer; the next query continues the update."""

NICE = 10


class _TimeUsed(Exception):
    """The update is interrupted, because a query waits."""


class Index:
    """The opened search index of a log."""

    def __init__(self, begin: LogPlace) -> None:
        """Raises LabosError."""
        self._url = begin.database
        self._store = open_store(begin.database, create=False, read_only=True, home=Path(begin.home))
        self._projector = Projector(self._store, open_audit(begin.database), open_blobs(begin.blobs))

    def answer(self, question: SearchQuery) -> SearchResult:
        """Update the index for a limited time, and answer the query. Raises LabosError."""
        clock = SystemClock()
        began = clock.monotonic()
        log_position = self._store.head().position

        def stop_in_time(position: int, head: int) -> None:
            if position < head and clock.monotonic() - began > ENOUGH_S:
                raise _TimeUsed

        # A replica of PostgreSQL cannot be written: its index is as recent as that of its primary.
        with suppress(_TimeUsed, StoreUnavailable):
            self._projector.catch_up(stop_in_time)
        with open_asker(self._url) as asker:
            return find(asker, question, log_position)


def main() -> None:
    """Answer until the input ends."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    lines = iter(sys.stdin.buffer.readline, b"")
    begin = msgspec.json.decode(next(lines), type=LogPlace)
    index: Index | None = None
    for line in lines:
        try:
            index = index or Index(begin)
            reply = SearchReply(index.answer(msgspec.json.decode(line, type=SearchQuery)))
        except LabosError as error:
            reply = SearchReply(refusal=Refusal(error.message, error.remedy, isinstance(error, BadInput)))
        sys.stdout.buffer.write(msgspec.json.encode(reply) + b"\n")
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
