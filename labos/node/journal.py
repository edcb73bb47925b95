"""A node's durable memory: the attempts that it accepted, and their outcomes.

The journal is a file of lines, ``<CRC-32> <JSON list of records>``. A line is one write and one sync, so it
holds everything that happened while the previous one was being written. The node has never answered anything
that depends on a torn last line, so this line is cut off. Damage anywhere else means that the node cannot
know what it has done, and it must not start.

Queries are answered from memory, at once. A record takes effect for every later query immediately, and is on
disk when ``sync`` returns. Before that, the node may send no answer and move nothing.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Protocol

import structlog

from labos.clock import Ids
from labos.core.effects import AnyEffect
from labos.errors import BadInput, NodeError
from labos.node._memory import Attempt, Memory
from labos.node._records import (
    FORMAT,
    Accepted,
    Bound,
    Corrected,
    Ended,
    EpochRaised,
    GivenUp,
    Handled,
    Opened,
    Pruned,
    Record,
    Restarted,
    Rewound,
    TakenUp,
    Voided,
    Withdrawn,
    encode,
    read_lines,
    write_line,
)
from labos.node.protocol import Outcome

__all__ = ["Attempt", "Journal", "JournalError", "JournalFile", "Memory", "knows_more", "read_journal"]

COMPACT_BYTES = 256 * 1024
"""Below this size a journal is not worth compacting."""

_log = structlog.get_logger(__name__)


class JournalFile(Protocol):
    """The storage of a journal. Only one call at a time."""

    async def read(self) -> bytes:
        """All bytes; empty if there are none yet."""

    async def append(self, data: bytes) -> None:
        """Append bytes; they are on disk on return. Raises OSError, and then the old end is unchanged."""

    async def replace(self, data: bytes) -> None:
        """Replace all bytes by ``data``, all or nothing; on disk on return."""

    async def close(self) -> None: ...


class JournalError(NodeError):
    """The node's journal cannot be used, so nothing may move."""


class Journal:
    """The journal of a node; see the module's docstring. Made by ``Journal.open``. ``memory`` answers what it
    holds."""

    def __init__(self, file: JournalFile) -> None:
        self.memory = Memory()
        self.broken = ""
        self._file = file
        self._queue: list[bytes] = []
        self._recorded = 0
        self._durable = 0
        self._size = 0
        self._compact_at = COMPACT_BYTES
        self._writing: asyncio.Task[None] | None = None
        self._mending = asyncio.Lock()

    @classmethod
    async def open(cls, file: JournalFile, ids: Ids) -> Journal:
        """Read a journal, or begin one. Attempts that had not ended are ``interrupted``.

        Raises JournalDamaged; then the file is released.
        """
        journal = cls(file)
        try:
            await journal._load(ids)
        except BaseException:
            await file.close()
            raise
        return journal

    # -- changes: in force at once, durable after ``synced`` ---------------------------------

    def bind(self, lab: str) -> None:
        """Bind the node to a lab permanently."""
        if self.memory.lab and self.memory.lab != lab:
            raise ValueError(f"journal {self.memory.id} belongs to lab {self.memory.lab}, not {lab}")
        if not self.memory.lab:
            self._record(Bound(lab))

    def raise_epoch(self, epoch: int) -> None:
        if epoch > self.memory.epoch:
            self._record(EpochRaised(epoch))

    def accept(
        self,
        action: str,
        attempt: int,
        position: int,
        name: str,
        effects: tuple[AnyEffect, ...] | None = None,
    ) -> Attempt:
        """Raises ValueError for an attempt that must not start."""
        memory = self.memory
        if memory.find(action, attempt) or memory.is_void(action, attempt) or memory.is_forgotten(position):
            raise ValueError(f"attempt {attempt} of {action} must not start")
        self._record(Accepted(action, attempt, position, name, effects=effects))
        return memory.actions[action].attempts[attempt]

    def note_handle(self, action: str, attempt: int, handle: str) -> None:
        self._record(Handled(action, attempt, handle))

    def end(self, action: str, attempt: int, outcome: Outcome) -> None:
        self._record(Ended(action, attempt, outcome))

    def take_up(self, attempt: Attempt) -> None:
        """An interrupted attempt continues. If the node dies again, it is interrupted again."""
        if attempt.status == "interrupted":
            self._record(TakenUp(attempt.action, attempt.attempt))

    def give_up(self, attempt: Attempt, why: str) -> None:
        """It cannot be found out how a running attempt ended."""
        if attempt.status == "running":
            self._record(GivenUp(attempt.action, attempt.attempt, why))

    def forbid_attempts(self, action: str, attempt: int, position: int) -> None:
        """Make all attempts up to ``attempt`` void: they can never start."""
        entry = self.memory.actions.get(action)
        if attempt > (entry.void if entry else 0):
            self._record(Voided(action, attempt, position))

    def withdraw(self, action: str, attempt: int) -> None:
        """Take back an acceptance that could not be written: nothing has moved, and nothing will move."""
        self._record(Withdrawn(action, attempt))

    def prune(self, position: int) -> None:
        """Forget requests up to ``position`` that are not running, and refuse them from now on."""
        if position > self.memory.pruned or self.memory.is_spent(position):
            self._record(Pruned(position, self.memory.epoch))

    def rewind(self, position: int) -> None:
        """Accept requests after ``position`` again, although later ones were acknowledged. Requests up to
        ``position`` stay forgotten."""
        if position < self.memory.pruned:
            self._record(Rewound(position, self.memory.epoch))

    def correct(self, *, epoch: int, position: int, by: str, at_ns: int, why: str) -> None:
        """Correct the epoch and the acknowledged position at the request of a person (``labos node
        reset-epoch``). Raises BadInput where one would increase."""
        for what, wanted, known in (
            ("epoch", epoch, self.memory.epoch),
            ("position", position, self.memory.pruned),
        ):
            if not 0 <= wanted <= known:
                raise BadInput(
                    f"The journal has the {what} {known}: it cannot be set to {wanted}.",
                    remedy=f"Name one that is not greater. A kernel with a greater {what} needs no help.",
                )
        self._record(Corrected(epoch, position, by, at_ns, why))

    async def sync(self) -> None:
        """Wait until all records until now are on disk. Raises JournalError."""
        wanted = self._recorded
        while self._durable < wanted:
            if self.broken:
                raise JournalError(
                    f"The node's journal cannot be written ({self.broken}).",
                    remedy="Free the disk, then reset the module.",
                )
            if self._writing is None:
                self._writing = asyncio.get_running_loop().create_task(self._write())
            # If one caller is cancelled, the write of the others must continue.
            await asyncio.shield(self._writing)

    async def mend(self) -> None:
        """After a failed write, write the whole memory again. Raises JournalError."""
        if not self.broken:
            return
        # Of two such writes, the later one would not contain the records written after the earlier one.
        async with self._mending:
            if not self.broken:
                return
            recorded, self._queue = self._recorded, []
            data = self._snapshot()
            try:
                await self._file.replace(data)
            except OSError as error:
                raise JournalError(f"The node's journal cannot be written ({error}).") from error
            self._durable, self._size, self.broken = recorded, len(data), ""

    async def close(self) -> None:
        """Write the remaining records and release the file."""
        try:
            await self.sync()
        except JournalError:
            pass
        await self._file.close()

    # -- inside ------------------------------------------------------------------------------

    async def _load(self, ids: Ids) -> None:
        data = await self._file.read()
        records, good = read_lines(data)
        self.memory.replay(records)
        if not self.memory.id:
            self.memory.apply(Opened(ids.new(), FORMAT))
            good = self._snapshot()
        if good != data:
            if data:
                _log.warning("journal_tail_cut", journal=self.memory.id, cut=len(data) - len(good))
            await self._file.replace(good)
        self._size = len(good)
        if any(attempt.status == "running" for attempt in self.memory.list_attempts()):
            self._record(Restarted())
            await self.sync()

    def _record(self, record: Record) -> None:
        line = encode(record)  # a record that cannot be written must not be remembered either
        self.memory.apply(record)
        self._queue.append(line)
        self._recorded += 1

    async def _write(self) -> None:
        """Write the queue as one line; when the file has grown, rewrite it without forgotten actions."""
        batch, self._queue = self._queue, []
        recorded = self._recorded
        written = False
        try:
            if self._size > self._compact_at:
                data = self._snapshot()
                await self._file.replace(data)
                self._size = len(data)
                self._compact_at = max(COMPACT_BYTES, 2 * self._size)
            else:
                data = write_line(batch)
                await self._file.append(data)
                self._size += len(data)
            self._durable, written = recorded, True
        except Exception as error:
            self.broken = str(error) or type(error).__name__
            _log.error("journal_unwritable", journal=self.memory.id, error=self.broken)
        finally:
            if not written and not self.broken:
                self.broken = "the last write was interrupted"
            self._writing = None

    def _snapshot(self) -> bytes:
        """The whole journal in the form of a new one, without forgotten attempts."""
        return b"".join(write_line([encode(record)]) for record in self.memory.list_records())


def read_journal(data: bytes) -> Memory:
    """The memory in a journal's file. Raises JournalDamaged."""
    memory = Memory()
    memory.replay(read_lines(data)[0])
    return memory


def knows_more(acknowledged: int, by: int, end: int, starts: Sequence[tuple[int, int]]) -> bool:
    """Whether a node received an acknowledgement of more events than a log has. A kernel of epoch ``by`` (0:
    not noted) acknowledged everything up to ``acknowledged``. The log ends at ``end``; ``starts`` are the
    epochs of its kernels and the positions where they began. A kernel can only acknowledge positions before
    the start of the next kernel."""
    next_begins = next((position for epoch, position in starts if by and epoch > by), end + 1)
    return acknowledged >= next_begins
