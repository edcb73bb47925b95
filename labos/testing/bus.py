"""A bus in memory that loses, duplicates, delays and reorders messages."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable

from labos.errors import NoAnswer
from labos.ports import AliveListener, Handler, Listener
from labos.testing.faults import Faults
from labos.testing.loop import PROCESS, Killed, Process, VirtualLoop, context_of

OVERTAKEN_S = 2.0
"""How long a message that is to be overtaken waits for another one."""


class Network:
    """The network to which all endpoints are connected."""

    def __init__(self, faults: Faults, loop: VirtualLoop) -> None:
        self.faults, self.loop = faults, loop
        self.servers: dict[str, list[tuple[Process, Handler]]] = {}
        self.subscribers: list[tuple[Process, re.Pattern[str], Listener]] = []
        self.watchers: list[tuple[Process, re.Pattern[str], AliveListener]] = []
        self.living: dict[str, Process] = {}
        self._held: dict[Process, Callable[[], None]] = {}
        self.serve_with: Callable[[str, Handler, bytes], Awaitable[bytes]] = _serve_directly
        """Delivers requests to the process that serves a key; a test may listen here."""

    def endpoint(self, process: Process) -> SimulatedBus:
        process.on_death.append(lambda: self._bury(process))
        return SimulatedBus(self, process)

    def _bury(self, process: Process) -> None:
        """Remove the tokens of a dead process; watchers are notified after a while."""
        for key in [key for key, owner in self.living.items() if owner is process]:
            self.forget(key)
        for key, servers in list(self.servers.items()):
            self.servers[key] = [entry for entry in servers if entry[0] is not process]
        self.subscribers = [entry for entry in self.subscribers if entry[0] is not process]
        self.watchers = [entry for entry in self.watchers if entry[0] is not process]
        self._held.pop(process, None)

    def forget(self, key: str) -> None:
        if self.living.pop(key, None) is not None:
            for process, pattern, listener in list(self.watchers):
                if pattern.fullmatch(key):
                    self.deliver(process, listener, key, False)

    def deliver(self, process: Process, callback: Callable[..., object], *args: object) -> None:
        """Call back in a process's context after a delay, if the process is still alive then."""
        loop, context = self.loop, context_of(process)
        if not self.faults.chance("reordering"):
            loop.call_later(self.faults.delay(), callback, *args, context=context)
            return

        def hand_over() -> None:
            loop.call_soon(callback, *args, context=context)

        loop.call_later(self.faults.delay(), self.arrive, process, hand_over, context=context_of(None))

    def arrive(self, process: Process, hand_over: Callable[[], None]) -> None:
        """A message arrives at a process. A message that is held back is delivered after the next one."""
        held = self._held.pop(process, None)
        if held is not None:
            self.faults.record("reordering")
            hand_over()
            held()
        elif self.faults.waits_for_next():
            self._held[process] = hand_over
            self.loop.call_later(
                OVERTAKEN_S, self._hand_over_late, process, hand_over, context=context_of(None)
            )
        else:
            hand_over()

    def _hand_over_late(self, process: Process, hand_over: Callable[[], None]) -> None:
        if self._held.get(process) is hand_over:
            del self._held[process]
            hand_over()


def pattern_of(keys: str) -> re.Pattern[str]:
    """Convert a key expression to a regular expression: ``*`` is one part, ``**`` any number of parts."""
    parts = [".*" if part == "**" else re.escape(part).replace(r"\*", "[^/]*") for part in keys.split("/")]
    return re.compile("/".join(parts))


class _Handle:
    def __init__(self, close: Callable[[], None]) -> None:
        self._close: Callable[[], None] | None = close

    def close(self) -> None:
        if self._close is not None:
            close, self._close = self._close, None
            close()


class SimulatedBus:
    """The bus port of one simulated process."""

    def __init__(self, network: Network, process: Process) -> None:
        self._net, self._process = network, process
        self._role = "kernel" if process.name.startswith("kernel") else "node"

    async def query(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        faults = self._net.faults
        await faults.pass_point(f"{self._role}.before_send")
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        copies = 0 if faults.strikes("loss") else 2 if faults.strikes("duplication") else 1
        for _ in range(copies):
            self._carry(key, payload, answer)
        faults.visit(f"{self._role}.after_send")
        try:
            return await asyncio.wait_for(answer, timeout_s)
        except TimeoutError:
            raise NoAnswer(f"Nobody answered {key} within {timeout_s:g} s.") from None

    def _carry(self, key: str, payload: bytes, answer: asyncio.Future[bytes]) -> None:
        net, asker = self._net, self._process
        loop = net.loop

        def arrive() -> None:
            servers = net.servers.get(key)
            if not servers:
                net.deliver(asker, _fail, answer, key)
                return
            process, handler = servers[0]

            def hand_over() -> None:
                loop.start(process, _serve(net, key, handler, payload, asker, answer))

            net.arrive(process, hand_over)

        # Outside the context of a process: a message on its way outlives its sender.
        loop.call_later(net.faults.delay(), arrive, context=context_of(None))

    async def serve(self, key: str, handler: Handler) -> _Handle:
        entry = (self._process, handler)
        self._net.servers.setdefault(key, []).append(entry)

        def close() -> None:
            if entry in self._net.servers.get(key, []):
                self._net.servers[key].remove(entry)

        return _Handle(close)

    async def publish(self, key: str, payload: bytes) -> None:
        faults = self._net.faults
        await faults.pass_point(f"{self._role}.before_send")
        for process, pattern, listener in list(self._net.subscribers):
            if not pattern.fullmatch(key) or faults.strikes("loss"):
                continue
            for _ in range(2 if faults.strikes("duplication") else 1):
                self._net.deliver(process, listener, key, payload)
        faults.visit(f"{self._role}.after_send")

    async def subscribe(self, keys: str, listener: Listener) -> _Handle:
        entry = (self._process, pattern_of(keys), listener)
        self._net.subscribers.append(entry)
        return _Handle(
            lambda: self._net.subscribers.remove(entry) if entry in self._net.subscribers else None
        )

    async def declare_alive(self, key: str) -> _Handle:
        self._net.living[key] = self._process
        for process, pattern, listener in list(self._net.watchers):
            if pattern.fullmatch(key):
                self._net.deliver(process, listener, key, True)
        return _Handle(lambda: self._net.forget(key))

    async def watch_alive(self, keys: str, listener: AliveListener) -> _Handle:
        entry = (self._process, pattern_of(keys), listener)
        self._net.watchers.append(entry)
        for key in list(self._net.living):
            if entry[1].fullmatch(key):
                self._net.deliver(self._process, listener, key, True)
        return _Handle(lambda: self._net.watchers.remove(entry) if entry in self._net.watchers else None)

    async def close(self) -> None:
        """Remove everything that this process declared."""
        self._net._bury(self._process)


async def _serve_directly(key: str, handler: Handler, payload: bytes) -> bytes:
    return await handler(payload)


async def _serve(
    net: Network, key: str, handler: Handler, payload: bytes, asker: Process, answer: asyncio.Future[bytes]
) -> None:
    try:
        reply = await net.serve_with(key, handler, payload)
        await net.faults.pass_point("node.before_send")
        if not net.faults.strikes("loss"):
            net.deliver(asker, _answer, answer, reply)
        net.faults.visit("node.after_send")
    except Killed:
        process = PROCESS.get()
        if process is not None:
            process.kill()


def _answer(answer: asyncio.Future[bytes], reply: bytes) -> None:
    if not answer.done():
        answer.set_result(reply)


def _fail(answer: asyncio.Future[bytes], key: str) -> None:
    if not answer.done():
        answer.set_exception(NoAnswer(f"Nobody serves {key}."))
        answer.exception()  # the sender may have died since
