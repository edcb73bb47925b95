"""The kernel's side for one node, without a lab: it gives the node its settings, and sends requests."""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from labos.bus import ZenohBus, open_bus
from labos.clock import Uuid7Ids
from labos.errors import NoAnswer
from labos.node.protocol import (
    AboutReport,
    ActionReply,
    AdminReply,
    AdminRequest,
    Ask,
    Keys,
    Message,
    Outcome,
    ResourcesReport,
    SetupReply,
    Start,
    StateReport,
)
from labos.runtime.files import FileDesk
from labos.store import FolderBlobs

T = TypeVar("T")

ANSWER_S = 10.0
POLL_S = 0.02

_encode = msgspec.json.Encoder().encode


class Kernel:
    """Sends the requests of a kernel to one module's node. ``setup`` has the settings for which the node
    asks."""

    def __init__(self, bus: ZenohBus, endpoint: str, module: str, setup: SetupReply, home: Path) -> None:
        self.endpoint, self.module = endpoint, module
        self.lab = Uuid7Ids().new()
        self.epoch = 1
        self.journal = ""
        self._bus, self._setup = bus, setup
        self._keys = Keys(self.lab)
        self._alive: set[str] = set()
        self._numbers = itertools.count(1)
        self._desk = FileDesk(FolderBlobs(home / "blobs"), home / "arriving")

    @classmethod
    async def open(cls, module: str, setup: SetupReply, home: Path) -> Kernel:
        """Open it with its own bus."""
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        bus = await open_bus(mode="router", listen=[endpoint])
        kernel = cls(bus, endpoint, module, setup, home)
        await bus.serve(kernel._keys.setup, kernel._on_setup)
        await bus.serve(kernel._keys.files, kernel._desk.on_request)
        await bus.watch_alive(kernel._keys.all_alive, kernel._note_alive)
        await bus.declare_alive(kernel._keys.kernel)
        return kernel

    async def close(self) -> None:
        await self._bus.close()

    @property
    def node_lives(self) -> bool:
        """Whether a node of the module is alive on the bus."""
        return bool(self._alive)

    # -- requests ----------------------------------------------------------------------------

    def request(self, name: str, args: dict[str, Any]) -> Start:
        """A first attempt at a new action."""
        number = next(self._numbers)
        return Start(self.lab, self.epoch, self.journal, f"a{number}", 1, number, name, args)

    async def send(self, message: Message) -> ActionReply:
        return await self._query("action", message, ActionReply)

    async def ask(self, start: Start) -> ActionReply:
        """Ask for the outcome of an attempt."""
        asked = Ask(self.lab, self.epoch, start.action, start.attempt, start.position)
        return await self._query("action", asked, ActionReply)

    async def outcome(self, start: Start, limit_s: float) -> Outcome | None:
        """Wait for the outcome of an attempt; None if there is none within the time, or it is unknown."""
        deadline = asyncio.get_running_loop().time() + limit_s
        while asyncio.get_running_loop().time() < deadline:
            reply = await self.ask(start)
            if reply.status != "running":
                return reply.outcome
            await asyncio.sleep(POLL_S)
        return None

    async def about(self) -> AboutReport:
        return await self._query("about", None, AboutReport)

    async def state(self) -> StateReport:
        return await self._query("state", None, StateReport)

    async def resources(self) -> ResourcesReport:
        return await self._query("resources", None, ResourcesReport)

    async def admin(self, command: str, limit_s: float = ANSWER_S, **args: Any) -> AdminReply:
        request = AdminRequest(self.lab, self.epoch, command, args)
        return await self._query("admin", request, AdminReply, limit_s)

    async def await_state(self, reached: Callable[[StateReport], bool], limit_s: float) -> StateReport | None:
        """Wait for a state, and return it; None if it is not reached within the time, or there is no
        answer."""
        deadline = asyncio.get_running_loop().time() + limit_s
        while asyncio.get_running_loop().time() < deadline:
            try:
                state = await self.state()
                if reached(state):
                    return state
            except NoAnswer:
                pass
            await asyncio.sleep(POLL_S)
        return None

    # -- internal ----------------------------------------------------------------------------

    async def _query(self, operation: str, message: Any, kind: type[T], limit_s: float = ANSWER_S) -> T:
        key = self._keys.operation(self.module, operation)
        return msgspec.json.decode(await self._bus.query(key, _encode(message), limit_s), type=kind)

    async def _on_setup(self, _: bytes) -> bytes:
        return _encode(self._setup)

    def _note_alive(self, key: str, living: bool) -> None:
        (self._alive.add if living else self._alive.discard)(key)
