"""The newest events of the log for all followers: read and encoded once, for any number of followers.

Newly committed events are kept here for a while. They are sent in pieces. The more followers there are, the
longer are the pauses between pieces, as each piece uses time of the kernel's process for each follower. A
follower that is behind the kept events reads the log itself, a page at a time and in turn with others. A
follower that accepts nothing is disconnected, with the position at which it can continue.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from labos.core.envelope import Record
from labos.core.structs import make_from
from labos.core.viewer import Viewer
from labos.core.words import list_references
from labos.http.restricted import RestrictedCampaigns
from labos.ports import EventLine, LogQuery
from labos.services.filters import is_of_type
from labos.services.shown import show_json
from labos.services.times import iso_time

if TYPE_CHECKING:
    # The process for followers starts without these imports.
    from labos.http.ends import StreamEnd
    from labos.runtime.ledger import Entry
    from labos.services.log import Log

PAGE = 1000
"""Events that are read from the log at once."""
PAGE_BYTES = 2 * 1024 * 1024
KEEP_ALIVE_S = 10.0
KEPT = 16 * 1024 * 1024
"""Bytes of encoded events that are kept."""
LARGEST_BACKLOG = 1024 * 1024
"""The largest number of bytes that wait for one follower; a follower with more is disconnected."""
PAUSE_S = 0.003
"""The pause between two pieces, for each follower."""
LONGEST_PAUSE_S = 1.0
STREAM_TYPE = "text/event-stream"
STREAM_HEADERS = {"cache-control": "no-store", "x-accel-buffering": "no"}
"""Proxies must neither delay a stream nor store it."""
RETRY = b"retry: 1000\n\n"
"""Milliseconds after which a browser connects again."""
WANTED_S = 60.0
"""How long new events are kept after the last request for them has ended."""


class StreamLine(msgspec.Struct, frozen=True):
    """An event in the form that is sent. ``data`` is its JSON, ``payload`` a part of it."""

    position: int
    type: str
    stream: str
    correlation: str
    actor: str
    payload: bytes
    data: bytes


class StreamFilter(msgspec.Struct, frozen=True):
    """The events that a follower wants, as in ``LogQuery``, and which campaigns it may see (``viewer``)."""

    types: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    correlation: str = ""
    actor: str = ""
    mentions: str = ""
    viewer: Viewer | None = None

    def takes(self, line: StreamLine) -> bool:
        return (
            (not self.types or any(is_of_type(line.type, name) for name in self.types))
            and (not self.streams or line.stream in self.streams)
            and (not self.correlation or line.correlation == self.correlation)
            and (not self.actor or line.actor == self.actor)
            and (not self.mentions or self._mentions_name(line))
        )

    def _mentions_name(self, line: StreamLine) -> bool:
        # In a payload, the text is encoded as JSON.
        return msgspec.json.encode(self.mentions)[1:-1] in line.payload or self.mentions in line.stream


class _Follower:
    """``after``: everything up to this position was sent or does not match. A follower that is ``live``
    receives new events directly."""

    def __init__(self, query: LogQuery, viewer: Viewer | None) -> None:
        self.query, self.after = query, query.after
        self.filter = make_from(StreamFilter, query, viewer=viewer)
        self.live = self.dropped = False
        self._pieces: list[bytes] = []
        self._size = 0
        self.sent = query.after
        self._woken = asyncio.Event()

    def give(self, piece: bytes, upto: int) -> None:
        """Add new events for it. If too many of them wait, the follower is disconnected."""
        if piece and self._size + len(piece) > LARGEST_BACKLOG:
            self.dropped, self.live = True, False
        else:
            self.after = max(self.after, upto)
            if piece:
                self._pieces.append(piece)
                self._size += len(piece)
        if piece:
            self._woken.set()

    def take(self) -> bytes:
        """Everything that waits for it."""
        pieces, self._pieces, self._size = self._pieces, [], 0
        self.sent = self.after
        return b"".join(pieces)

    def wake(self) -> None:
        self._woken.set()

    async def wait(self, timeout_s: float) -> bool:
        """Whether it was woken in time."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._woken.wait(), timeout_s)
        woken = self._woken.is_set()
        self._woken.clear()
        return woken


class Tail:
    """A kernel's listener. ``durable`` returns the last position on disk."""

    def __init__(self, log: Log, durable: Callable[[], int]) -> None:
        self._log, self._durable = log, durable
        self._restricted = RestrictedCampaigns(log)
        self._lines: deque[StreamLine] = deque()
        self._size = 0
        self._begin = self._end = self._flushed = 0
        self._followers: set[_Follower] = set()
        self._wanted_until = 0.0
        self._flush_at: asyncio.TimerHandle | None = None
        self._last_flush = 0.0
        self._turn = asyncio.Semaphore(1)
        self._waiting = 0
        self._closed = False

    # -- called by the kernel -----------------------------------------------------------------

    def on_committed(self, entries: Sequence[Entry]) -> None:
        self.add([entry.record for entry in entries])

    def add(self, records: Sequence[Record]) -> None:
        """Add the newest records, in order."""
        if not records:
            return
        self._restricted.learn(records)
        first, last = records[0].head.position, records[-1].head.position
        if not self._is_wanted():
            self._begin_at(last)
            return
        if first != self._end + 1:
            self._begin_at(first - 1)
        for record in records:
            line = _make_line(record)
            self._lines.append(line)
            self._size += len(line.data)
        self._end = last
        if not self._followers:
            self._flushed = self._end
        elif self._flush_at is None:
            loop = asyncio.get_running_loop()
            pause = min(len(self._followers) * PAUSE_S, LONGEST_PAUSE_S)
            self._flush_at = loop.call_at(max(self._last_flush + pause, loop.time()), self._flush)
        while self._size > KEPT and self._lines[0].position <= self._flushed:
            gone = self._lines.popleft()
            self._begin, self._size = gone.position, self._size - len(gone.data)

    def on_reopened(self) -> None:
        """The log was read again: it may contain events that this listener did not receive."""
        self._restricted.forget()
        self._begin_at(self._durable())

    def close(self) -> None:
        """Disconnect all followers."""
        self._closed = True
        for follower in self._followers:
            follower.wake()

    # -- called for requests -------------------------------------------------------------------

    async def read_page(
        self, query: LogQuery, *, stored: bool = False, viewer: Viewer | None = None
    ) -> bytes:
        """One page of events as JSON, and the position at which the next page begins. With the words beside
        the log in place of references, or as it is ``stored``; without the events that a ``viewer`` may not
        see. Raises StoreUnavailable."""
        self._note_interest()
        if viewer is not None:
            await self._restricted.read()
        mine = make_from(StreamFilter, query, viewer=viewer)
        upto = self._durable()
        if _is_open(query) and self._holds_after(query.after) and self._end == upto:
            found, full = _cut(line for line in self._list_since(query.after) if self._takes(mine, line))
        else:
            upto = upto if query.upto is None else min(upto, query.upto)
            found, full = await self._read(msgspec.structs.replace(query, upto=upto), mine)
        seen = found[-1].position if full else upto
        data = await self._show(b",".join(line.data for line in found), stored=stored)
        return b'{"events":[%b],"position":%d}' % (data, seen)

    async def follow(
        self,
        query: LogQuery,
        end: StreamEnd | None = None,
        *,
        stored: bool = False,
        viewer: Viewer | None = None,
    ) -> AsyncIterator[bytes]:
        """Server-sent events without end; or until their ``end``, or until the follower is too far behind."""
        self._note_interest()
        if viewer is not None:
            await self._restricted.read()
        me = _Follower(query, viewer)
        self._followers.add(me)
        if end is not None:
            end.when = me.wake
        try:
            while not self._closed and not (end is not None and end.has_come):
                piece = me.take()
                if piece:
                    yield await self._show(piece, stored=stored)
                elif me.dropped:
                    yield _make_last_line(me.sent)
                    return
                elif not me.live:
                    piece = await self._catch_up(me)
                    me.sent = me.after
                    if piece:
                        yield await self._show(piece, stored=stored)
                elif not await me.wait(KEEP_ALIVE_S):
                    yield b": %d\n\n" % me.after
        finally:
            self._followers.discard(me)

    # -- internal ------------------------------------------------------------------------------

    def _takes(self, wanted: StreamFilter, line: StreamLine) -> bool:
        return wanted.takes(line) and self._shows(wanted, line)

    def _encode(self, wanted: StreamFilter, lines: Iterable[StreamLine]) -> bytes:
        return _encode_lines(line for line in lines if self._takes(wanted, line))

    def _shows(self, wanted: StreamFilter, line: StreamLine) -> bool:
        return self._restricted.shows(wanted.viewer, line.type, line.stream, line.correlation)

    async def _show(self, data: bytes, *, stored: bool) -> bytes:
        """Replace references by the words beside the log. The words are not kept here, as they may be
        erased."""
        if stored or not list_references(data):
            return data
        return await asyncio.to_thread(show_json, self._log, data)

    async def _catch_up(self, me: _Follower) -> bytes:
        """The events that a follower has missed, or a page of them; it is live if there are no more."""
        if me.query.last is None and (me.after > self._end or self._holds_after(me.after)):
            piece = self._encode(me.filter, self._list_since(me.after))
            me.after, me.live = max(me.after, self._end), True
            return piece
        upto = self._durable()
        found, full = await self._read(
            msgspec.structs.replace(me.query, after=me.after, upto=upto), me.filter
        )
        me.query = msgspec.structs.replace(me.query, last=None)
        me.after = found[-1].position if full else max(upto, me.after)
        return _encode_lines(found)

    async def _read(self, query: LogQuery, wanted: StreamFilter) -> tuple[list[StreamLine], bool]:
        """A page of the log, and whether there may be more. Readers take turns; the more of them wait, the
        longer is the pause between two pages, so that the kernel can work."""
        if query.upto is not None and query.after >= query.upto:
            return [], False
        self._waiting += 1
        try:
            async with self._turn:
                begun = time.monotonic()
                found = await asyncio.to_thread(self._select_page, query, wanted)
                if self._waiting > 1:
                    await asyncio.sleep((time.monotonic() - begun) * min(self._waiting, 8))
                return found
        finally:
            self._waiting -= 1

    def _select_page(self, query: LogQuery, wanted: StreamFilter) -> tuple[list[StreamLine], bool]:
        lines = map(_make_line, self._log.select(query))
        return _cut(line for line in lines if self._shows(wanted, line))

    def _flush(self) -> None:
        """Send new events; the data for one filter is put together once."""
        self._flush_at, self._last_flush = None, asyncio.get_running_loop().time()
        new = self._list_since(self._flushed)
        self._flushed = self._end
        pieces: dict[StreamFilter, bytes] = {}
        for follower in self._followers:
            if not follower.live or follower.after >= self._end:
                continue
            mine = follower.filter
            if new and follower.after >= new[0].position:
                piece = self._encode(mine, (line for line in new if line.position > follower.after))
            elif mine in pieces:
                piece = pieces[mine]
            else:
                piece = pieces[mine] = self._encode(mine, new)
            follower.give(piece, self._end)

    def _list_since(self, after: int) -> list[StreamLine]:
        """The kept lines after a position; the position itself must be kept too."""
        skipped = max(after - self._begin, 0)
        return list(islice(self._lines, skipped, None))

    def _holds_after(self, after: int) -> bool:
        return self._begin <= after <= self._end

    def _begin_at(self, position: int) -> None:
        """Keep nothing; followers that were up to date read the log for events that may be missing."""
        self._lines.clear()
        self._size = 0
        self._begin = self._end = self._flushed = position
        for follower in self._followers:
            if follower.live and follower.after < position:
                follower.live = False
                follower.wake()

    def _note_interest(self) -> None:
        """There is a request: new events are kept from now on."""
        if not self._is_wanted():
            self._begin_at(self._durable())
        self._wanted_until = time.monotonic() + WANTED_S

    def _is_wanted(self) -> bool:
        return bool(self._followers) or time.monotonic() < self._wanted_until


def _make_line(record: Record) -> StreamLine:
    head = record.head
    line = make_from(
        EventLine,
        head,
        time=iso_time(head.recorded_at),
        payload=msgspec.Raw(record.payload),
        hash=record.hash.hex(),
    )
    return make_from(StreamLine, head, payload=record.payload, data=msgspec.json.encode(line))


def _cut(lines: Iterable[StreamLine]) -> tuple[list[StreamLine], bool]:
    """As many lines as fit into a page, and whether the page is full."""
    found: list[StreamLine] = []
    size = 0
    for line in lines:
        found.append(line)
        size += len(line.data)
        if len(found) == PAGE or size > PAGE_BYTES:
            return found, True
    return found, False


def _encode_lines(lines: Iterable[StreamLine]) -> bytes:
    return b"".join(b"id: %d\ndata: %b\n\n" % (line.position, line.data) for line in lines)


def _is_open(query: LogQuery) -> bool:
    """Whether it requests everything after a position."""
    return query.last is None and query.upto is None and query.since_ns is None and query.until_ns is None


def _make_last_line(after: int) -> bytes:
    why = (
        "This client reads events more slowly than they are written. Connect again with the header "
        "Last-Event-ID."
    )
    data = msgspec.json.encode({"error": why, "after": after})
    return b"id: %d\nevent: dropped\ndata: %b\n\n" % (after, data)
