"""The bus on Eclipse Zenoh.

Zenoh calls back on its own receive threads; the callbacks here only hand over to the event
loop. Queryables are declared complete and queries go to the best matching one: otherwise two
nodes of one name would both carry out an action.
"""

from __future__ import annotations

import asyncio
import atexit
import itertools
import json
import re
import weakref
from collections.abc import Callable, Sequence
from typing import Any, Literal

import structlog
import zenoh
from zenoh.handlers import Callback

from labos.errors import BusError, NoAnswer
from labos.ports import AliveListener, Handle, Handler, Listener

Mode = Literal["client", "peer", "router"]

LEASE_MS = 2000
"""A frozen process is taken for gone after this long."""

MOST_WAITING = 10_000
"""Publications of one subscription, or queries for one key, that wait to be handled. More are dropped:
whoever published tells it again, whoever asked gets no answer, and a flood must not take all memory."""

LARGEST_MESSAGE = 64 * 1024 * 1024
"""Bytes of a message that is taken from the bus."""

MOST_TOKENS = 65_536
"""Living keys that a watcher is told of."""

LONGEST_REASON = 1000
"""Characters of an error that an answer bears."""

_log = structlog.get_logger(__name__)
_open_sessions: weakref.WeakSet[ZenohBus] = weakref.WeakSet()


async def open_bus(
    *, mode: Mode = "client", listen: Sequence[str] = (), connect: Sequence[str] = ()
) -> ZenohBus:
    """Join the bus. Endpoints read ``tcp/127.0.0.1:7447``; a ``router`` is what everybody else
    connects to. A client raises BusError if nobody is there; peers and routers keep trying, and
    what a peer declares reaches others a moment after the call returns.
    """
    config = _config(mode, listen, connect)
    try:
        session = await asyncio.to_thread(zenoh.open, config)
    except zenoh.ZError as error:
        raise _opening_failed(_reason(error), listen, connect) from error
    return ZenohBus(session, asyncio.get_running_loop())


class ZenohBus:
    """A session on the bus; belongs to the event loop that opened it. Made by ``open_bus``."""

    def __init__(self, session: Any, loop: asyncio.AbstractEventLoop) -> None:
        self._session = session
        self._loop = loop
        self._handles: set[_Declared] = set()
        self._served: list[tuple[str, _Declared]] = []
        self._answering: set[asyncio.Task[None]] = set()
        self._closed = False
        _open_sessions.add(self)

    async def query(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        """Ask whoever serves ``key``; see ``ports.Bus``."""
        self._check_open()
        replies: list[Any] = []
        settled: asyncio.Future[None] = self._loop.create_future()

        def settle() -> None:
            if not settled.done():
                settled.set_result(None)

        def on_reply(reply: Any) -> None:
            if not replies:  # the first one counts; somebody may send thousands
                replies.append(reply)
                self._hand_over(settle)

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
                allowed_destination=self._destination(key),
            )
        except zenoh.ZError as error:
            raise BusError(f"The query to {key!r} could not be sent: {_reason(error)}.") from error
        # Zenoh keeps the time-out itself; this one is for a session that died under us.
        late = self._loop.call_later(timeout_s + 0.5, settle)
        try:
            await settled
        finally:
            late.cancel()
        return _answer(key, replies, timeout_s)

    async def serve(self, key: str, handler: Handler) -> Handle:
        """Answer queries for ``key``, each in a task of its own; returns when the router knows."""

        waiting = _Waiting()

        def done(task: asyncio.Task[None]) -> None:
            waiting.taken += 1
            self._answering.discard(task)

        def start(query: Any) -> None:
            if self._closed:
                query.drop()
                return
            task = self._loop.create_task(self._answer(key, query, handler))
            self._answering.add(task)
            task.add_done_callback(done)

        def on_query(query: Any) -> None:
            if waiting.takes_more():  # else it is finalised here: the asker learns at once
                self._hand_over(start, query)

        handle = await self._declare(
            key,
            lambda: self._session.declare_queryable(key, Callback(on_query, indirect=False), complete=True),
        )
        self._served.append((key, handle))
        return handle

    async def publish(self, key: str, payload: bytes) -> None:
        """Send to all who subscribed. Waits rather than drops when the network is congested."""
        self._check_open()
        try:
            self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        except zenoh.ZError as error:
            raise BusError(f"The publication on {key!r} could not be sent: {_reason(error)}.") from error

    async def subscribe(self, keys: str, listener: Listener) -> Handle:
        """Call ``listener(key, payload)`` on the event loop for each publication, in order."""

        waiting = _Waiting()

        def take(key: str, payload: bytes) -> None:
            waiting.taken += 1
            deliver(key, payload)

        def on_sample(sample: Any) -> None:
            if len(sample.payload) <= LARGEST_MESSAGE and waiting.takes_more():
                self._hand_over(take, str(sample.key_expr), sample.payload.to_bytes())

        deliver = _guarded(listener)
        handle = await self._declare(
            keys, lambda: self._session.declare_subscriber(keys, Callback(on_sample, indirect=False))
        )
        deliver.handle = handle
        return handle

    async def declare_alive(self, key: str) -> Handle:
        """Show ``key`` to watchers until closed, or until the process dies or freezes."""
        return await self._declare(key, lambda: self._session.liveliness().declare_token(key))

    async def watch_alive(self, keys: str, listener: AliveListener) -> Handle:
        """Call ``listener(key, alive)`` on the event loop; those alive now are told first."""
        alive: set[str] = set()

        def note(key: str, living: bool) -> None:
            # A router that restarts tells a token again.
            if living == (key in alive) or (living and len(alive) >= MOST_TOKENS):
                return
            (alive.add if living else alive.discard)(key)
            deliver(key, living)

        def on_token(sample: Any) -> None:
            self._hand_over(note, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        deliver = _guarded(listener)
        handle = await self._declare(
            keys,
            lambda: self._session.liveliness().declare_subscriber(
                keys, Callback(on_token, indirect=False), history=True
            ),
        )
        deliver.handle = handle
        return handle

    async def close(self) -> None:
        """Leave the bus: take everything back and end all handlers. May be called again."""
        if self._closed:
            return
        self._closed = True
        for task in list(self._answering):
            task.cancel()
        if self._answering:
            await asyncio.gather(*self._answering, return_exceptions=True)
        await asyncio.to_thread(self._close_session)

    # -- inside ------------------------------------------------------------------------------

    async def _answer(self, key: str, query: Any, handler: Handler) -> None:
        # Leaving the block finalises the query: the asker learns at once that no reply will come.
        with query:
            payload = query.payload
            try:
                reply = await handler(payload.to_bytes() if payload is not None else b"")
            except Exception as error:
                _log.exception("handler_failed", key=key)
                reply, failed = f"{type(error).__name__}: {error}".encode(), True
            else:
                failed = False
            try:
                query.reply_err(reply) if failed else query.reply(key, reply)
            except zenoh.ZError as error:
                _log.warning("reply_not_sent", key=key, error=str(error))

    def _destination(self, key: str) -> Any:
        """Who may answer: Zenoh picks the best of the others, but would ask its own session too."""
        self._served = [served for served in self._served if not served[1].closed]
        ours = any(served == key for served, _ in self._served)
        return zenoh.Locality.SESSION_LOCAL if ours else zenoh.Locality.REMOTE

    async def _declare(self, key: str, declare: Callable[[], Any]) -> _Declared:
        self._check_open()
        try:
            handle = _Declared(declare(), self._handles)
        except zenoh.ZError as error:
            raise BusError(f"{key!r} could not be declared on the bus: {_reason(error)}.") from error
        await self._round_trip()
        return handle

    async def _round_trip(self) -> None:
        """Wait until the router has seen what this session declared before: it answers in order."""
        done: asyncio.Future[None] = self._loop.create_future()

        def settle() -> None:
            if not done.done():
                done.set_result(None)

        self._session.liveliness().get(
            "labos/@round-trip",
            Callback(lambda _: None, lambda: self._hand_over(settle), indirect=False),
            timeout=1.0,
        )
        try:
            await asyncio.wait_for(done, 1.5)
        except TimeoutError:
            pass

    def _hand_over(self, function: Callable[..., object], *args: Any) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *args)
        except RuntimeError:
            pass  # The loop has been closed; nobody is left to be told.

    def _check_open(self) -> None:
        if self._closed:
            raise BusError("The bus has been closed.")

    def _close_session(self) -> None:
        _open_sessions.discard(self)
        for handle in list(self._handles):
            handle.close()
        self._session.close()


class _Declared:
    """Something declared on the bus."""

    def __init__(self, entity: Any, siblings: set[_Declared]) -> None:
        self._entity = entity
        self._siblings = siblings
        self.closed = False
        siblings.add(self)

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        self._siblings.discard(self)
        try:
            self._entity.undeclare()
        except zenoh.ZError as error:
            _log.debug("undeclare_failed", error=str(error))


class _Waiting:
    """How much was handed over to the event loop, and how much of it is done. The receiving threads count
    the one, the loop the other."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._given = 0
        self.taken = 0

    def takes_more(self) -> bool:
        """Whether one more may be handed over; it counts as handed over then."""
        if self._given - self.taken >= MOST_WAITING:
            return False
        self._given = next(self._numbers)
        return True


class _guarded:  # noqa: N801 - reads as the function it stands for
    """A listener that cannot hurt the loop, and that hears nothing after its handle is closed."""

    def __init__(self, listener: Callable[[str, Any], None]) -> None:
        self._listener = listener
        self.handle: _Declared | None = None

    def __call__(self, key: str, value: Any) -> None:
        if self.handle is not None and self.handle.closed:
            return
        try:
            self._listener(key, value)
        except Exception:
            _log.exception("listener_failed", key=key)


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


def _config(mode: Mode, listen: Sequence[str], connect: Sequence[str]) -> Any:
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # Labs find each other by address only, so that two on one network never mix.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        # Messages above 3 KB can vanish in shared memory when the receiver stalls.
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        # Who takes nothing for that long while others wait for it is frozen too; microseconds.
        "transport/link/tx/queue/congestion_control/block/wait_before_close": LEASE_MS * 1000,
    }
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise BusError(
                f"The bus cannot use {value!r} as {key}: {_reason(error)}.",
                remedy="Endpoints read like tcp/127.0.0.1:7447.",
            ) from error
    return config


def _opening_failed(reason: str, listen: Sequence[str], connect: Sequence[str]) -> BusError:
    where = ", ".join(connect if "connect" in reason else [*listen, *connect])
    if "in use" in reason or "os error 10048" in reason:
        return BusError(
            f"The address {where} of the bus is already in use.",
            remedy="Stop the other process (another `labos up`?) or choose another port.",
        )
    if "nable to connect" in reason:
        return BusError(
            f"Nobody answers at {where}.",
            remedy="Start the lab with `labos up`, or check the address and the firewall.",
        )
    return BusError(f"The bus cannot be opened at {where or 'no endpoint'}: {reason}.")


def _reason(error: Exception) -> str:
    """What Zenoh says, without the places in its source."""
    text = re.sub(r" at /\S+\.rs:\d+\.?|, location: Some\(Location \{.*?\}\)", "", str(error))
    return text.strip().rstrip(".")


@atexit.register
def _close_leftovers() -> None:
    # An open session keeps the interpreter from ending.
    for bus in list(_open_sessions):
        bus._close_session()
