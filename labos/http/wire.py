"""Requests and answers as bytes: what may be asked, how it is told, and what an error looks like."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from functools import wraps
from typing import Any, TypeVar

import msgspec
import structlog
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from labos.errors import BadInput, LabosError
from labos.http.arriving import TooLarge, TooMany, TooSlow
from labos.http.errors import body_of, status_of
from labos.http.limits import (
    DEEPEST,
    FORMS,
    LONGEST_NAME,
    LONGEST_PERSON,
    MOST_FILTERS,
    SMALL_BODY,
    WHOLE_NUMBERS,
    check_fields,
    check_person,
    check_text,
)
from labos.spec.misfits import plainly

SEND = "Send what docs/reference/http.md says."

T = TypeVar("T", bound=msgspec.Struct)
Handler = Callable[[Request], Awaitable[Response]]
_log = structlog.get_logger(__name__)


async def body(request: Request, kind: type[T], most: int = SMALL_BODY) -> T:
    """The request's JSON, checked against the limits. Raises BadInput."""
    raw = await request.app.state.arriving.read(request, most)
    try:
        told = msgspec.json.decode(raw or b"{}", type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadInput(f"The request cannot be read: {_wrong(error)}.", remedy=SEND) from None
    check_fields(told)
    return told


def _wrong(error: Exception) -> str:
    match error:
        case RecursionError():
            return f"it is nested more than {DEEPEST} levels deep"
        case UnicodeDecodeError():
            return "it is not UTF-8"
        case msgspec.MsgspecError():
            return plainly(error, FORMS)
    return str(error)


def checked(handler: Handler) -> Handler:
    """The handler, which sees only paths and queries that are within the limits."""

    @wraps(handler)
    async def check(request: Request) -> Response:
        for name, value in request.path_params.items():
            check_text(str(value), f"The {name} in the path", LONGEST_NAME)
        asked = request.query_params.multi_items()
        if len(asked) > MOST_FILTERS:
            raise BadInput(
                f"The query has {len(asked)} parameters; {MOST_FILTERS} are allowed.",
                remedy="Ask for less at once.",
            )
        for name, value in asked:
            check_text(value, f"The parameter {name[:40]!r}", LONGEST_NAME)
        return await handler(request)

    return check


def asker(request: Request) -> str:
    """Who asks, by the header LabOS-User. Raises BadInput."""
    name = check_text(header(request, "labos-user") or "application", "The header LabOS-User", LONGEST_PERSON)
    return check_person(name, "LabOS-User")


def key_of(request: Request) -> str:
    """The request's idempotency key; empty if it has none. Raises BadInput."""
    return check_text(header(request, "idempotency-key"), "The header Idempotency-Key", LONGEST_NAME)


def header(request: Request, name: str) -> str:
    """A header as text; people's names are UTF-8 there. Raises BadInput."""
    try:
        return request.headers.get(name, "").encode("latin-1").decode()
    except UnicodeDecodeError:
        raise BadInput(f"The header {name} is not UTF-8.", remedy="Send text.") from None


def number(request: Request, name: str, most: int = WHOLE_NUMBERS[1]) -> int:
    """A whole number of the query, 0 if it is left out. Raises BadInput."""
    try:
        found = max(int(request.query_params.get(name, 0)), 0)
    except ValueError:
        raise BadInput(f"{name!r} must be a whole number.", remedy="Write digits only.") from None
    if found > most:
        raise BadInput(f"{name!r} is more than {most}.", remedy="Ask for less at once.")
    return found


def seconds(request: Request, name: str) -> float:
    try:
        found = max(float(request.query_params.get(name, 0.0)), 0.0)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise BadInput(f"{name!r} must be a number of seconds.", remedy="Write it as 20 or 0.5.")
    return found


def story_of(story: msgspec.Struct) -> Any:
    data = msgspec.to_builtins(story)
    data.pop("flying", None)
    return data


def answer(value: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(value), status, media_type="application/json")


def refused(status: int, code: str, error: str, remedy: str) -> Response:
    """An answer to a request that nobody reads to its end: the connection is closed after it."""
    told = answer({"error": error, "remedy": remedy, "code": code, "details": []}, status)
    told.headers["connection"] = "close"
    return told


def encoded(data: bytes) -> Response:
    """An answer that is JSON already."""
    return Response(data, 200, media_type="application/json")


async def labos_error(request: Request, error: LabosError) -> Response:
    if isinstance(error, TooLarge | TooSlow | TooMany):
        status = 413 if isinstance(error, TooLarge) else 408 if isinstance(error, TooSlow) else 503
        return refused(status, "bad_input", error.message, error.remedy)
    return answer(body_of(error), status_of(error))


async def http_error(request: Request, error: HTTPException) -> Response:
    return answer({"error": error.detail, "remedy": "", "code": "http", "details": []}, error.status_code)


async def surprise(request: Request, error: Exception) -> Response:
    _log.error("request_failed", path=request.url.path, error=repr(error))
    text = f"LabOS failed on this request ({type(error).__name__})."
    remedy = "This is a fault of LabOS; its log tells more."
    return answer({"error": text, "remedy": remedy, "code": "internal", "details": []}, 500)
