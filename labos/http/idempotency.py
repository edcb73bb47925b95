"""The answers to requests with an idempotency key, kept for a repetition of the request.

They are kept in memory. A process that was started later finds in the log that a request was carried out
(``runtime.marks``), and computes its answer from the log (``recorded``). ``repeats`` handles the keys of
runs, experiments and campaigns, which are in the log.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial

import msgspec
from starlette.responses import Response

from labos.core.canonical import digest
from labos.errors import CommitInDoubt, KeyReused, LabosError
from labos.http.problems import make_problem_of_error
from labos.http.wire import send_problem
from labos.runtime.marks import MARK, PREFIX, Marks

MOST = 10_000
"""The largest number of stored answers."""
MOST_BYTES = 32 * 1024 * 1024

ASKED = 16
"""The number of digits of the request's digest that follow its mark."""


class _Answer(msgspec.Struct, frozen=True):
    status: int
    body: bytes
    media_type: str | None

    def response(self) -> Response:
        return Response(self.body, self.status, media_type=self.media_type)


class _Request:
    """``asked`` is a digest of the whole request; ``answer`` is set when the request has been carried out."""

    def __init__(self, path: str, asked: str, answer: asyncio.Task[_Answer]) -> None:
        self.path, self.asked, self.answer = path, asked, answer
        self.size = 0


class IdempotentAnswers:
    """A request with a key is carried out once: a repetition gets the same answer, also while the first one
    is still in progress."""

    def __init__(self, most: int = MOST, most_bytes: int = MOST_BYTES) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._requests: dict[tuple[str, str], _Request] = {}
        self._bytes = 0

    async def recall(self, key: str, asked: str, user: str) -> Response | None:
        """The answer to an earlier request with this key, if it was the same request; None if there is none.
        Raises the error that the earlier request raised."""
        known = self._requests.get((user, key))
        if known is None or known.asked != asked:
            return None
        return (await asyncio.shield(known.answer)).response()

    async def answer_once(
        self,
        key: str,
        path: str,
        asked: str,
        work: Callable[[], Awaitable[Response]],
        *,
        user: str = "",
        logs_key: bool,
        logged: LoggedRequest | None = None,
    ) -> Response:
        """The answer to a request of a ``user``; answers are kept by user, so no user receives the answer to
        another user's request. A refusal is not kept, as it changed nothing and may not hold later.
        ``logs_key``: the log shows whether a key was used; without it, a request that may have been carried
        out is not tried again. ``logged`` finds the answer of an earlier process. Raises KeyReused if the key
        belongs to another request."""
        mine = user, key
        known = self._requests.get(mine)
        if known is None:
            if logged is not None:
                work = partial(_carry_out_marked, logged, work)
            task = asyncio.get_running_loop().create_task(_carry_out(work, logs_key))
            known = self._requests[mine] = _Request(path, asked, task)
            task.add_done_callback(lambda _: self._keep(mine, known))
        elif known.asked != asked:
            if logs_key and known.path == path:
                if not known.answer.done():
                    await asyncio.wait([known.answer])
                    return await self.answer_once(key, path, asked, work, user=user, logs_key=logs_key)
                await work()  # the log shows any difference
            raise _refuse_reused(key, _find_answer(known))
        return (await asyncio.shield(known.answer)).response()

    def _keep(self, key: tuple[str, str], request: _Request) -> None:
        """Keep the answer; the oldest ones are removed if there are too many."""
        task = request.answer
        if task.cancelled() or task.exception() is not None:
            self._requests.pop(key, None)
            return
        request.size = len(task.result().body)
        self._bytes += request.size
        for name, old in list(self._requests.items()):
            if len(self._requests) <= self._most and self._bytes <= self._most_bytes:
                break
            if old.answer.done():
                del self._requests[name]
                self._bytes -= old.size


def mark_of(user: str, path: str, key: str) -> str:
    """The mark of a request in the log; the key cannot be computed from it."""
    return PREFIX + digest(msgspec.json.encode((user, path, key)))[:32]


class LoggedRequest(msgspec.Struct, frozen=True):
    """A request that may be in the log: ``mark`` is in its first event, ``asked`` is a digest of the whole
    request; ``answer`` computes the answer to the request with a mark whose first event is at a position."""

    marks: Marks
    mark: str
    key: str
    asked: str
    answer: Callable[[str, int], Awaitable[Response]]

    async def is_known(self) -> bool:
        """Whether it was carried out. Raises StoreUnavailable, and KeyReused if its key belongs to another
        request."""
        if not await self.marks.find(self.mark):
            return False
        asked = self.marks.find_digest(self.mark)
        if asked and asked != self.asked[: len(asked)]:
            raise _refuse_reused(self.key)
        return True

    async def find_answer(self) -> Response:
        """The answer to a known request. Raises AlreadyDone."""
        return await self.answer(self.mark, await self.marks.find(self.mark))


async def _carry_out_marked(logged: LoggedRequest, work: Callable[[], Awaitable[Response]]) -> Response:
    """Carry out a request under its mark, unless the mark is in the log. Raises AlreadyDone, KeyReused."""
    if await logged.is_known():
        return await logged.find_answer()
    MARK.set(f"{logged.mark}:{logged.asked[:ASKED]}")
    return await work()


def _refuse_reused(key: str, more: str = "") -> KeyReused:
    return KeyReused(
        f"The key {key!r} belongs to another request.{more}",
        remedy="Give each request its own key. Use the same key only to repeat a request.",
    )


async def _carry_out(work: Callable[[], Awaitable[Response]], logs_key: bool) -> _Answer:
    try:
        found = await work()
    except LabosError as error:
        if logs_key or not isinstance(error, CommitInDoubt):
            raise
        found = send_problem(make_problem_of_error(error))
    return _Answer(found.status_code, bytes(found.body), found.media_type)


def _find_answer(request: _Request) -> str:
    """The answer to the request with a key, as far as it is known."""
    if not request.answer.done():
        return " It is being carried out."
    return f" It was answered {request.answer.result().body[:200].decode(errors='replace')}."
