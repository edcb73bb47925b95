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
import zlib
from collections.abc import Sequence
from typing import Literal, Protocol

import msgspec
import structlog

from labos.clock import Ids
from labos.core.effects import AnyEffect
from labos.errors import JournalDamaged, NodeError
from labos.node.protocol import Outcome, Unacknowledged

FORMAT = 1
COMPACT_BYTES = 256 * 1024
"""Below this size a journal is not worth compacting."""

_REMEDY = "Find out what stands where, then move the journal away; the node begins a new one."

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


# -- records ---------------------------------------------------------------------------------


class Record(msgspec.Struct, frozen=True, tag_field="t", omit_defaults=True):
    """Something the node must not forget."""


class Opened(Record, frozen=True, tag="journal"):
    """The first record."""

    id: str
    format: int


class Bound(Record, frozen=True, tag="lab"):
    """The node belongs to this lab."""

    lab: str


class EpochRaised(Record, frozen=True, tag="epoch"):
    epoch: int


class Restarted(Record, frozen=True, tag="restarted"):
    """The node began anew; what ran before was interrupted."""


class Accepted(Record, frozen=True, tag="accepted"):
    """This attempt will be carried out as soon as this record is on disk; in a compacted
    journal, it may have been ``interrupted`` since. ``effects`` is what it was to do to labware; journals of
    earlier versions do not say."""

    action: str
    attempt: int
    position: int
    name: str
    interrupted: bool = False
    effects: tuple[AnyEffect, ...] | None = None


class Handled(Record, frozen=True, tag="handle"):
    """The device calls the attempt by this name."""

    action: str
    attempt: int
    handle: str


class Ended(Record, frozen=True, tag="ended"):
    action: str
    attempt: int
    outcome: Outcome


class Voided(Record, frozen=True, tag="void"):
    """No attempt of this action up to ``attempt`` may start any more."""

    action: str
    attempt: int
    position: int


class Pruned(Record, frozen=True, tag="pruned"):
    """The lab knows the end of everything requested up to ``position``; a kernel of ``epoch`` said
    so (0: not noted)."""

    position: int
    epoch: int = 0


class Rewound(Record, frozen=True, tag="rewound"):
    """The lab's log was put back from an older copy: what a kernel of ``epoch`` requests is counted
    from behind ``position`` on. Requests of older kernels are fenced."""

    position: int
    epoch: int


_Known = Opened | Bound | EpochRaised | Restarted | Accepted | Handled | Ended | Voided | Pruned | Rewound
_Line = list[_Known]
_encoder = msgspec.json.Encoder()
_decoder = msgspec.json.Decoder(_Line)


# -- memory ----------------------------------------------------------------------------------


class Attempt(msgspec.Struct):
    """An attempt that was accepted. ``why`` is what the node knows of an interruption."""

    action: str
    attempt: int
    position: int
    name: str
    status: Literal["running", "finished", "interrupted"] = "running"
    outcome: Outcome | None = None
    handle: str = ""
    why: str = ""
    effects: tuple[AnyEffect, ...] | None = None


class _Action(msgspec.Struct):
    attempts: dict[int, Attempt] = {}
    void: int = 0
    void_position: int = 0


class Journal:
    """See the module. Made by ``Journal.open``."""

    def __init__(self, file: JournalFile) -> None:
        self.id = ""
        self.lab = ""
        self.epoch = 0
        self.pruned = 0
        self.pruned_by = 0
        self.broken = ""
        self._file = file
        self._actions: dict[str, _Action] = {}
        self._queue: list[Record] = []
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
    def of(cls, data: bytes) -> Journal:
        """The journal that a file holds, to look at only. Raises JournalDamaged."""
        journal = cls(_NOWHERE)
        journal._replay(read_lines(data)[0])
        return journal

    # -- questions ---------------------------------------------------------------------------

    def known(self, action: str, attempt: int) -> Attempt | None:
        """This attempt, if it was accepted and not forgotten."""
        entry = self._actions.get(action)
        return entry.attempts.get(attempt) if entry else None

    def earlier(self, action: str, attempt: int) -> Attempt | None:
        """The latest accepted attempt below ``attempt``."""
        entry = self._actions.get(action)
        numbers = [n for n in entry.attempts if n < attempt] if entry else []
        return entry.attempts[max(numbers)] if entry and numbers else None

    def is_void(self, action: str, attempt: int) -> bool:
        """Whether this attempt never ran and can never run."""
        entry = self._actions.get(action)
        if entry is None or attempt in entry.attempts:
            return False
        return attempt <= entry.void or any(n > attempt for n in entry.attempts)

    def is_forgotten(self, position: int) -> bool:
        """Whether requests that old are refused unread."""
        return position <= self.pruned

    def open_attempts(self) -> list[Attempt]:
        """All that is not forgotten, in the order in which it was accepted."""
        return [attempt for entry in self._actions.values() for attempt in entry.attempts.values()]

    def unacknowledged(self) -> list[Unacknowledged]:
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
        if self.known(action, attempt) or self.is_void(action, attempt) or self.is_forgotten(position):
            raise ValueError(f"attempt {attempt} of {action} must not start")
        self._record(Accepted(action, attempt, position, name, effects=effects))
        return self._actions[action].attempts[attempt]

    def note_handle(self, action: str, attempt: int, handle: str) -> None:
        self._record(Handled(action, attempt, handle))

    def end(self, action: str, attempt: int, outcome: Outcome) -> None:
        self._record(Ended(action, attempt, outcome))

    def take_up(self, attempt: Attempt) -> None:
        """What was interrupted goes on. Not written down: if the node dies again, it is interrupted
        again."""
        if attempt.status == "interrupted":
            attempt.status, attempt.why = "running", ""

    def give_up(self, attempt: Attempt, why: str) -> None:
        """Nobody can say how a running attempt ended. Not written down, for the same reason."""
        if attempt.status == "running":
            attempt.status, attempt.why = "interrupted", why

    def void(self, action: str, attempt: int, position: int) -> None:
        """Let no attempt up to ``attempt`` start any more."""
        entry = self._actions.get(action)
        if entry is None or attempt > entry.void:
            self._record(Voided(action, attempt, position))

    def withdraw(self, action: str, attempt: int) -> None:
        """Take back an acceptance that could not be written: nothing moved, nothing will."""
        entry = self._actions[action]
        position = entry.attempts.pop(attempt).position
        self._apply(Voided(action, attempt, position))

    def prune(self, position: int) -> None:
        """Forget what was requested up to ``position`` and is not running; refuse it from now on."""
        if position > self.pruned or self._spent(position):
            self._record(Pruned(position, self.epoch))

    def rewind(self, position: int) -> None:
        """Take requests from behind ``position`` on again, although more was acknowledged. What was
        requested up to there stays forgotten."""
        if position < self.pruned:
            self._record(Rewound(position, self.epoch))

    async def synced(self) -> None:
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
        """After a failed write: write everything that is in memory anew. Raises JournalError."""
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
            await self.synced()
        except JournalError:
            pass
        await self._file.close()

    # -- inside ------------------------------------------------------------------------------

    async def _load(self, ids: Ids) -> None:
        data = await self._file.read()
        records, good = read_lines(data)
        self._replay(records)
        if not self.id:
            self.id = ids.new()
            good = self._snapshot()
        if good != data:
            if data:
                _log.warning("journal_tail_cut", journal=self.id, cut=len(data) - len(good))
            await self._file.replace(good)
        self._size = len(good)
        if any(attempt.status == "running" for attempt in self.open_attempts()):
            self._record(Restarted())
            await self.synced()

    def _record(self, record: Record) -> None:
        self._apply(record)
        self._queue.append(record)
        self._recorded += 1

    def _replay(self, records: list[Record]) -> None:
        if records and not isinstance(records[0], Opened):
            raise JournalDamaged("The node's journal has lost its beginning.", remedy=_REMEDY)
        for record in records:
            try:
                self._apply(record)
            except KeyError as error:
                raise JournalDamaged(
                    f"The node's journal tells the end of an action without its beginning ({error}).",
                    remedy=_REMEDY,
                ) from error

    def _apply(self, record: Record) -> None:
        match record:
            case Opened():
                if record.format != FORMAT:
                    raise JournalDamaged(
                        f"The node's journal has format {record.format}; this LabOS reads {FORMAT}.",
                        remedy="Install the LabOS that wrote it.",
                    )
                self.id = record.id
            case Bound():
                self.lab = record.lab
            case EpochRaised():
                self.epoch = record.epoch
            case Restarted():
                for broken_off in self.open_attempts():
                    if broken_off.status == "running":
                        broken_off.status = "interrupted"
            case Accepted(action, attempt, position, name, interrupted, effects):
                entry = self._actions.setdefault(action, _Action())
                status: Literal["running", "interrupted"] = "interrupted" if interrupted else "running"
                entry.attempts[attempt] = Attempt(action, attempt, position, name, status, effects=effects)
            case Handled():
                self._actions[record.action].attempts[record.attempt].handle = record.handle
            case Ended():
                ended = self._actions[record.action].attempts[record.attempt]
                ended.status, ended.outcome = "finished", record.outcome
            case Voided():
                entry = self._actions.setdefault(record.action, _Action())
                entry.void = max(entry.void, record.attempt)
                entry.void_position = max(entry.void_position, record.position)
            case Pruned():
                if record.position > self.pruned:
                    self.pruned, self.pruned_by = record.position, record.epoch
                self._forget(record.position)
            case Rewound():
                self.pruned, self.pruned_by = record.position, record.epoch

    def _spent(self, position: int) -> list[str]:
        """Actions of which something can be forgotten."""
        return [
            action
            for action, entry in self._actions.items()
            if (not entry.attempts and entry.void_position <= position)
            or any(_is_spent(attempt, position) for attempt in entry.attempts.values())
        ]

    def _forget(self, position: int) -> None:
        for action in self._spent(position):
            entry = self._actions[action]
            entry.attempts = {n: a for n, a in entry.attempts.items() if not _is_spent(a, position)}
            if not entry.attempts and entry.void_position <= position:
                del self._actions[action]

    async def _write(self) -> None:
        """Write the queue as one line; when the file has grown, write it anew without its dead."""
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
        records: list[Record] = [Opened(self.id, FORMAT)]
        if self.lab:
            records.append(Bound(self.lab))
        if self.epoch:
            records.append(EpochRaised(self.epoch))
        if self.pruned:
            records.append(Pruned(self.pruned, self.pruned_by))
        for action, entry in self._actions.items():
            if entry.void:
                records.append(Voided(action, entry.void, entry.void_position))
            for a in entry.attempts.values():
                interrupted = a.status == "interrupted"
                records.append(Accepted(action, a.attempt, a.position, a.name, interrupted, a.effects))
                if a.handle:
                    records.append(Handled(action, a.attempt, a.handle))
                if a.outcome is not None:
                    records.append(Ended(action, a.attempt, a.outcome))
        return b"".join(write_line([record]) for record in records)


def _is_spent(attempt: Attempt, position: int) -> bool:
    return attempt.position <= position and attempt.status != "running"


def knows_more(acknowledged: int, by: int, end: int, starts: Sequence[tuple[int, int]]) -> bool:
    """Whether a node was told of more than a log holds: everything up to ``acknowledged``, by a kernel
    of epoch ``by`` (0: not noted). The log ends at ``end``; ``starts`` are the epochs of its kernels and
    the positions where they began. What a kernel acknowledged stands before the next one began."""
    next_begins = next((position for epoch, position in starts if by and epoch > by), end + 1)
    return acknowledged >= next_begins


# -- lines -----------------------------------------------------------------------------------


def write_line(records: list[Record]) -> bytes:
    """One line of a journal."""
    body = _encoder.encode(records)
    return b"%08x %b\n" % (zlib.crc32(body), body)


def read_lines(data: bytes) -> tuple[list[Record], bytes]:
    """All records, and the bytes that hold them without a torn end. Raises JournalDamaged."""
    records: list[Record] = []
    start = 0
    while start < len(data):
        newline = data.find(b"\n", start)
        line = data[start:] if newline < 0 else data[start:newline]
        body = _body(line)
        if body is None and newline < 0:
            # Perhaps only the mark of its end is gone, and somebody was answered for it.
            line = line[:-1]
            body = _body(line)
        if body is None:
            # What a power cut leaves of the last write has no end, or sectors of zeros in it.
            if newline < 0 or (newline + 1 == len(data) and b"\0" in line):
                return records, data[:start]
            raise JournalDamaged(
                f"The node's journal is damaged at byte {start}: it cannot be known what the device did.",
                remedy=_REMEDY,
            )
        try:
            records.extend(_decoder.decode(body))
        except msgspec.MsgspecError as error:
            raise JournalDamaged(
                f"The node's journal has a record at byte {start} that this LabOS cannot read: {error}.",
                remedy="Install the LabOS that wrote it.",
            ) from error
        if newline < 0:
            return records, data[:start] + line + b"\n"
        start = newline + 1
    return records, data


def _body(line: bytes) -> bytes | None:
    """The line's content if its checksum is right."""
    checksum, _, body = line.partition(b" ")
    return body if checksum == b"%08x" % zlib.crc32(body) else None
