"""Who may talk to the lab: programs that mean it, not web pages that a browser shows.

A page of another site can let a browser on this computer send requests here. It cannot choose the headers
``Host`` and ``Origin``, nor send ``application/json`` without asking first.
"""

from __future__ import annotations

import ipaddress
import socket
from urllib.parse import unquote_to_bytes

import msgspec
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from labos.http import wire
from labos.http.arriving import drain

LONGEST_PATH = 4_000
"""Bytes of a path, and of a query, as they are sent."""


class Refusal(msgspec.Struct, frozen=True):
    status: int
    code: str
    error: str
    remedy: str


class Door:
    """Refuses requests before any handler sees them. ``host`` is the name that the server was told to
    listen on."""

    def __init__(self, app: ASGIApp, host: str = "localhost") -> None:
        self._app = app
        own = socket.gethostname().lower()
        self._names = {"localhost", host.lower(), own, f"{own.partition('.')[0]}.local"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal = self._refusal(scope) if scope["type"] == "http" else None
        if refusal is None:
            await self._app(scope, receive, send)
            return
        await drain(Request(scope, receive).stream())
        answer = wire.refused(refusal.status, refusal.code, refusal.error, refusal.remedy)
        await answer(scope, receive, send)

    def _refusal(self, scope: Scope) -> Refusal | None:
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        return (
            self._wrong_host(headers.get("host", ""))
            or _foreign_page(headers)
            or _no_json(scope["method"], headers.get("content-type", ""))
            or _no_text(scope)
        )

    def _wrong_host(self, host: str) -> Refusal | None:
        name = _name_of(host)
        # A browser always names a host; a program that names none is not led here by a page.
        if not name or name in self._names or _is_address(name):
            return None
        return Refusal(
            403,
            "forbidden",
            f"The request is meant for {host[:100]!r}, which is no name of this lab's server.",
            f"Ask for an address, or for {' or '.join(sorted(self._names))}.",
        )


def _name_of(host: str) -> str:
    """The name in a ``Host`` header, without its port."""
    host = host.strip().lower()
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0].rstrip(".")


def _is_address(name: str) -> bool:
    """Whether it is an IP address: no other site can let a browser take one for its own name."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _foreign_page(headers: dict[str, str]) -> Refusal | None:
    origin, host = headers.get("origin"), headers.get("host", "").strip().lower()
    own = origin is None or origin.strip().lower() in (f"http://{host}", f"https://{host}")
    if own and headers.get("sec-fetch-site", "none") in ("none", "same-origin"):
        return None
    return Refusal(
        403,
        "forbidden",
        f"The request comes from a web page of {(origin or 'another site')[:100]!r}.",
        "Ask from a program, or from a page of this server.",
    )


def _no_json(method: str, content_type: str) -> Refusal | None:
    if method in ("GET", "HEAD") or content_type.partition(";")[0].strip().lower() == "application/json":
        return None
    return Refusal(
        415,
        "unsupported_media_type",
        f"The request's content-type is {content_type[:100]!r}.",
        "Send JSON, with the header `content-type: application/json`.",
    )


def _no_text(scope: Scope) -> Refusal | None:
    """Paths and queries are UTF-8, and not too long."""
    for what, raw in (("path", scope.get("raw_path", b"")), ("query", scope["query_string"])):
        if len(raw) > LONGEST_PATH:
            return Refusal(
                414, "bad_input", f"The {what} is longer than {LONGEST_PATH} bytes.", "Ask for less at once."
            )
        try:
            unquote_to_bytes(raw).decode()
        except UnicodeDecodeError:
            return Refusal(400, "bad_input", f"The {what} is not UTF-8.", "Write %-codes of UTF-8 text.")
    return None
