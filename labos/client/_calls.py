"""The base of the calls of a client: sends requests over HTTP, and repeats them until there is an answer."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Mapping, Sequence, Set
from contextvars import ContextVar
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import quote

import msgspec

from labos.client._answers import LabUnreachable, answer_of, decode_problem, make_cannot_write_error
from labos.client._token import find_token, find_trusted, place_of
from labos.clock import Uuid7Ids
from labos.errors import BadInput
from labos.settings import Settings, find_kernel

if TYPE_CHECKING:
    import httpx

API = "/api/v1"

LONG_POLL_S = 20.0

IN_DOUBT = ("commit_in_doubt", "kernel_away")
"""Codes of requests that may have been carried out: only a request that may be carried out twice is
repeated."""

NEVER_S = 3.0
"""How long to wait for a lab in a folder in which no lab has ever run."""

GIVEN_UP: ContextVar[threading.Event | None] = ContextVar("given_up", default=None)
"""Set in the threads of the asynchronous client: after the event is set, no caller waits for the call."""


class CallAbandoned(Exception):
    """No caller waits for this call any more."""


def check_given_up() -> None:
    """Raises CallAbandoned."""
    given_up = GIVEN_UP.get()
    if given_up is not None and given_up.is_set():
        raise CallAbandoned


def in_path(name: str, parts: int = 1) -> str:
    """A name as one part of a path. Only a name of several ``parts`` may contain slashes: a module is
    ``sealer`` or ``rpl/sealer``. Raises BadInput for a name that would lead to another path."""
    found = name.split("/")
    if len(found) > parts or any(part in ("", ".", "..") for part in found) or _NO_NAME.search(name):
        raise BadInput(f"{name[:80]!r} is not a name in the lab.", remedy="Give one name.")
    return quote(name, safe="")


_NO_NAME = re.compile(r"[\x00-\x1f\x7f\\\ud800-\udfff]")


def fill_path(path: str, values: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """A path with the values of the names in braces, and the other ``values``. The name of a module may have
    a slash: ``rpl/sealer``. Raises BadInput."""
    left = {name: value for name, value in values.items() if name != "self"}
    filled = re.sub(
        r"\{(\w+)\}", lambda found: in_path(left.pop(found[1]), 2 if found[1] == "module" else 1), path
    )
    return filled, left


def make_plain(value: Any) -> Any:
    """Convert objects that behave like a list, table or text, and numbers and arrays of numpy. Raises
    BadInput."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Sequence | Set):
        return list(value)
    if isinstance(value, PurePath):
        return str(value)
    if callable(tolist := getattr(value, "tolist", None)):
        return tolist()
    kind = type(value).__name__
    raise BadInput(
        f"Values of the type {kind} cannot be sent to the lab.",
        remedy="Send numbers, texts, and lists and tables of these.",
    )


class Calls:
    """Base of the groups of calls that make up ``LabClient``: the address of a lab, the credentials for it,
    and the limits of repetitions."""

    def __init__(
        self,
        url: str = "",
        *,
        home: str | Path | None = None,
        patience_s: float = 30.0,
        token: str = "",
        behalf: str = "",
    ) -> None:
        self._home = None if url else Settings.make(home).home
        self._url = url.rstrip("/")
        self._patience_s = patience_s
        self._token, self._behalf = token, behalf
        self._http = self._open_http()
        self._ids = Uuid7Ids()
        self.warnings: list[str] = []
        """The warnings about the last submission, one sentence each, with its place."""
        self.approval = ""
        """Why the last submission waits for an approval; empty if it does not."""

    def _open_http(self) -> httpx.Client:
        import httpx

        timeout = httpx.Timeout(LONG_POLL_S + 40.0, connect=5.0)
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=20)
        return httpx.Client(timeout=timeout, limits=limits, verify=find_trusted(self._home) or True)

    @property
    def token_place(self) -> str:
        """The name of this lab in the file of tokens: its folder, or its address."""
        return place_of(self._url, self._home)

    def close(self) -> None:
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _get(self, path: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Send a GET request with a method's parameters, ``locals()``: those in braces in the ``path``, all
        others in the query. Raises the LabosError that the lab reports, LabUnreachable."""
        path, query = fill_path(path, values)
        return self._ask("GET", path, params=query, repeat=True)

    def _fetch(self, path: str, values: Mapping[str, Any]) -> bytes:
        """The content of the answer. Raises as ``_get``."""
        path, query = fill_path(path, values)
        response = self._request("GET", path, repeat=True, params=query)
        if response.status_code >= 400:
            answer_of(response.status_code, response.content)
        return bytes(response.content)

    def _post(
        self,
        path: str,
        values: Mapping[str, Any],
        *,
        once: bool = False,
        repeat: bool = False,
        as_user: bool = False,
        timeout_s: float | None = None,
    ) -> dict[str, Any]:
        """Send a method's parameters, ``locals()``, as JSON: those in braces in the ``path``, all others in
        the body. With ``once`` the request has a key (the parameter ``request``, or a new one), and is
        carried out once, however often it is sent; ``repeat`` marks a request that may be carried out twice.
        With ``as_user`` the parameter ``user`` is sent as a header. Raises as ``_get``."""
        path, body = fill_path(path, values)
        request = body.pop("request", "") or (self._ids.new() if once else "")
        user = body.pop("user") if as_user else ""
        headers = {"content-type": "application/json"}
        if request:
            headers["idempotency-key"] = request
        if user:
            headers["labos-user"] = user
        return self._ask(
            "POST",
            path,
            content=msgspec.json.encode(body, enc_hook=make_plain),
            headers=headers,
            repeat=repeat or bool(request),
            **({"timeout": timeout_s} if timeout_s else {}),
        )

    def _ask(self, method: str, path: str, *, repeat: bool, **options: Any) -> dict[str, Any]:
        """As ``_request``, the data of the answer. Raises the error that the lab reports."""
        response = self._request(method, path, repeat=repeat, **options)
        return answer_of(response.status_code, response.content)

    def _request(self, method: str, path: str, *, repeat: bool, **options: Any) -> httpx.Response:
        """Send a request until there is an answer. A request that may not be carried out twice is repeated
        only if it cannot have arrived."""
        import httpx

        deadline = time.monotonic() + self._find_patience()
        pause = 0.05
        own = options.pop("headers", {})
        while True:
            check_given_up()
            asked = time.monotonic()
            try:
                base = self._find_base()
                headers = {**own, **self._make_headers(base)}
                response = self._http.request(method, base + API + path, headers=headers, **options)
                if self._http.is_closed:  # while this request was connecting: its connection was not closed
                    response.extensions["network_stream"].close()
            except (httpx.ConnectError, httpx.ConnectTimeout) as error:
                why: Exception = error
            except httpx.TransportError as error:
                if not repeat:
                    raise LabUnreachable(
                        "The connection to the lab broke during the request "
                        f"({type(error).__name__}); it is not known whether the request was carried "
                        "out.",
                        remedy="Check with `labos log`.",
                    ) from error
                why = error
                # The lab answered until now, as in a long request: the time without an answer begins here.
                deadline += time.monotonic() - asked
            except LabUnreachable as error:
                why = error
            else:
                if response.status_code != 503 or time.monotonic() > deadline:
                    return response
                if not repeat and decode_problem(response.content).code in IN_DOUBT:
                    return response
                why = make_cannot_write_error(response.content)
            if time.monotonic() + pause > deadline:
                if isinstance(why, LabUnreachable):
                    raise why
                raise LabUnreachable(
                    f"No lab answers at {self._url} ({why}).", remedy="Start it with `labos up`."
                ) from why
            time.sleep(pause)
            pause = min(pause * 2, 1.0)

    def _make_headers(self, base: str) -> dict[str, str]:
        """The headers with the user's credentials. Raises BadInput for a file of tokens that others can
        read."""
        token = self._token or find_token(base, self._home)
        shown = {"authorization": f"Bearer {token}"} if token else {}
        return shown | ({"labos-on-behalf-of": self._behalf} if self._behalf else {})

    def _find_patience(self) -> float:
        """How long to try a lab that does not answer: only briefly if no lab has ever run there."""
        never = self._home is not None and not (self._home / "kernel.json").exists()
        return min(self._patience_s, NEVER_S) if never else self._patience_s

    def _find_base(self) -> str:
        """The present address of the lab: a restarted lab may have another one."""
        if self._home is not None:
            found = find_kernel(self._home)
            if found is None:
                raise LabUnreachable(f"No lab runs in {self._home}.", remedy="Start it with `labos up`.")
            self._url = found.url
        return self._url
