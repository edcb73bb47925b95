"""Requests and answers as bytes: what may be asked, how it is told, and what an error looks like."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
import structlog
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from labos.core.envelope import Record
from labos.errors import BadInput, LabosError
from labos.http.errors import body_of, status_of
from labos.services.times import iso_time
from labos.spec.misfits import plainly

MAX_BODY = 96 * 1024 * 1024

T = TypeVar("T")
_log = structlog.get_logger(__name__)


async def body(request: Request, kind: type[T]) -> T:
    """The request's JSON. Raises BadInput."""
    if int(request.headers.get("content-length") or 0) > MAX_BODY:
        raise BadInput(f"The request is larger than {MAX_BODY // 1024 // 1024} MB.")
    raw = await request.body()
    try:
        return msgspec.json.decode(raw or b"{}", type=kind)
    except msgspec.MsgspecError as error:
        raise BadInput(
            f"The request cannot be read: {plainly(error)}.", remedy="Send the JSON of the docs."
        ) from None


def named(value: str, field: str) -> str:
    if not value.strip():
        raise BadInput(f"The field {field!r} is empty.", remedy="Say who asks.")
    return value


def number(request: Request, name: str, default: int) -> int:
    try:
        return max(int(request.query_params.get(name, default)), 0)
    except ValueError:
        raise BadInput(f"{name!r} must be a whole number.") from None


def seconds(request: Request, name: str) -> float:
    try:
        return max(float(request.query_params.get(name, 0.0)), 0.0)
    except ValueError:
        raise BadInput(f"{name!r} must be a number of seconds.") from None


def story_of(story: msgspec.Struct) -> Any:
    data = msgspec.to_builtins(story)
    data.pop("flying", None)
    return data


def event(record: Record) -> dict[str, Any]:
    head = record.head
    return {
        "position": head.position,
        "time": iso_time(head.recorded_at),
        "recorded_at": head.recorded_at,
        "type": head.type,
        "schema": head.schema,
        "version": head.version,
        "stream": head.stream,
        "actor": head.actor,
        "correlation": head.correlation,
        "causation": head.causation,
        "id": head.id,
        "payload": msgspec.Raw(record.payload),
    }


def answer(value: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(value), status, media_type="application/json")


async def labos_error(request: Request, error: LabosError) -> Response:
    return answer(body_of(error), status_of(error))


async def http_error(request: Request, error: HTTPException) -> Response:
    return answer({"error": error.detail, "remedy": "", "code": "http", "details": []}, error.status_code)


async def surprise(request: Request, error: Exception) -> Response:
    _log.error("request_failed", path=request.url.path, error=repr(error))
    text = f"LabOS failed on this request ({type(error).__name__})."
    remedy = "This is a fault of LabOS; its log tells more."
    return answer({"error": text, "remedy": remedy, "code": "internal", "details": []}, 500)
