"""HTTP to a foreign node. The important distinction is between not sent and perhaps carried out. A request
that was not sent is a failure without effects. A request without an answer may have been carried out: it
raises ``NoResponse``, and the caller has to find out. Connections are not kept between requests, because the
failure of a stale connection looks like a lost answer.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Collection
from typing import Any

import httpx

from labos.adapter._decode import read_json_text
from labos.adapter._keepalive import make_options
from labos.errors import DeviceError
from labos.node.secrets import read_secret

NOT_SENT = (
    httpx.ConnectError,
    httpx.ConnectTimeout,
    httpx.PoolTimeout,
    httpx.UnsupportedProtocol,
    httpx.InvalidURL,
    httpx.LocalProtocolError,
)
_OF_THE_WIRE = ("content-encoding", "content-length", "transfer-encoding")
GATEWAY = (502, 504)
"""Statuses with which a proxy reports that it got no answer from the node."""

NOT_TAKEN = (401, 403, 405, 406, 407, 411, 413, 414, 415, 421, 426, 429, 431)
"""Statuses with which a server refuses a request before anything is done (RFC 9110, RFC 6585)."""

LARGEST_ANSWER = 256 * 1024 * 1024
"""The largest number of bytes of an answer: the size of the largest file of a node."""

PIECE = 64 * 1024
"""The least number of bytes of an answer in the time for which a server may be silent."""

SHOWN = 300
"""Characters of an answer that a message quotes."""

CONNECT_S = 5.0
READ_S = 10.0


class NoResponse(Exception):
    """No answer came; the request may have been carried out."""


class HttpClient:
    """One foreign node's address. ``authorization`` is the value of that header; if the computer fails during
    the wait for an answer, this is noticed after ``patience_s``."""

    def __init__(self, address: str, authorization: str = "", *, patience_s: float) -> None:
        self.address = address.rstrip("/")
        self._read_s = READ_S
        headers = {"Authorization": authorization} if authorization else {}
        self._client = httpx.AsyncClient(
            headers=headers,
            timeout=httpx.Timeout(READ_S, connect=CONNECT_S),
            transport=httpx.AsyncHTTPTransport(
                limits=httpx.Limits(max_keepalive_connections=0),
                trust_env=False,
                socket_options=make_options(patience_s),
            ),
            trust_env=False,
        )

    async def close(self) -> None:
        await self._client.aclose()

    async def send(
        self, method: str, path: str, *, read_s: float | None = 0.0, **options: Any
    ) -> httpx.Response:
        """Send a request; returns the answer with any status. ``read_s`` is how long the server may be silent
        (0: as for a query; None: without limit). Raises DeviceError (``none``) if the request was not sent,
        Lost if it may have been."""
        read_s = self._read_s if read_s == 0.0 else read_s
        timeout = httpx.Timeout(read_s, connect=CONNECT_S)
        # Without the slash, a path could continue the address: `http://node` + `.other.site/`.
        url = f"{self.address}/{path.removeprefix('/')}"
        begins_s = None if read_s is None else CONNECT_S + read_s
        try:
            async with (
                asyncio.timeout(begins_s) as limit,
                self._client.stream(method, url, timeout=timeout, **options) as streamed,
            ):
                answer = await _read_whole(streamed, limit)
        except TimeoutError as error:
            raise NoResponse(f"{method} {url}: its answer is too slow") from error
        except NOT_SENT as error:
            raise DeviceError(
                f"{self.address} does not answer ({_error_text(error, read_s)}).",
                effects="none",
                remedy="Is it running?",
            ) from error
        except httpx.HTTPError as error:
            raise NoResponse(f"{method} {url}: {_error_text(error, read_s)}") from error
        if answer.status_code in GATEWAY:
            raise NoResponse(f"{method} {url}: a gateway had no answer ({answer.status_code})")
        return answer

    async def ask(self, path: str) -> Any:
        """The JSON at a path. Raises DeviceError (``none``), because a query moves nothing."""
        try:
            return read_json(await self.send("GET", path))
        except NoResponse as lost:
            raise DeviceError(f"The foreign node does not answer ({lost}).", effects="none") from lost


async def _read_whole(streamed: httpx.Response, limit: asyncio.Timeout) -> httpx.Response:
    """An answer with its content. Raises Lost if the content does not end, because the request was sent. A
    piece that takes longer than the allowed silence exceeds the limit."""
    data, clock, awaited = bytearray(), asyncio.get_running_loop().time, 0
    async for piece in streamed.aiter_bytes():
        data += piece
        if len(data) >= awaited:
            awaited = len(data) + PIECE
            limit.reschedule(clock() + READ_S)
        if len(data) > LARGEST_ANSWER:
            path = streamed.request.url.path
            raise NoResponse(
                f"{streamed.request.method} {path}: more than {LARGEST_ANSWER} bytes were received"
            )
    # The content is decoded now: these headers described it as it was sent.
    headers = [(key, value) for key, value in streamed.headers.multi_items() if key not in _OF_THE_WIRE]
    return httpx.Response(
        streamed.status_code, headers=headers, content=bytes(data), request=streamed.request
    )


def read_json(answer: httpx.Response) -> Any:
    """The content of an answer. Raises DeviceError (``none``) for a refused request and for an unreadable
    answer."""
    refuse(answer)
    try:
        return read_json_text(answer.content)
    except ValueError as error:
        raise DeviceError(
            f"{answer.request.url.path} sent an answer that is not JSON ({error}): {cut_answer(answer)}"
        ) from error


def refuse(answer: httpx.Response) -> None:
    """Raises DeviceError for an answer that is not a success: with 4xx nothing moved, with 5xx the effects
    are unknown."""
    if answer.status_code < 400:
        return
    effects = "none" if answer.status_code < 500 else "unknown"
    path = answer.request.url.path
    raise DeviceError(f"{path} answered {answer.status_code}: {_detail(answer)}", effects=effects)


def refuse_at_end(answer: httpx.Response, refused: Collection[int] = ()) -> None:
    """Raises DeviceError for an answer after the end of an action that is not a success. A 4xx may report a
    failed motion. Nothing moved only if the status means that the request was not accepted at all, or is one
    of ``refused``."""
    if answer.status_code < 400:
        return
    try:
        refuse(answer)
    except DeviceError as error:
        begun = answer.status_code not in NOT_TAKEN and answer.status_code not in refused
        raise DeviceError(error.message, effects="unknown" if begun else "none") from error


def read_authorization(config: dict[str, Any], key: str) -> str:
    """The value of the Authorization header, from the file that ``key`` names, or from the variable that
    ``<key>_env`` names. Raises DeviceError."""
    return read_secret(config, key, file_key=key)


def find_address(config: dict[str, Any], *keys: str) -> str:
    """The node's address. Raises DeviceError naming the key."""
    for key in keys:
        if config.get(key):
            found = str(config[key])
            return found if "://" in found else f"http://{found}"
    raise DeviceError(f"`config:` has no `{keys[0]}`.", effects="none", remedy="Write the node's URL.")


def _error_text(error: Exception, read_s: float | None) -> str:
    if isinstance(error, httpx.ConnectTimeout):
        return f"no connection within {CONNECT_S:g} s"
    if isinstance(error, httpx.TimeoutException) and read_s is not None:
        return f"no answer within {read_s:g} s"
    return str(error) or type(error).__name__


def _detail(answer: httpx.Response) -> str:
    try:
        body = read_json_text(answer.content)
    except ValueError:
        return cut_answer(answer)
    detail = body.get("detail", body) if isinstance(body, dict) else body
    return (detail if isinstance(detail, str) else json.dumps(detail))[:SHOWN]


def cut_answer(answer: httpx.Response) -> str:
    """The beginning of an answer, for a person."""
    return repr(answer.content[: 4 * SHOWN].decode("utf-8", "replace")[:SHOWN])
