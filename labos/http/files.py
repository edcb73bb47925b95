"""Files over HTTP, whole or in part (RFC 9110, section 14)."""

from __future__ import annotations

import asyncio
import re

from starlette.requests import Request
from starlette.responses import Response

from labos.http.problems import make_problem
from labos.http.wire import send_problem
from labos.ports import BlobStore

_RANGE = re.compile(r"bytes=(\d{0,19})-(\d{0,19})")


async def send_file(request: Request, digest: str, blobs: BlobStore) -> Response:
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
        refusal = send_problem(make_problem("range_not_satisfiable", words, "Request another range."))
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
