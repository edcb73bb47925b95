"""Requests and answers as bytes: how requests are read, with limits on the size, duration and number of their
bodies, and how answers and problems are sent."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from typing import Any, TypeVar

import msgspec
import structlog
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from labos.errors import BadInput, LabosError, NotSignedIn, TooManyTries
from labos.http.limits import (
    DEEPEST,
    FORMS,
    LARGEST_BODIES,
    LONGEST_NAME,
    LONGEST_PERSON,
    MOST_FILTERS,
    asker_of,
    check_fields,
    check_person,
    check_text,
)
from labos.http.problems import MEDIA_TYPE, Problem, make_problem, make_problem_of_error
from labos.spec.mismatch import explain_plainly

SEND = "See docs/reference/http.md for the format."
OF_STATUS = {403: "forbidden", 404: "not_found", 405: "method_not_allowed"}
"""The problems that the router finds."""

POSITION = "labos-position"
"""The header of an answer with the last known position of the log; in a request, the position that the answer
must include."""

UNREAD = "labos.unread"
"""The key in a request's scope that says that its body was not read to its end."""

FIRST_S = 20.0
"""How long a body may take, in addition to the time that its size needs."""
SLOWEST = 64 * 1024
"""Bytes in a second: a slower body is refused."""
DRAINED = 8 * 1024 * 1024
DRAINED_S = 1.0
"""How long the rest of a refused request is still read. If the connection was closed while the client was
sending, it would be reset, and the client might not receive the reason."""

T = TypeVar("T", bound=msgspec.Struct)
_log = structlog.get_logger(__name__)


class TooLarge(BadInput):
    """The request is too large."""


class TooSlow(BadInput):
    """The request's body did not come in time."""


class TooMany(BadInput):
    """Too many large requests are being sent to the lab at the same time."""


async def drain(pieces: AsyncIterator[bytes]) -> None:
    """Read and discard the rest of a request for a moment."""
    size = 0
    with contextlib.suppress(TimeoutError, ClientDisconnect):
        async with asyncio.timeout(DRAINED_S):
            async for piece in pieces:
                size += len(piece)
                if size > DRAINED:
                    return


class BodyReader:
    """The bodies that are being read."""

    def __init__(self) -> None:
        self._bytes = 0

    async def read(self, request: Request, most: int) -> bytes:
        """The whole body. Raises TooLarge as soon as it exceeds ``most``, TooSlow, TooMany."""
        length = request.headers.get("content-length", "")
        body = bytearray()
        loop = asyncio.get_running_loop()
        begun = loop.time()
        pieces = request.stream()
        try:
            if length.isdecimal() and int(length[:19]) > most:
                await drain(pieces)
                raise _make_too_large_error(most)
            while True:
                async with asyncio.timeout_at(begun + FIRST_S + len(body) / SLOWEST):
                    piece = await anext(pieces, None)
                if piece is None:
                    return bytes(body)
                body += piece
                self._bytes += len(piece)
                if len(body) > most:
                    await drain(pieces)
                    raise _make_too_large_error(most)
                if self._bytes > LARGEST_BODIES and self._bytes > len(body):
                    raise TooMany("The lab gets too many requests at once.", remedy="Ask again.")
        except TimeoutError:
            raise TooSlow(
                f"The request's body was not sent within {loop.time() - begun:.0f} s.",
                remedy="Send the whole body at once.",
            ) from None
        except ClientDisconnect:
            raise BadInput("The connection ended before the whole request was sent.") from None
        finally:
            self._bytes -= len(body)


def _make_too_large_error(most: int) -> TooLarge:
    size = f"{most // 1024} KB" if most < 1024 * 1024 else f"{most // 1024 // 1024} MB"
    return TooLarge(f"The request is larger than {size}.", remedy="Send less, or keep data in a file.")


async def read_body(request: Request, arriving: BodyReader, kind: type[T], most: int, asker: str) -> T:
    """The request's JSON, checked against the limits. The signed-in user replaces the name in the field
    ``asker``. Raises BadInput."""
    raw = await arriving.read(request, most)
    try:
        body = msgspec.json.decode(raw or b"{}", type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadInput(f"The request cannot be read: {_explain_error(error)}.", remedy=SEND) from None
    field = asker_of(kind)
    if asker and field:
        setattr(body, field, asker)
    check_fields(body)
    return body


def read_path(request: Request, kind: type[T]) -> T:
    """The names in the path. Raises BadInput."""
    for name, value in request.path_params.items():
        check_text(str(value), f"The {name} in the path", LONGEST_NAME)
    return msgspec.convert(request.path_params, kind)


def read_query(request: Request, kind: type[T] | None, lists: frozenset[str]) -> T | None:
    """The parameters of the query. Those in ``lists`` may be repeated; of the others the last one counts.
    Raises BadInput, also for an unknown parameter."""
    asked = request.query_params.multi_items()
    if len(asked) > MOST_FILTERS:
        raise BadInput(
            f"The query has {len(asked)} parameters; {MOST_FILTERS} are allowed.",
            remedy="Use fewer parameters.",
        )
    values: dict[str, Any] = {}
    for name, value in asked:
        check_text(value, f"The parameter {name[:40]!r}", LONGEST_NAME)
        if name in lists:
            values.setdefault(name, []).append(value)
        else:
            values[name] = value
    if kind is None:
        if values:
            name = next(iter(values))[:40]
            raise BadInput(f"The parameter {name!r} is not known here.", remedy=SEND)
        return None
    try:
        return msgspec.convert(values, kind, strict=False)
    except msgspec.MsgspecError as error:
        raise BadInput(f"The query cannot be read: {_explain_error(error)}.", remedy=SEND) from None


def _explain_error(error: Exception) -> str:
    match error:
        case RecursionError():
            return f"it is nested more than {DEEPEST} levels deep"
        case UnicodeDecodeError():
            return "it is not UTF-8"
        case msgspec.MsgspecError():
            return explain_plainly(error, FORMS)
        case _:
            return str(error)


def read_asker(request: Request) -> str:
    """The requesting user from the header LabOS-User. Raises BadInput."""
    name = check_text(
        read_header(request, "labos-user") or "application", "The header LabOS-User", LONGEST_PERSON
    )
    return check_person(name, "LabOS-User")


def read_key(request: Request) -> str:
    """The request's idempotency key; empty if it has none. Raises BadInput."""
    return check_text(read_header(request, "idempotency-key"), "The header Idempotency-Key", LONGEST_NAME)


def read_position(request: Request) -> int:
    """The position in the log that the client knows; 0 if it names none. Raises BadInput."""
    text = request.headers.get(POSITION, "0")
    if not (text.isascii() and text.isdecimal() and len(text) <= 19):
        raise BadInput(f"The header LabOS-Position is {text[:40]!r}.", remedy="Write a whole number.")
    return int(text)


def read_header(request: Request, name: str) -> str:
    """A header as text; names of people are encoded as UTF-8 there. Raises BadInput."""
    try:
        return request.headers.get(name, "").encode("latin-1").decode()
    except UnicodeDecodeError:
        raise BadInput(f"The header {name} is not UTF-8.", remedy="Send text.") from None


def answer(value: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(value), status, media_type="application/json")


def answer_encoded(data: bytes) -> Response:
    """An answer that is already encoded as JSON."""
    return Response(data, 200, media_type="application/json")


def send_problem(found: Problem, *, close: bool = False) -> Response:
    """A problem document. ``close``: the request is not read to its end, so the connection is closed."""
    headers = {"connection": "close"} if close else None
    return Response(msgspec.json.encode(found), found.status, headers, MEDIA_TYPE)


async def answer_labos_error(request: Request, error: LabosError) -> Response:
    unread = isinstance(error, TooLarge | TooSlow | TooMany) or request.scope.get(UNREAD, False)
    found = send_problem(make_problem_of_error(error), close=unread)
    if isinstance(error, NotSignedIn):
        found.headers["www-authenticate"] = 'Bearer realm="LabOS"'
    if isinstance(error, TooManyTries):
        found.headers["retry-after"] = str(math.ceil(error.wait_s))
    return found


async def answer_http_error(request: Request, error: HTTPException) -> Response:
    code, path = OF_STATUS.get(error.status_code, "bad_input"), request.url.path[:LONGEST_NAME]
    details = {
        "not_found": f"There is nothing at {path!r}.",
        "method_not_allowed": f"{path!r} does not support {request.method[:20]!r}.",
    }
    found = send_problem(make_problem(code, details.get(code, error.detail)))
    found.headers.update(error.headers or {})
    return found


async def report_fault(request: Request, error: Exception) -> Response:
    _log.error("request_failed", path=request.url.path, error=repr(error))
    text = f"LabOS failed on this request ({type(error).__name__})."
    return send_problem(make_problem("internal", text, "This is a fault of LabOS; see its log for details."))
