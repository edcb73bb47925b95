"""Finds out which requests are in the log: the first event of each has the request's mark as its causation.

A client without an answer sends its request again with the same Idempotency-Key. A running kernel remembers
the answer. A kernel that was started later, and an API process whose kernel is away, find out from the log
whether the request was carried out. The mark is followed by a digest that distinguishes the request from
others with the same key.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Sequence
from contextvars import ContextVar
from typing import Protocol

import structlog

from labos.runtime.ledger import Entry

PREFIX = "request:"
"""No event id begins with this."""

MARK: ContextVar[str] = ContextVar("mark", default="")
"""The mark of the request that is being carried out; empty if it needs none."""

LOOKED_AT = 50_000
"""At a start, so many of the last records are searched for marks."""

MOST = 50_000
"""The largest number of known marks."""

_log = structlog.get_logger(__name__)


class MarkedLog(Protocol):
    """A log that finds records by the first part of their causation."""

    def list_caused_by(self, prefix: str, last: int) -> list[tuple[int, str]]: ...


class Marks:
    """A kernel's listener; ``begin`` reads the records of earlier kernels."""

    def __init__(self, log: MarkedLog) -> None:
        self._log = log
        self._known: OrderedDict[str, tuple[int, str]] = OrderedDict()
        self._reading: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Read the marks of the last records, in the background."""
        self._reading = asyncio.get_running_loop().create_task(self._read())

    async def find(self, mark: str) -> int:
        """The position of the first event of a request; 0 if it was not carried out. Raises
        StoreUnavailable."""
        while self._reading is not None:
            reading = self._reading
            await asyncio.shield(reading)  # raises if the log cannot be read
            if self._reading is reading:
                self._reading = None
        return self._known.get(mark, (0, ""))[0]

    def find_digest(self, mark: str) -> str:
        """The text after a known mark: the first part of a digest; empty in older logs."""
        return self._known[mark][1]

    async def close(self) -> None:
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.wait({self._reading})

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            if entry.record.head.causation.startswith(PREFIX):
                self._note(entry.record.head.causation, entry.position)

    def on_reopened(self) -> None:
        """The log may have records that were not known to be on disk."""
        self.begin()

    async def _read(self) -> None:
        for position, mark in await asyncio.to_thread(self._log.list_caused_by, PREFIX, LOOKED_AT):
            self._note(mark, position)

    def _note(self, causation: str, position: int) -> None:
        mark, _, asked = causation.removeprefix(PREFIX).partition(":")
        self._known.setdefault(PREFIX + mark, (position, asked))
        while len(self._known) > MOST:
            self._known.popitem(last=False)
