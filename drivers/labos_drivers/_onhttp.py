"""Simulated devices that answer HTTP, in lab time and one question at a time."""

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
    """``body`` is bytes, or what JSON can hold."""

    status: int
    body: Any = None
    headers: dict[str, str] = {}

    def raw(self) -> bytes:
        body = self.body if isinstance(self.body, bytes) else json.dumps(self.body).encode()
        kind = {} if isinstance(self.body, bytes) else {"Content-Type": "application/json"}
        headers = {**kind, **self.headers, "Content-Length": str(len(body)), "Connection": "close"}
        lines = [f"HTTP/1.1 {self.status} .", *(f"{name}: {value}" for name, value in headers.items())]
        return "\r\n".join(lines).encode() + b"\r\n\r\n" + body


class Question(msgspec.Struct):
    """``parts`` are those of the path; names of headers are in small letters."""

    method: str
    parts: tuple[str, ...]
    query: dict[str, str]
    headers: dict[str, str]
    body: bytes
    answers: Any

    def json(self) -> Any:
        """Raises ValueError."""
        return json.loads(self.body or b"null")


class HttpEnd:
    """A port that takes questions; ``spoil`` is what happens to answers on their way (None: they are
    lost)."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self.host, self.port = host, port
        self.questions: queue.SimpleQueue[Question] = queue.SimpleQueue()
        self.spoil: Callable[[bytes], bytes | None] = lambda raw: raw
        self._server: ThreadingHTTPServer | None = None
        self.plug()

    @property
    def address(self) -> str:
        return f"http://{self.host}:{self.port}"

    def plug(self) -> None:
        """The device can be reached, at the same address as before."""
        if self._server is None:
            self._server = _Server((self.host, self.port), _handler(self))
            self.port = self._server.server_port
            thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
            thread.start()

    def unplug(self) -> None:
        """The client that asks loses the line."""
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()

    close = unplug

    @property
    def is_plugged(self) -> bool:
        return self._server is not None

    def answer_to(self, question: Question) -> bytes | None:
        """The bytes of an answer, when the device has given it; None if the line is lost."""
        self.questions.put(question)
        waited = 0.0
        while self.is_plugged and waited < LONGEST_ANSWER_S:
            try:
                reply: Reply = question.answers.get(timeout=0.05)
            except queue.Empty:
                waited += 0.05
            else:
                return self.spoil(reply.raw())
        return None


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that hangs up is none of the device's business."""


def _handler(end: HttpEnd) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def handle_one_request(self) -> None:
            self.close_connection = True
            self.raw_requestline = self.rfile.readline(65537)
            if not self.raw_requestline or not self.parse_request():
                return
            url = urlsplit(self.path)
            question = Question(
                self.command,
                tuple(part for part in url.path.split("/") if part),
                dict(parse_qsl(url.query)),
                {name.lower(): value for name, value in self.headers.items()},
                self.rfile.read(int(self.headers.get("Content-Length") or 0)),
                queue.SimpleQueue(),
            )
            raw = end.answer_to(question)
            if raw is not None:
                self.wfile.write(raw)

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing is written to the terminal."""

    return Handler


class OnHttp(Timed):
    """A device at the far end of a network cable, which says how it answers (``answer``)."""

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
            question = self.end.questions.get(timeout=timeout_s)
        except queue.Empty:
            return
        try:
            question.answers.put(self.answer(question))
        except Crash:
            question.answers.put(Reply(500, {"message": "something was hit"}))
            raise

    def answer(self, question: Question) -> Reply:
        """What is said to a question."""
        raise NotImplementedError
