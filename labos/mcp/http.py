"""The server over HTTP (the protocol's Streamable HTTP, without sessions): each request has only the rights
of its own token.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextvars import ContextVar

import structlog
from mcp.server.transport_security import TransportSecurityMiddleware, TransportSecuritySettings
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from labos.client import LabClient
from labos.errors import BadInput, Forbidden, LabosError, NotSignedIn
from labos.http.identity import BEHALF
from labos.http.problems import make_problem_of_error
from labos.http.server import Listening, is_own_address, listen, make_tls_context
from labos.http.server import make_server as make_http_server
from labos.http.wire import send_problem
from labos.mcp.server import make_server, sign_in
from labos.services.accounts import TOKEN

PATH = "/mcp"
AT_ONCE = 64
"""The largest number of connections."""
LONGEST_TOKEN = 200
OWN = ("127.0.0.1", "localhost")

_caller: ContextVar[LabClient] = ContextVar("caller")
_log = structlog.get_logger(__name__)


def make_app(url: str, home: str | None, listening: Listening) -> ASGIApp:
    """The application over the lab at an address or in a folder."""
    names = {*OWN, *listening.names, *(() if listening.host == "0.0.0.0" else (listening.host,))}
    # Browsers are not agents: no web page may send requests, wherever it comes from.
    rules = TransportSecuritySettings(
        allowed_hosts=[*names, *(f"{name}:*" for name in names)], allowed_origins=[]
    )
    app = make_server(_caller.get).streamable_http_app(
        streamable_http_path=PATH, stateless_http=True, json_response=True, transport_security=rules
    )
    return _Callers(app, url, home, rules)


def serve(url: str, home: str | None, listening: Listening, tell: Callable[[str], None]) -> None:
    """Serve until the process is interrupted; ``tell`` is called with the address. Raises BadInput for an
    address or a certificate that cannot be used."""
    if not is_own_address(listening.host) and not listening.is_secure:
        raise BadInput(
            f"Other computers reach {listening.host}, and tokens would be sent over the network unencrypted.",
            remedy="Leave --host out, or give --tls-cert and --tls-key, or add --behind-proxy if another "
            "program speaks TLS for it.",
        )
    tls = make_tls_context(listening)
    socket = listen(listening.host, listening.port)
    server = make_http_server(make_app(url, home, listening), tls, limit_concurrency=AT_ONCE)
    scheme = "https" if tls else "http"
    tell(f"{scheme}://{listening.host}:{socket.getsockname()[1]}{PATH}")
    try:
        server.run([socket])
    finally:
        socket.close()


class _Callers:
    """Admits service accounts. Their requests go to the lab with their own tokens, so that a revoked token
    has no effect any more."""

    def __init__(self, app: ASGIApp, url: str, home: str | None, rules: TransportSecuritySettings) -> None:
        self._app, self._url, self._home = app, url, home
        self._door = TransportSecurityMiddleware(rules)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        if request.method != "POST":  # without sessions, no other method is used
            await Response("Send requests by POST.", 405, {"allow": "POST"})(scope, receive, send)
            return
        refusal = await self._door.validate_request(request, is_post=True)
        if refusal is not None:
            await refusal(scope, receive, send)
            return
        try:
            lab = await asyncio.to_thread(
                sign_in,
                self._url,
                self._home,
                token=_read_token(request),
                behalf=request.headers.get(BEHALF, ""),
            )
        except LabosError as error:
            _log.info("agent_refused", why=error.message)
            await _refusal(error)(scope, receive, send)
            return
        mark = _caller.set(lab)
        try:
            await self._app(scope, receive, send)
        finally:
            _caller.reset(mark)
            await asyncio.to_thread(lab.close)


def _read_token(request: Request) -> str:
    """The token of a request. Other credentials on this computer are not used. Raises NotSignedIn."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    token = token.strip()
    if scheme.lower() != "bearer" or not token.startswith(TOKEN) or len(token) > LONGEST_TOKEN:
        raise NotSignedIn(
            "The request shows no token of this lab.",
            remedy="Send the header `Authorization: Bearer TOKEN`, with the token of a service account: "
            "labos token create --for NAME",
        )
    return token


def _refusal(error: LabosError) -> Response:
    if isinstance(error, BadInput):  # the user is known, and is not a service account
        error = Forbidden(error.message, remedy=error.remedy)
    found = send_problem(make_problem_of_error(error))
    if found.status_code == 401:
        found.headers["www-authenticate"] = "Bearer"
    return found
