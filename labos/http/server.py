"""The HTTP server in the kernel's event loop."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import ssl
import sys
from collections.abc import Callable, Iterator
from typing import Any

import h11
import msgspec
import uvicorn
from starlette.types import ASGIApp

from labos.errors import BadInput
from labos.http.app import create_app
from labos.http.framing import StrictProtocol
from labos.http.identity import Gate
from labos.http.problems import MEDIA_TYPE, make_problem
from labos.http.routes.log import CONNECTION
from labos.http.service import LabService

HEAD_S = 10.0
"""How long a client may take to send the head of a request, once it has connected or begun one."""

STALL_S = 30.0
"""How long a client may accept nothing of its answer."""

MOST_CONNECTIONS = 2_000
"""Connections at once; fewer if the process may not open twice as many files."""

BUSY = b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: %b\r\nconnection: close\r\n\r\n%b" % (
    MEDIA_TYPE.encode(),
    msgspec.json.encode(
        make_problem("too_many", "The lab has too many connections.", "Close some, or ask again.")
    ),
)


class _Server(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals are handled by the process that runs the lab."""
        yield


class _Protocol(StrictProtocol):
    """One connection; it is closed if it does not send a request."""

    most_connections = MOST_CONNECTIONS

    def __init__(self, *args: Any, **named: Any) -> None:
        super().__init__(*args, **named)
        app = self.app
        self._gone = asyncio.Event()

        async def with_connection(scope: Any, receive: Any, send: Any) -> None:
            scope[CONNECTION] = self
            await app(scope, receive, send)

        self.app = with_connection

    async def give_away(self, take: Callable[[socket.socket], bool]) -> bool:
        """Give the connection to another process; False if none takes it. Nothing is sent here afterwards."""
        connection = self.transport.get_extra_info("socket")
        if self.transport.get_extra_info("ssl_object") is not None:
            return False  # only this process can encrypt for this TLS connection
        if connection is None or self.transport.is_closing() or not take(connection):
            return False
        self.transport.abort()  # closes only our own end
        await self._gone.wait()
        return True

    _late: asyncio.TimerHandle | None = None
    _stalled: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > self.most_connections:
            transport.write(BUSY)
            transport.close()
        else:
            self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        self._head_came()
        self._take_up()
        super().connection_lost(exc)
        self._gone.set()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._head_came()
        elif self._late is None:
            self._await_head()

    def send_400_response(self, msg: str) -> None:
        """A request that is not HTTP is refused like every other one; if an answer has begun, the connection
        is closed."""
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.close()
            return
        reason = make_problem(
            "bad_input", "The request is not HTTP, or its head is too long.", "Send less at once."
        )
        head = h11.Response(
            status_code=400,
            headers=[("content-type", MEDIA_TYPE), ("connection", "close")],
            reason=b"Bad Request",
        )
        events = (head, h11.Data(data=msgspec.json.encode(reason)), h11.EndOfMessage())
        self.transport.write(b"".join(self.conn.send(event) or b"" for event in events))
        self.transport.close()

    def pause_writing(self) -> None:
        super().pause_writing()
        if self._stalled is None:
            self._stalled = self.loop.call_later(STALL_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        self._take_up()

    def _take_up(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None

    def _await_head(self) -> None:
        self._late = self.loop.call_later(HEAD_S, self._give_up)

    def _head_came(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _give_up(self) -> None:
        self._late = None
        if self.conn.their_state is h11.IDLE and not self.transport.is_closing():
            self.transport.close()


class Listening(msgspec.Struct, frozen=True):
    """Where a lab is served: ``names`` are the other names under which it is reached. With a ``certificate``
    and its ``key`` (PEM files), it uses TLS. ``behind_proxy``: a proxy on this computer or its network
    forwards the requests of browsers, and names the sender (``X-Forwarded-For``)."""

    host: str = "127.0.0.1"
    port: int = 0
    names: tuple[str, ...] = ()
    certificate: str = ""
    key: str = ""
    behind_proxy: bool = False

    @property
    def is_secure(self) -> bool:
        """Whether browsers reach the lab over TLS."""
        return bool(self.certificate) or self.behind_proxy


class HttpServer:
    """Serves a lab on one address; by default only on loopback. Raises BadInput for an address or a
    certificate that cannot be used."""

    def __init__(self, service: LabService, gate: Gate, listening: Listening) -> None:
        self._service = service
        tls = make_tls_context(listening)
        host = listening.host
        self._socket = listen(host, listening.port)
        bound = self._socket.getsockname()
        self.url = f"{'https' if tls else 'http'}://{host}:{bound[1]}"
        self.port = int(bound[1])
        self.app = create_app(service, gate, (host, *listening.names))
        self._server = make_server(
            self.app,
            tls,
            proxy_headers=listening.behind_proxy,
            forwarded_allow_ips="*" if listening.behind_proxy else "",
            http=type("_Limited", (_Protocol,), {"most_connections": _count_most_connections()}),
            lifespan="off",
        )
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """The socket already listens: requests that come before the server is up wait."""
        self._task = asyncio.get_running_loop().create_task(self._server.serve([self._socket]))

    async def close(self) -> None:
        self._service.feed.close()
        self._service.tail.close()
        self._service.give_up_forecasts()
        if self._service.viewers is not None:
            self._service.viewers.close()
        if self._service.finder is not None:
            self._service.finder.close()
        self._server.should_exit = True
        if self._task is not None:
            await asyncio.wait({self._task}, timeout=5.0)
        if self._service.finder is not None:
            await self._service.finder.wait_closed()
        self._socket.close()


def make_server(app: ASGIApp, tls: ssl.SSLContext | None, **options: Any) -> uvicorn.Server:
    """A server that leaves signals to its process. ``options`` are those of ``uvicorn.Config``."""
    config = uvicorn.Config(
        app, log_config=None, access_log=False, timeout_graceful_shutdown=1, ws="none", **options
    )
    config.load()
    config.ssl = tls
    return _Server(config)


def make_tls_context(listening: Listening) -> ssl.SSLContext | None:
    """TLS 1.2 or newer. Raises BadInput for files that cannot be used."""
    if not listening.certificate:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    try:
        context.load_cert_chain(listening.certificate, listening.key or None)
    except (OSError, ssl.SSLError) as error:
        raise BadInput(
            f"The certificate {listening.certificate} cannot be used with the key {listening.key}: "
            f"{error.strerror or error}.",
            remedy="Name a PEM file with the certificate and those of its issuers, and one with its key.",
        ) from None
    return context


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises BadInput if the address cannot be used."""
    # asyncio sends small packets at once (TCP_NODELAY) only where the protocol is named: without it each
    # answer on a kept connection waits 40 ms for the client's acknowledgement.
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise BadInput(
            f"The address {host}:{port} for HTTP cannot be used: {error.strerror or error}.",
            remedy="Stop the other process, or choose another port with --http-port.",
        ) from None
    listening.listen(128)
    return listening


def is_own_address(host: str) -> bool:
    """Whether a server at this address is reached only by programs of this computer."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _count_most_connections() -> int:
    """The kernel needs files of its own: connections may not use them up."""
    if sys.platform == "win32":
        return MOST_CONNECTIONS
    import resource

    allowed = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return MOST_CONNECTIONS if allowed == resource.RLIM_INFINITY else min(MOST_CONNECTIONS, allowed // 2)
