"""References in answers are replaced by the words beside the log, in the last step before sending.

All earlier steps have only references: folded states, answers kept for a repetition, messages between
processes. So erased words disappear from every answer at once.
"""

from __future__ import annotations

import asyncio

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from labos.core.words import list_references, put_into_json
from labos.errors import LabosError
from labos.services.shown import WordsBeside, read_texts

STORED = "labos.stored"
"""The key in a request's scope that asks for the answer as stored."""

NOT_READ = "(not read: the log's database does not answer)"

_log = structlog.get_logger(__name__)


class ShownWords:
    """Puts words into JSON answers that are sent in one piece. Streams of events do this themselves."""

    def __init__(self, app: ASGIApp, log: WordsBeside) -> None:
        self._app, self._beside = app, log

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun: Message | None = None

        async def pass_on(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start" and _is_json(message):
                begun = message  # the length of the answer may change
                return
            if begun is not None:
                start, begun = begun, None
                if message["type"] == "http.response.body" and not message.get("more_body"):
                    message = await self._show(scope, start, message)
                await send(start)
            await send(message)

        await self._app(scope, receive, pass_on)

    async def _show(self, scope: Scope, start: Message, message: Message) -> Message:
        body: bytes = message.get("body", b"")
        named = list_references(body)
        if not named or scope.get(STORED):
            return message
        try:
            texts = await asyncio.to_thread(read_texts, self._beside, named)
        except LabosError as error:
            _log.warning("words_not_read", why=str(error))
            texts = dict.fromkeys(named, NOT_READ)
        body = put_into_json(body, texts)
        MutableHeaders(raw=start["headers"])["content-length"] = str(len(body))
        return {**message, "body": body}


def _is_json(start: Message) -> bool:
    return "json" in Headers(raw=start["headers"]).get("content-type", "")
