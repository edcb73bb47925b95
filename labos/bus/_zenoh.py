"""The bus on Eclipse Zenoh.

Zenoh calls back on its own receive threads; the callbacks here only pass messages to the event loop.
Queryables are declared complete, and queries go to the best matching one. Otherwise two nodes with the same
name would both carry out an action.
"""

from __future__ import annotations

import asyncio
import atexit
import weakref
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Any

import structlog
import zenoh
from zenoh.handlers import Callback

from labos.bus._access import ROUND_TRIP
from labos.bus._connection import CHECK_S, keep_connected
from labos.bus._declared import Declared, Guarded, KeyWatch, Waiting
from labos.bus._opening import Mode, Opening, reason_of
from labos.bus._security import Security
from labos.errors import BusError, LabosError, NoAnswer
from labos.ports import AliveListener, Handle, Handler, Listener

LARGEST_MESSAGE = 64 * 1024 * 1024
"""The most bytes of a message from the bus; larger ones are dropped."""

LONGEST_REASON = 1000
"""The most characters of an error in an answer."""

RETURN_S = 5.0
"""After a session was opened again, parties that lived before have this long to show themselves again."""

REOPEN_S = 0.2
"""The first pause between two attempts to open a session anew; each doubles, up to 2 s."""

_log = structlog.get_logger(__name__)
_open_sessions: weakref.WeakSet[ZenohBus] = weakref.WeakSet()


async def open_bus(
    *,
    mode: Mode = "client",
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    security: Security | None = None,
) -> ZenohBus:
    """Join the bus. Endpoints have the form ``tcp/127.0.0.1:7447``, or ``tls/127.0.0.1:7447`` with
    ``security``. All others connect to the ``router``. A client raises BusError if there is no router, or if
    it is refused. Peers and routers keep trying; a peer's declarations reach others shortly after the call
    returns. Raises BadInput for an address of the wrong kind.
    """
    opening = Opening(mode, tuple(listen), tuple(connect))
    bus = ZenohBus(await opening.open(security), asyncio.get_running_loop(), opening, security)
    if mode == "router":
        await bus.declare_alive(ROUND_TRIP)
    elif mode == "client":
        bus.keep_connected()
    return bus


class Traffic:
    """The traffic of a session since it was opened."""

    def __init__(self) -> None:
        self.queries = self.unanswered = self.published = self.dropped = 0


class ZenohBus:
    """A session on the bus; belongs to the event loop that opened it. Made by ``open_bus``."""

    def __init__(
        self, session: Any, loop: asyncio.AbstractEventLoop, opening: Opening, security: Security | None
    ) -> None:
        self._session = session
        self._loop = loop
        self._opening = opening
        self._security = security
        # Both since the present session was opened.
        self._has_received = self._has_seen_router = False
        self._keeping: asyncio.Task[None] | None = None
        self._ready = asyncio.Event()
        self._ready.set()
        self._opening_anew = asyncio.Lock()
        self._reopening: asyncio.Task[None] | None = None
        self.traffic = Traffic()
        self._handles: dict[Declared, None] = {}  # in the order in which they were declared
        self._watches: dict[Declared, KeyWatch] = {}
        self._served: list[tuple[str, Declared]] = []
        self._answering: set[asyncio.Task[None]] = set()
        self._closed = False
        _open_sessions.add(self)

    async def query(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        """Ask the process that serves ``key``; see ``ports.Bus``."""
        await self._wait_until_ready()
        self.traffic.queries += 1
        replies: list[Any] = []
        settled: asyncio.Future[None] = self._loop.create_future()

        def settle() -> None:
            if not settled.done():
                settled.set_result(None)

        def on_reply(reply: Any) -> None:
            if not replies:  # the first answer counts; a faulty process may send thousands
                replies.append(reply)
                self._receive(settle)

        def on_end() -> None:
            if not replies:
                self._hand_over(settle)

        try:
            self._session.get(
                key,
                Callback(on_reply, on_end, indirect=False),
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.BEST_MATCHING,
                consolidation=zenoh.ConsolidationMode.NONE,
                allowed_destination=self._find_destination(key),
            )
        except zenoh.ZError as error:
            raise BusError(f"The query to {key!r} could not be sent: {reason_of(error)}.") from error
        # Zenoh has its own time-out; this one is for a session that has died.
        late = self._loop.call_later(timeout_s + 0.5, settle)
        try:
            await settled
        finally:
            late.cancel()
        try:
            return _answer(key, replies, timeout_s)
        except NoAnswer:
            self.traffic.unanswered += 1
            raise

    async def serve(self, key: str, handler: Handler) -> Handle:
        """Answer queries for ``key``, each in its own task; returns when the router knows the declaration."""
        return await self.serve_all(key, lambda _, payload: handler(payload))

    async def serve_all(self, key: str, handler: Callable[[str, bytes], Awaitable[bytes]]) -> Handle:
        """The same for all keys of a form such as ``labos/L/@setup/*/*``; the handler gets the key."""

        waiting = Waiting()

        def finish(task: asyncio.Task[None]) -> None:
            waiting.taken += 1
            self._answering.discard(task)

        def start(query: Any) -> None:
            if self._closed:
                query.drop()
                return
            task = self._loop.create_task(self._answer(key, query, handler))
            self._answering.add(task)
            task.add_done_callback(finish)

        def on_query(query: Any) -> None:
            if waiting.take_place():
                self._receive(start, query)
            else:  # it is finalised here: the caller is informed at once
                self.traffic.dropped += 1

        handle = await self._declare(
            key,
            lambda: self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True),
        )
        self._served = [*(served for served in self._served if not served[1].closed), (key, handle)]
        return handle

    async def publish(self, key: str, payload: bytes) -> None:
        """Send to all subscribers. If the network is congested, this waits and drops nothing."""
        await self._wait_until_ready()
        try:
            self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        except zenoh.ZError as error:
            raise BusError(f"The publication on {key!r} could not be sent: {reason_of(error)}.") from error
        self.traffic.published += 1

    async def subscribe(self, keys: str, listener: Listener) -> Handle:
        """Call ``listener(key, payload)`` on the event loop for each publication, in order."""

        waiting = Waiting()

        def take(key: str, payload: bytes) -> None:
            waiting.taken += 1
            deliver(key, payload)

        def on_sample(sample: Any) -> None:
            if len(sample.payload) <= LARGEST_MESSAGE and waiting.take_place():
                self._receive(take, str(sample.key_expr), sample.payload.to_bytes())
            else:
                self.traffic.dropped += 1

        deliver = Guarded(listener)
        handle = await self._declare(
            keys, lambda: self._session.declare_subscriber(keys, Callback(on_sample, indirect=False))
        )
        deliver.handle = handle
        return handle

    async def declare_alive(self, key: str) -> Handle:
        """Show ``key`` to watchers until closed, or until the process dies or freezes."""
        return await self._declare(key, lambda: self._session.liveliness().declare_token(key))

    async def watch_alive(self, keys: str, listener: AliveListener) -> Handle:
        """Call ``listener(key, alive)`` on the event loop; keys that are alive now are reported first."""
        deliver = Guarded(listener)
        watch = KeyWatch(deliver)

        def on_token(sample: Any) -> None:
            self._receive(watch.note, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        handle = await self._declare(
            keys,
            lambda: self._session.liveliness().declare_subscriber(
                keys, Callback(on_token, indirect=False), history=True
            ),
        )
        deliver.handle = handle
        self._watches[handle] = watch
        return handle

    def keep_connected(self, check_s: float = CHECK_S) -> None:
        """Connect again if the router of the connection was closed without Zenoh's notice; see
        ``_connection``."""

        async def reopen() -> None:
            if self._ready.is_set():
                await self.reopen(self._security)

        self._keeping = self._loop.create_task(keep_connected(self._is_router_open, reopen, check_s))

    async def reopen(self, security: Security | None) -> None:
        """Open the session again, with other certificates or rules, which cannot be changed in an open
        session. All declarations are repeated. Parties that lived before are reported as gone only if they do
        not come back. It is tried until it succeeds, because there is no other session."""
        self._check_open()
        self._security = security
        self._reopening = self._loop.create_task(self._reopen(security))
        await asyncio.shield(self._reopening)  # otherwise a half-open session would be left

    def list_connected(self) -> list[str]:
        """The common names of the certificates of connected parties, one for each connection, if this session
        runs a secure bus."""
        if self._closed or not self._ready.is_set():
            return []
        return [link.auth_identifier for link in self._session.info.links() if link.auth_identifier]

    async def close(self) -> None:
        """Leave the bus: undeclare everything and end all handlers. May be called again."""
        if self._closed:
            return
        self._closed = True
        if self._keeping is not None:
            self._keeping.cancel()
        self._ready.set()  # waiting callers are informed that it is closed
        if self._reopening is not None:
            await asyncio.wait({self._reopening})
        for task in list(self._answering):
            task.cancel()
        if self._answering:
            await asyncio.gather(*self._answering, return_exceptions=True)
        await asyncio.to_thread(self._close_session)

    # -- inside ------------------------------------------------------------------------------

    async def _answer(self, key: str, query: Any, handler: Callable[[str, bytes], Awaitable[bytes]]) -> None:
        # Leaving the block finalises the query: the caller is informed at once that no reply will come.
        with query:
            payload = query.payload
            if "*" in key:
                key = str(query.key_expr)
            try:
                reply = await handler(key, payload.to_bytes() if payload is not None else b"")
            except Exception as error:
                _log.exception("handler_failed", key=key)
                reply, failed = f"{type(error).__name__}: {error}".encode(), True
            else:
                failed = False
            try:
                query.reply_err(reply) if failed else query.reply(key, reply)
            except zenoh.ZError as error:
                _log.warning("reply_not_sent", key=key, error=str(error))

    def _find_destination(self, key: str) -> Any:
        """The locality of answers: Zenoh chooses the best of the others, but would also query its own
        session."""
        ours = any(served == key and not handle.closed for served, handle in self._served)
        return zenoh.Locality.SESSION_LOCAL if ours else zenoh.Locality.REMOTE

    async def _declare(self, key: str, declare: Callable[[], Any]) -> Declared:
        await self._wait_until_ready()
        try:
            handle = Declared(declare, self._handles)
        except zenoh.ZError as error:
            raise BusError(f"{key!r} could not be declared on the bus: {reason_of(error)}.") from error
        # A router knows its own declarations at once. It answers itself with its tables locked: if Python
        # frees a declaration at that moment, the thread waits without end for its own lock.
        if self._opening.mode != "router":
            await self._round_trip()
        return handle

    async def _round_trip(self) -> bool | None:
        """Wait until the router has received this session's earlier declarations: it answers in order.
        Returns whether the router showed its key; None if it did not answer in time."""
        done = asyncio.Event()
        replies: list[bool] = []
        answered: Any = Callback(
            lambda reply: replies.append(reply.ok is not None),
            lambda: self._hand_over(done.set),
            indirect=False,
        )
        self._session.liveliness().get(ROUND_TRIP, answered, timeout=1.0)
        with suppress(TimeoutError):
            await asyncio.wait_for(done.wait(), 1.5)
            self._has_seen_router = self._has_seen_router or any(replies)
            return None if replies and not any(replies) else bool(replies)
        return None

    async def _is_router_open(self) -> bool | None:
        """Whether the router of the connection shows its key. None if this is not known: there is no
        connection, or no answer, or the router is of another kind, which never shows one."""
        await self._wait_until_ready()
        try:
            found = await self._round_trip()
            is_connected = bool(self._session.info.routers_zid())
        except zenoh.ZError:  # the session is being closed
            return None
        if not found and (not is_connected or (self._has_received and not self._has_seen_router)):
            return None
        return found

    def _receive(self, function: Callable[..., object], *args: Any) -> None:
        """Hand a message from the bus over to the event loop."""
        self._has_received = True
        self._hand_over(function, *args)

    def _hand_over(self, function: Callable[..., object], *args: Any) -> None:
        with suppress(RuntimeError):  # the loop has been closed; there is no task to inform
            self._loop.call_soon_threadsafe(function, *args)

    def _check_open(self) -> None:
        if self._closed:
            raise BusError("The bus has been closed.")

    async def _reopen(self, security: Security | None) -> None:
        async with self._opening_anew:
            await self._open_anew(security)

    async def _open_anew(self, security: Security | None) -> None:
        self._ready.clear()
        handles = [handle for handle in self._handles if not handle.closed]
        await asyncio.to_thread(self._end_session, handles)
        self._has_received = self._has_seen_router = False
        pause, logged = REOPEN_S, ""
        while not self._closed:
            try:
                self._session = await self._opening.open(security)
                break
            except LabosError as error:
                if str(error) != logged:
                    _log.warning("bus_not_reopened", why=str(error))
                    logged = str(error)
            await asyncio.sleep(pause)
            pause = min(pause * 2, 2.0)
        if self._closed:
            await asyncio.to_thread(self._session.close)
            return
        for handle, watch in list(self._watches.items()):
            if handle.closed:
                del self._watches[handle]
                continue
            self._loop.call_later(RETURN_S, watch.miss, watch.await_return())
        for handle in handles:
            handle.declare_again()
        self._ready.set()

    async def _wait_until_ready(self) -> None:
        """Wait while the session is opened again. Raises BusError if it has been closed."""
        self._check_open()
        if not self._ready.is_set():
            await self._ready.wait()
            self._check_open()

    def _end_session(self, handles: Sequence[Declared]) -> None:
        """Undeclare everything first: nobody should be informed of the end of declarations that come back at
        once."""
        for handle in handles:
            handle.undeclare()
        self._session.close()

    def _close_session(self) -> None:
        _open_sessions.discard(self)
        for handle in list(self._handles):
            handle.close()
        self._session.close()


def _answer(key: str, replies: list[Any], timeout_s: float) -> bytes:
    if not replies:
        raise NoAnswer(f"Nobody answers to {key!r}.", remedy="Is its process running and connected?")
    reply = replies[0]
    if reply.ok is not None:
        return bytes(reply.ok.payload.to_bytes())
    text = reply.err.payload.to_bytes().decode(errors="replace")
    if text == "Timeout":
        raise NoAnswer(f"{key!r} did not answer within {timeout_s:g} s.")
    raise NoAnswer(f"{key!r} answered with an error: {text[:LONGEST_REASON]}.")


@atexit.register
def _close_leftovers() -> None:
    # An open session keeps the interpreter from ending.
    for bus in list(_open_sessions):
        bus._close_session()
