"""Which requests are accepted: those that a program sends on purpose, not those of web pages in a browser.

A page of another site can make a browser on this computer send requests here. It cannot choose the headers
``Host`` and ``Origin``, nor send ``application/json`` without asking first.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Collection
from urllib.parse import unquote_to_bytes

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from labos.http import wire
from labos.http.problems import Problem, make_problem

LONGEST_PATH = 4_000
"""The largest number of bytes in a path, and in a query, as sent."""


WAY_BACK = "/login/oidc/callback"
"""The path to which an identity provider redirects a browser: the only path to which pages of other sites may
lead."""


class RequestFilter:
    """Refuses requests before a handler is called. ``names`` are the names of the server besides those of
    this computer."""

    def __init__(self, app: ASGIApp, names: Collection[str] = ()) -> None:
        self._app = app
        own = socket.gethostname().lower()
        self._names = {"localhost", own, f"{own.partition('.')[0]}.local", *map(str.lower, names)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal = self._find_refusal(scope) if scope["type"] == "http" else None
        if refusal is None:
            await self._app(scope, receive, send)
            return
        await wire.drain(Request(scope, receive).stream())
        await wire.send_problem(refusal, close=True)(scope, receive, send)

    def _find_refusal(self, scope: Scope) -> Problem | None:
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        return (
            self._check_host(headers.get("host", ""))
            or (_check_origin(headers) if (scope["method"], scope["path"]) != ("GET", WAY_BACK) else None)
            or _check_json(scope["method"], headers.get("content-type", ""))
            or _check_text(scope)
        )

    def _check_host(self, host: str) -> Problem | None:
        name = _strip_port(host)
        # A browser always names a host; a request without a host is not caused by a page.
        if not name or name in self._names or _is_address(name):
            return None
        return make_problem(
            "forbidden",
            f"The request has the host {host[:100]!r}, which is not a name of this lab's server.",
            f"Use an address, or {' or '.join(sorted(self._names))}.",
        )


def _strip_port(host: str) -> str:
    """The name in a ``Host`` header, without its port."""
    host = host.strip().lower()
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0].rstrip(".")


def _is_address(name: str) -> bool:
    """Whether it is an IP address: no other site can make a browser use one as the name of the site."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _check_origin(headers: dict[str, str]) -> Problem | None:
    origin, host = headers.get("origin"), headers.get("host", "").strip().lower()
    own = origin is None or origin.strip().lower() in (f"http://{host}", f"https://{host}")
    if own and headers.get("sec-fetch-site", "none") in ("none", "same-origin"):
        return None
    return make_problem(
        "forbidden",
        f"The request comes from a web page of {(origin or 'another site')[:100]!r}.",
        "Send it from a program, or from a page of this server.",
    )


def _check_json(method: str, content_type: str) -> Problem | None:
    if method in ("GET", "HEAD") or content_type.partition(";")[0].strip().lower() == "application/json":
        return None
    return make_problem(
        "unsupported_media_type",
        f"The request's content-type is {content_type[:100]!r}.",
        "Send JSON, with the header `content-type: application/json`.",
    )


def _check_text(scope: Scope) -> Problem | None:
    """Paths and queries must be UTF-8, and not too long."""
    for what, raw in (("path", scope.get("raw_path", b"")), ("query", scope["query_string"])):
        if len(raw) > LONGEST_PATH:
            return make_problem(
                "uri_too_long",
                f"The {what} is longer than {LONGEST_PATH} bytes.",
                "Make the request shorter.",
            )
        try:
            unquote_to_bytes(raw).decode()
        except UnicodeDecodeError:
            return make_problem("bad_input", f"The {what} is not UTF-8.", "Write %-codes of UTF-8 text.")
    return None
