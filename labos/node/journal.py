"""A node's durable memory: which attempts it accepted, and what became of them.

The journal is a file of lines, ``<CRC-32> <JSON list of records>``. A line is one write and one
sync, so it holds everything that happened while the previous one was being written. A torn last
line was never answered for and is cut off; damage anywhere else means that the node cannot know
what it has done, and it must not start.

Questions are answered from memory, at once. What was recorded takes effect for every later
question immediately, and is on disk when ``synced`` returns: nothing may be answered to anybody,
and nothing may move, before that.
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
from labos.node.protocol import Outcome, Unacknowledged

__all__ = ["Attempt", "Journal", "JournalError", "JournalFile", "knows_more"]

COMPACT_BYTES = 256 * 1024
"""Below this size a journal is not worth compacting."""

_log = structlog.get_logger(__name__)


class JournalFile(Protocol):
    """Where a journal is kept. One call at a time."""

    async def read(self) -> bytes:
        """Everything, empty if there is nothing yet."""

    async def append(self, data: bytes) -> None:
        """Write behind the end; on disk on return. Raises OSError, leaving the old end."""

    async def replace(self, data: bytes) -> None:
        """Put ``data`` in place of everything, all or nothing; on disk on return."""

    async def close(self) -> None: ...


class _Nowhere:
    """The file of a journal that is only looked at."""

    async def read(self) -> bytes:
        return b""

    async def append(self, data: bytes) -> None:
        raise OSError("this journal is only looked at")

    async def replace(self, data: bytes) -> None:
        raise OSError("this journal is only looked at")

    async def close(self) -> None:
        pass


_NOWHERE = _Nowhere()


class JournalError(NodeError):
    """The node's journal cannot be used, so nothing may move."""


class Journal:
    """See the module. Made by ``Journal.open``."""

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

        Raises JournalDamaged, and lets the file go then.
        """
        journal = cls(file)
        try:
            await journal._load(ids)
        except BaseException:
            await file.close()
            raise
        return journal

    @classmethod
    def read(cls, data: bytes) -> Journal:
        """The journal that a file holds, to look at only. Raises JournalDamaged."""
        journal = cls(_NOWHERE)
        journal.memory.replay(read_lines(data)[0])
        return journal

    # -- questions ---------------------------------------------------------------------------

    @property
    def id(self) -> str:
        return self.memory.id

    @property
    def lab(self) -> str:
        """The lab that the node belongs to; empty before the first one spoke to it."""
        return self.memory.lab

    @property
    def epoch(self) -> int:
        """Of the newest kernel that the node obeys."""
        return self.memory.epoch

    @property
    def pruned(self) -> int:
        """The position up to which the lab acknowledged."""
        return self.memory.pruned

    @property
    def pruned_by(self) -> int:
        """The epoch of the kernel that acknowledged; 0 if that is not noted."""
        return self.memory.pruned_by

    @property
    def seen(self) -> int:
        """The greatest position of a request that the node has seen, forgotten or not."""
        return self.memory.seen

    def find(self, action: str, attempt: int) -> Attempt | None:
        """This attempt, if it was accepted and not forgotten."""
        entry = self.memory.actions.get(action)
        return entry.attempts.get(attempt) if entry else None

    def find_earlier(self, action: str, attempt: int) -> Attempt | None:
        """The latest accepted attempt below ``attempt``."""
        entry = self.memory.actions.get(action)
        numbers = [n for n in entry.attempts if n < attempt] if entry else []
        return entry.attempts[max(numbers)] if entry and numbers else None

    def find_last_attempt(self, action: str) -> int:
        """The greatest number of an attempt, accepted or void, that is remembered; 0 if none is."""
        entry = self.memory.actions.get(action)
        return max(entry.void, *entry.attempts, 0) if entry else 0

    def is_void(self, action: str, attempt: int) -> bool:
        """Whether this attempt never ran and can never run."""
        entry = self.memory.actions.get(action)
        if entry is None or attempt in entry.attempts:
            return False
        return attempt <= entry.void or any(n > attempt for n in entry.attempts)

    def is_forgotten(self, position: int) -> bool:
        """Whether requests that old are refused unread."""
        return position <= self.pruned

    def open_attempts(self) -> list[Attempt]:
        """All that is not forgotten, in the order in which it was accepted."""
        return self.memory.list_attempts()

    def list_unacknowledged(self) -> list[Unacknowledged]:
        """``open_attempts`` as they are reported."""
        return [
            Unacknowledged(a.action, a.attempt, a.name, a.status, a.handle, a.position, a.effects)
            for a in self.open_attempts()
        ]

    # -- changes: in force at once, durable after ``synced`` ---------------------------------

    def bind(self, lab: str) -> None:
        """Belong to a lab for good."""
        if self.lab and self.lab != lab:
            raise ValueError(f"journal {self.id} belongs to lab {self.lab}, not {lab}")
        if not self.lab:
            self._record(Bound(lab))

    def raise_epoch(self, epoch: int) -> None:
        if epoch > self.epoch:
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
        if self.find(action, attempt) or self.is_void(action, attempt) or self.is_forgotten(position):
            raise ValueError(f"attempt {attempt} of {action} must not start")
        self._record(Accepted(action, attempt, position, name, effects=effects))
        return self.memory.actions[action].attempts[attempt]

    def note_handle(self, action: str, attempt: int, handle: str) -> None:
        self._record(Handled(action, attempt, handle))

    def end(self, action: str, attempt: int, outcome: Outcome) -> None:
        self._record(Ended(action, attempt, outcome))

    def take_up(self, attempt: Attempt) -> None:
        """What was interrupted goes on. If the node dies again, it is interrupted again."""
        if attempt.status == "interrupted":
            self._record(TakenUp(attempt.action, attempt.attempt))

    def give_up(self, attempt: Attempt, why: str) -> None:
        """Nobody can say how a running attempt ended."""
        if attempt.status == "running":
            self._record(GivenUp(attempt.action, attempt.attempt, why))

    def forbid_attempts(self, action: str, attempt: int, position: int) -> None:
        """Let no attempt up to ``attempt`` start any more."""
        entry = self.memory.actions.get(action)
        if attempt > (entry.void if entry else 0):
            self._record(Voided(action, attempt, position))

    def withdraw(self, action: str, attempt: int) -> None:
        """Take back an acceptance that could not be written: nothing moved, nothing will."""
        self._record(Withdrawn(action, attempt))

    def prune(self, position: int) -> None:
        """Forget what was requested up to ``position`` and is not running; refuse it from now on."""
        if position > self.pruned or self.memory.is_spent(position):
            self._record(Pruned(position, self.epoch))

    def rewind(self, position: int) -> None:
        """Take requests from behind ``position`` on again, although more was acknowledged. What was
        requested up to there stays forgotten."""
        if position < self.pruned:
            self._record(Rewound(position, self.epoch))

    def correct(self, *, epoch: int, position: int, by: str, at_ns: int, why: str) -> None:
        """Put the epoch and the acknowledged position right, by a person's word (``labos node
        reset-epoch``). Raises BadInput where one would rise."""
        for what, wanted, known in (("epoch", epoch, self.epoch), ("position", position, self.pruned)):
            if not 0 <= wanted <= known:
                raise BadInput(
                    f"The journal has the {what} {known}: it cannot be set to {wanted}.",
                    remedy=f"Name one that is not greater. A kernel with a greater {what} needs no help.",
                )
        self._record(Corrected(epoch, position, by, at_ns, why))

    async def sync(self) -> None:
        """Wait until everything recorded so far is on disk. Raises JournalError."""
        wanted = self._recorded
        while self._durable < wanted:
            if self.broken:
                raise JournalError(
                    f"The node's journal cannot be written ({self.broken}).",
                    remedy="Free the disk, then reset the module.",
                )
            if self._writing is None:
                self._writing = asyncio.get_running_loop().create_task(self._write())
            # A caller that is cancelled must not take the others' write with it.
            await asyncio.shield(self._writing)

    async def mend(self) -> None:
        """After a failed write: write everything that is in memory again. Raises JournalError."""
        if not self.broken:
            return
        # Of two at once, the later one's picture would lack what was written after the earlier.
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
        """Write what is left and let the file go."""
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
        if not self.id:
            self.memory.apply(Opened(ids.new(), FORMAT))
            good = self._snapshot()
        if good != data:
            if data:
                _log.warning("journal_tail_cut", journal=self.id, cut=len(data) - len(good))
            await self._file.replace(good)
        self._size = len(good)
        if any(attempt.status == "running" for attempt in self.open_attempts()):
            self._record(Restarted())
            await self.sync()

    def _record(self, record: Record) -> None:
        line = encode(record)  # what cannot be written must not be remembered either
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
            _log.error("journal_unwritable", journal=self.id, error=self.broken)
        finally:
            if not written and not self.broken:
                self.broken = "the last write was broken off"
            self._writing = None

    def _snapshot(self) -> bytes:
        """The whole journal as one that was just written; what is forgotten is left out."""
        return b"".join(write_line([encode(record)]) for record in self.memory.list_records())


def knows_more(acknowledged: int, by: int, end: int, starts: Sequence[tuple[int, int]]) -> bool:
    """Whether a node has been told of more events than a log holds: everything up to ``acknowledged``, by
    a kernel of epoch ``by`` (0: not noted). The log ends at ``end``; ``starts`` are the epochs of its
    kernels and the positions where they began. What a kernel acknowledged stands before the next one
    began."""
    next_begins = next((position for epoch, position in starts if by and epoch > by), end + 1)
    return acknowledged >= next_begins
