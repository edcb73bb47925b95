"""The part of the kernel's process that answers API processes over the bus."""

from __future__ import annotations

import asyncio
from typing import Any, assert_never

import structlog
from starlette.applications import Starlette
from starlette.types import Message

from labos.errors import LabosError
from labos.http.idempotency import IdempotentAnswers
from labos.http.letters import Headers, Hello, KernelAnswer, LetterReply, Letters, Recall, SentOn, Welcome
from labos.http.notes import notes_of
from labos.http.operation import ADMITTED
from labos.http.problems import make_problem
from labos.http.routes import PREFIX
from labos.http.service import LabService
from labos.http.wire import send_problem

LONGEST_S = 65.0
AT_ONCE = 64
"""The number of requests of all API processes that are handled at the same time."""
LIVES_S = 15.0
"""An API process without a message for so long counts as gone."""
MOST_PROCESSES = 100
STREAM = f"{PREFIX}/events/stream"

_log = structlog.get_logger(__name__)


class Desk:
    """Answers the requests of API processes with the kernel's own application."""

    def __init__(self, app: Starlette, service: LabService, letters: Letters) -> None:
        self._app, self._service, self._letters = app, service, letters
        self._working = 0
        self._heard: dict[str, tuple[str, float]] = {}

    @property
    def addresses(self) -> dict[str, str]:
        """The addresses of the metrics of running API processes, by their names."""
        now = self._service.kernel.clock.monotonic()
        return {name: at for name, (at, heard) in self._heard.items() if at and now - heard < LIVES_S}

    async def on_question(self, key: str, payload: bytes) -> bytes:
        """Answer a request. Raises Unreadable for one that is not genuine."""
        question, nonce = self._letters.read_question(payload)
        match question:
            case Hello(address):
                self._note(key.split("/")[3], address)
                reply: LetterReply = Welcome(notes_of(self._service))
            case Recall():
                reply = await self._recall(question)
            case SentOn():
                reply = await self._carry_out(question)
            case _:
                assert_never(question)
        return self._letters.reply(nonce, reply)

    def _note(self, name: str, address: str) -> None:
        if name in self._heard or len(self._heard) < MOST_PROCESSES:
            self._heard[name] = address[:100], self._service.kernel.clock.monotonic()

    async def _recall(self, asked: Recall) -> KernelAnswer:
        idempotent: IdempotentAnswers = self._app.state.api.idempotent
        try:
            found = await idempotent.recall(asked.key, asked.digest, asked.user)
        except LabosError:
            found = None  # the request was refused: nothing is stored for it
        if found is None:
            return KernelAnswer(0)
        return KernelAnswer(found.status_code, tuple(found.raw_headers), bytes(found.body), self._durable)

    @property
    def _durable(self) -> int:
        return self._service.kernel.durable

    async def _carry_out(self, asked: SentOn) -> KernelAnswer:
        if self._working >= AT_ONCE or asked.path == STREAM or not asked.path.startswith(f"{PREFIX}/"):
            return _make_refusal("The kernel gets too many requests at once.")
        self._working += 1
        try:
            async with asyncio.timeout(LONGEST_S):
                status, headers, body = await self._call(asked)
        except TimeoutError:
            return _make_refusal(f"This took the kernel longer than {LONGEST_S:g} s.")
        finally:
            self._working -= 1
        return KernelAnswer(status, headers, body, self._durable)

    async def _call(self, asked: SentOn) -> tuple[int, Headers, bytes]:
        """Call the application in the same way as its server."""
        arriving: list[Message] = [{"type": "http.request", "body": asked.body, "more_body": False}]
        status, headers, body = 500, (), bytearray()

        async def receive() -> Message:
            if arriving:
                return arriving.pop()
            await asyncio.Event().wait()  # the client stays connected until the answer is complete
            raise AssertionError

        async def send(message: Message) -> None:
            nonlocal status, headers
            if message["type"] == "http.response.start":
                status, headers = message["status"], tuple(message["headers"])
            else:
                body.extend(message.get("body", b""))

        scope: dict[str, Any] = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": asked.method,
            "scheme": "http",
            "path": asked.path,
            "raw_path": b"",
            "query_string": asked.query,
            "root_path": "",
            "headers": list(asked.headers),
            "client": (asked.address, 0),
            "server": None,
            ADMITTED: asked.who,
        }
        try:
            await self._app(scope, receive, send)
        except Exception:  # the application has answered already; its server would only log later errors, too
            _log.exception("request_failed", path=asked.path)
        return status, headers, bytes(body)


def _make_refusal(why: str) -> KernelAnswer:
    found = send_problem(make_problem("too_many", why, "Ask again in a moment."))
    return KernelAnswer(found.status_code, tuple(found.raw_headers), bytes(found.body))
