"""The connection from an API process to the kernel.

As far as the log is enough, a request is handled here: a request that only reads is answered, and one that
the rules forbid is refused. The other requests are sent to the kernel (``SendOn``). The kernel also receives
every idempotency key, as another API process may have handled a request with it before.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

import msgspec
import structlog
from starlette.responses import Response

from labos.errors import BusError, KernelAway, LabosError
from labos.http import wire
from labos.http.idempotency import LoggedRequest
from labos.http.letters import (
    Hello,
    KernelAnswer,
    LetterReply,
    LetterRequest,
    Letters,
    Recall,
    SentOn,
    Welcome,
)
from labos.http.notes import Notes
from labos.node.protocol import Keys
from labos.ports import Bus
from labos.runtime.followed import Behind, FollowedKernel, SendOn

if TYPE_CHECKING:
    from labos.http.operation import AdmittedRequest, Operation

ANSWER_S = 70.0
"""How long the kernel may take: a little longer than the longest wait that a request may demand."""
RECALL_S = 5.0
AT_ONCE = 16
"""The number of requests of one API process that the kernel handles at the same time; others wait here."""
HELLO_S = 2.0
PASSED_ON = re.compile(rb"content-type|idempotency-key|labos-user|last-event-id|range|if-range|if-none-match")
"""The headers of a request that handlers read."""
OWN = (b"content-length", b"labos-position")
"""The headers of an answer that are written anew."""

AGAIN = "Repeat the request in a moment, with the same Idempotency-Key: nothing is done twice."
NO_KEY = (
    "Check what was done before you repeat the request (labos log). Send an Idempotency-Key: then nothing "
    "is done twice."
)

_log = structlog.get_logger(__name__)


class Work:
    """The number of answers for metrics: answered here, by the kernel, or with the error that the kernel is
    away."""

    def __init__(self) -> None:
        self.here = self.by_kernel = self.away = 0
        self.kernel_s = 0.0


class KernelLink:
    """Sends requests to the kernel under the ``name`` of this process."""

    def __init__(self, kernel: FollowedKernel, bus: Bus, letters: Letters, name: str) -> None:
        self._kernel, self._bus, self._letters, self._name = kernel, bus, letters, name
        self.notes = Notes()
        self.work = Work()
        self.address = ""
        self.is_there = False
        """Whether the kernel answered the last request."""
        self._turn = asyncio.Semaphore(AT_ONCE)
        self._gone: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        """Completed when the present kernel has gone."""
        self._task: asyncio.Task[None] | None = None

    # -- start and end -----------------------------------------------------------------------

    async def start(self) -> None:
        await self._bus.watch_alive(Keys(self._kernel.lab).kernel, self._on_alive)
        self._task = asyncio.get_running_loop().create_task(self._greet())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    def _on_alive(self, key: str, alive: bool) -> None:
        """A kernel that has gone will not answer any more."""
        if not alive:
            self.is_there = False
            self._gone.set_result(None)
            self._gone = asyncio.get_running_loop().create_future()

    async def _greet(self) -> None:
        while True:
            try:
                reply = await self._ask(Hello(self.address), RECALL_S)
                if isinstance(reply, Welcome):
                    self.notes = reply.notes
                    self._kernel.suspended = reply.notes.suspended
            except KernelAway:
                pass  # the next request reports it
            except Exception:
                _log.exception("kernel_not_greeted")
            await asyncio.sleep(HELLO_S)

    # -- requests ----------------------------------------------------------------------------

    async def up_to_date(self, at_least: int) -> None:
        """Raises StoreUnavailable, Behind."""
        await self._kernel.wait_until_known(at_least)

    async def answer(
        self,
        operation: Operation,
        asked: AdmittedRequest,
        logged: LoggedRequest | None,
        work: Callable[[], Awaitable[Response]],
    ) -> Response:
        """The answer to a request; ``logged`` finds it in the log, ``work`` calls its handler on the followed
        log. Raises KernelAway, and the errors of the handler."""
        if logged is not None and await logged.is_known():
            # The kernel keeps its answers; the log has them too, but reading it takes longer.
            known = await self._recall(asked)
            return known if known is not None else await logged.find_answer()
        if operation.at_kernel:
            return await self._send_on(asked)
        try:
            found: Response | LabosError = await work()
        except SendOn:
            return await self._send_on(asked)
        except LabosError as error:
            found = error
        if asked.key and (known := await self._recall(asked)) is not None:
            return known
        self.work.here += 1
        if isinstance(found, LabosError):
            raise found
        return found

    async def _send_on(self, asked: AdmittedRequest) -> Response:
        request, loop = asked.request, asyncio.get_running_loop()
        headers = tuple(
            (name, value) for name, value in request.scope["headers"] if PASSED_ON.fullmatch(name)
        )
        body = asked.arguments.get("body")
        letter = SentOn(
            request.method,
            request.scope["path"],
            request.scope["query_string"],
            headers,
            msgspec.json.encode(body) if body is not None else b"",
            asked.who,
            request.client.host if request.client is not None else "",
        )
        async with self._turn:
            began = loop.time()
            try:
                reply = await self._ask(letter, ANSWER_S)
            except KernelAway as error:
                self.work.away += 1
                can_repeat = request.method == "GET" or asked.key
                raise KernelAway(error.message, remedy=AGAIN if can_repeat else NO_KEY) from None
            self.work.kernel_s += loop.time() - began
        self.work.by_kernel += 1
        assert isinstance(reply, KernelAnswer)
        return await self._response(reply)

    async def _recall(self, asked: AdmittedRequest) -> Response | None:
        """The kernel's answer to an earlier request with this key; None if it has none, or is away."""
        try:
            reply = await self._ask(
                Recall(asked.request.url.path, asked.key, asked.digest, asked.who.user), RECALL_S
            )
        except KernelAway:
            return None
        return await self._response(reply) if isinstance(reply, KernelAnswer) and reply.status else None

    async def _response(self, reply: KernelAnswer) -> Response:
        try:
            await self._kernel.wait_until_known(reply.position)  # the next reader sees this change
        except Behind:
            pass  # a reader who names the position waits for it
        found = Response(reply.body, reply.status)
        found.raw_headers = [
            *((name, value) for name, value in reply.headers if name not in OWN),
            (b"content-length", b"%d" % len(reply.body)),
            (wire.POSITION.encode(), b"%d" % reply.position),
        ]
        return found

    async def _ask(self, question: LetterRequest, within_s: float) -> LetterReply:
        """Raises KernelAway."""
        key = Keys(self._kernel.lab).requests_of(self._name, self._kernel.epoch)
        payload, nonce = self._letters.ask(question)
        asking = asyncio.ensure_future(self._bus.query(key, payload, within_s))
        either: set[asyncio.Future[Any]] = {asking, self._gone}
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not asking.done():
                raise self._report_away("it is gone")
            reply = self._letters.read_reply(asking.result(), nonce)
        except BusError as error:
            raise self._report_away(error.message) from None
        finally:
            asking.cancel()
        self.is_there = True
        return reply

    def _report_away(self, why: str) -> KernelAway:
        self.is_there = False
        known = "whether the request was carried out is not known"
        return KernelAway(f"The kernel gave no answer, and {known} ({why.rstrip('.')}).")
