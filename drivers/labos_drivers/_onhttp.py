"""Simulated devices that answer HTTP requests, in lab time and one request at a time."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import msgspec

from labos.node import Crash, Setup
from labos_drivers._onwire import Timed

LONGEST_ANSWER_S = 30.0


class Reply(msgspec.Struct):
    """An HTTP response. ``body`` is bytes, or a value that JSON can hold."""

    status: int
    body: Any = None
    headers: dict[str, str] = {}

    def encode(self) -> bytes:
        body = self.body if isinstance(self.body, bytes) else json.dumps(self.body).encode()
        kind = {} if isinstance(self.body, bytes) else {"Content-Type": "application/json"}
        headers = {**kind, **self.headers, "Content-Length": str(len(body)), "Connection": "close"}
        lines = [f"HTTP/1.1 {self.status} .", *(f"{name}: {value}" for name, value in headers.items())]
        return "\r\n".join(lines).encode() + b"\r\n\r\n" + body


class Request(msgspec.Struct):
    """An HTTP request. ``parts`` are the parts of the path. The names of headers are in lower case. The reply
    goes to ``replies``."""

    method: str
    parts: tuple[str, ...]
    query: dict[str, str]
    headers: dict[str, str]
    body: bytes
    replies: Any

    def json(self) -> Any:
        """The body as JSON. Raises ValueError."""
        return json.loads(self.body or b"null")


class HttpEnd:
    """A port that accepts requests. ``spoil`` changes each reply; if it returns None, the reply is lost."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self.host, self.port = host, port
        self.requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.spoil: Callable[[bytes], bytes | None] = lambda raw: raw
        self._server: ThreadingHTTPServer | None = None
        self.plug()

    @property
    def address(self) -> str:
        return f"http://{self.host}:{self.port}"

    def plug(self) -> None:
        """Open the port: the device can be reached, at the same address as before."""
        if self._server is None:
            self._server = _Server((self.host, self.port), _handler(self))
            self.port = self._server.server_port
            thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
            thread.start()

    def unplug(self) -> None:
        """Close the port. A client that waits loses its connection."""
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()

    close = unplug

    @property
    def is_plugged(self) -> bool:
        return self._server is not None

    def exchange(self, request: Request) -> bytes | None:
        """Give the device a request and wait for its reply; returns it as bytes. None if the port closes, the
        reply is lost, or ``LONGEST_ANSWER_S`` have passed."""
        self.requests.put(request)
        waited = 0.0
        while self.is_plugged and waited < LONGEST_ANSWER_S:
            try:
                reply: Reply = request.replies.get(timeout=0.05)
            except queue.Empty:
                waited += 0.05
            else:
                return self.spoil(reply.encode())
        return None


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Do nothing: a client that closes its connection is not an error."""


def _handler(end: HttpEnd) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def handle_one_request(self) -> None:
            self.close_connection = True
            self.raw_requestline = self.rfile.readline(65537)
            if not self.raw_requestline or not self.parse_request():
                return
            url = urlsplit(self.path)
            request = Request(
                self.command,
                tuple(part for part in url.path.split("/") if part),
                dict(parse_qsl(url.query)),
                {name.lower(): value for name, value in self.headers.items()},
                self.rfile.read(int(self.headers.get("Content-Length") or 0)),
                queue.SimpleQueue(),
            )
            raw = end.exchange(request)
            if raw is not None:
                self.wfile.write(raw)

        def log_message(self, format: str, *args: Any) -> None:
            """Write nothing to the terminal."""

    return Handler


class OnHttp(Timed):
    """A device at the far end of a network cable. Subclasses implement its replies (``answer``)."""

    def __init__(self, setup: Setup, end: HttpEnd | None = None) -> None:
        super().__init__(setup)
        self.end = end or HttpEnd()

    @property
    def address(self) -> str:
        return self.end.address

    def close(self) -> None:
        super().close()
        self.end.close()

    def listen(self, timeout_s: float) -> None:
        try:
            request = self.end.requests.get(timeout=timeout_s)
        except queue.Empty:
            return
        try:
            request.replies.put(self.answer(request))
        except Crash:
            request.replies.put(Reply(500, {"message": "something was hit"}))
            raise

    def answer(self, request: Request) -> Reply:
        """The reply to a request."""
        raise NotImplementedError
