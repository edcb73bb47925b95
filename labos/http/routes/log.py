"""The log, and the files that results name."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator

import msgspec
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from labos.core.structs import make_from
from labos.http import wire
from labos.http.limits import WHOLE_NUMBERS
from labos.http.operation import Call, Method, read
from labos.http.problems import make_problem
from labos.http.queries import EventFilter, EventsQuery, OfFile
from labos.http.tail import RETRY, STREAM_HEADERS, STREAM_TYPE
from labos.http.viewers import Follow
from labos.http.words import STORED
from labos.ports import BlobStore, EventLine, LogQuery


class EventPage(msgspec.Struct, frozen=True):
    """Committed events in order. For the next page, ask with ``after`` = ``position``."""

    events: list[EventLine]
    position: int


CONNECTION = "labos.connection"
"""The key in a request's scope with its connection."""

_RANGE = re.compile(r"bytes=(\d{0,19})-(\d{0,19})")


@read(
    route="GET /events",
    client=Method("events", by_hand=True),
    answer=EventPage,
    summary="Committed events in order",
)
async def list_events(call: Call, query: EventsQuery) -> Response:
    """One page, at most 1000 events. For the next page, ask with `after` = `position` of the answer."""

    def is_there() -> bool:
        return call.kernel.durable > query.after

    if query.wait and not is_there():
        await call.service.feed.wait_until(is_there, query.wait, each_s=0.01)
    times = {"since_ns": query.since or None, "until_ns": query.until or None}
    wanted = _make_log_query(query, last=query.last or None, upto=query.upto or None, **times)
    if query.stored:
        call.request.scope[STORED] = True
    return wire.answer_encoded(
        await call.service.tail.read_page(wanted, stored=query.stored, viewer=call.viewer)
    )


@read(
    route="GET /events/stream",
    client=Method("events", by_hand=True),
    answer=str,
    media=(STREAM_TYPE,),
    headers=("Last-Event-ID",),
    summary="Committed events as a stream",
)
async def follow_events(call: Call, query: EventFilter) -> Response:
    """A stream of server-sent events without end: `id` is the position, `data` is the event. The header
    `Last-Event-ID` takes precedence over `after`, because a browser that connects again repeats its first
    `after`. There may be many clients: a separate process serves them. With more clients, events are sent in
    larger groups, at least once a second. A client that falls more than 1 MB behind is disconnected; its last
    message has the type `dropped`, and an `id` at which it can continue. A client that reads nothing for 30 s
    is also disconnected. The stream ends with the client's session or token."""
    wanted = _make_log_query(query)
    known = wire.read_header(call.request, "last-event-id")
    if known.isascii() and known.isdecimal() and int(known[:20]) <= WHOLE_NUMBERS[1]:
        wanted = msgspec.structs.replace(wanted, after=int(known))
    if await _hand_over(call, wanted, stored=query.stored):
        return Response()  # not sent: the connection belongs to the other process now
    stream = _stream(call, wanted, stored=query.stored)
    return StreamingResponse(stream, headers=dict(STREAM_HEADERS), media_type=STREAM_TYPE)


async def _stream(call: Call, query: LogQuery, *, stored: bool) -> AsyncIterator[bytes]:
    yield RETRY
    ends, shown = call.api.ends, call.who.credential
    end = ends.begin(shown.key, ends.find_length_s(shown)) if shown is not None else None
    try:
        async for piece in call.service.tail.follow(query, end, stored=stored, viewer=call.viewer):
            yield piece
    finally:
        if shown is not None and end is not None:
            ends.forget(shown.key, end)


@read(
    route="GET /files/{sha256}",
    client=Method("file", by_hand=True),
    answer=bytes,
    media=("application/octet-stream",),
    headers=("Range", "If-Range", "If-None-Match"),
    other_statuses={206: "The requested part", 304: "The file has not changed"},
    problems=("range_not_satisfiable", "log_damaged"),
    summary="The content of a file",
)
async def get_file(call: Call, path: OfFile) -> Response:
    """A file that a result names (`{"file": "plate.png", "sha256": …, "bytes": …}`). With `Range:
    bytes=0-1023` (or `1024-`, or `-512` for the end), only this part. The content never changes; its SHA-256
    is its `ETag`."""
    return await _send_file(call.request, path.sha256, call.service.parts.blobs)


async def _send_file(request: Request, digest: str, blobs: BlobStore) -> Response:
    """The file with a SHA-256, or the requested range of it. A file with this name never changes. Raises
    NotFound, LogDamaged, StoreUnavailable."""
    headers = {"accept-ranges": "bytes", "etag": f'"{digest}"', "cache-control": "private, immutable"}
    headers["x-content-type-options"] = "nosniff"  # never a page of this server
    if request.headers.get("if-none-match") == headers["etag"]:
        return Response(status_code=304, headers=headers)
    data = await asyncio.to_thread(blobs.get, digest)
    asked = _RANGE.fullmatch(request.headers.get("range", "").replace(" ", ""))
    # One range is answered. Several ranges, another unit, or a range of another file are answered with the
    # whole file.
    if asked is None or request.headers.get("if-range", headers["etag"]) != headers["etag"]:
        return Response(data, headers=headers, media_type="application/octet-stream")
    part = find_part(len(data), *asked.groups())
    if part is None:
        words = f"The file has {len(data)} bytes, but none in the requested range."
        refusal = wire.send_problem(make_problem("range_not_satisfiable", words, "Request another range."))
        refusal.headers["content-range"] = f"bytes */{len(data)}"
        return refusal
    first, end = part
    headers["content-range"] = f"bytes {first}-{end - 1}/{len(data)}"
    return Response(data[first:end], 206, headers, "application/octet-stream")


def find_part(size: int, first: str, last: str) -> tuple[int, int] | None:
    """The first byte of a range, and the byte after its last one; None if the range is not in a file of this
    size."""
    if first:
        begin, end = int(first), min(int(last), size - 1) + 1 if last else size
    else:
        begin, end = max(size - int(last or 0), 0), size
    return (begin, end) if begin < end else None


async def _hand_over(call: Call, query: LogQuery, *, stored: bool) -> bool:
    """Whether the process for followers has taken over the connection."""
    viewers, connection = call.service.viewers, call.request.scope.get(CONNECTION)
    if viewers is None or connection is None:
        return False
    shown, durable = call.who.credential, call.kernel.durable
    key, lasts_s = (shown.key, call.api.ends.find_length_s(shown)) if shown is not None else ("", 0.0)
    follow = Follow(query, key, lasts_s, stored, call.viewer)
    return bool(await connection.give_away(lambda s: viewers.take_over(s, follow, durable)))


def _make_log_query(query: EventFilter, **more: int | None) -> LogQuery:
    return make_from(LogQuery, query, types=tuple(query.type), streams=tuple(query.stream), **more)
