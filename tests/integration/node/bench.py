"""A node with a world, its server, and a stand-in for the kernel."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Annotated, Any

import msgspec

from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.effects import Move
from labos.core.ids import StationName
from labos.node import DeviceError, Node, Param, Setup, World, action
from labos.node.journal import Journal, JournalFile
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import (
    AboutReport,
    Acknowledge,
    ActionMessage,
    ActionReply,
    AdminReply,
    AdminRequest,
    Ask,
    Keys,
    Outcome,
    ResultPublished,
    Start,
    StateReport,
)
from labos.node.server import NodeServer
from labos.ports import Bus
from tests.integration.bus.contract import until

LAB = "lab7"
MODULE = "cell/arm"


def nest(levels: int) -> Any:
    """A list in a list in a list."""
    value: list[Any] = []
    for _ in range(levels - 1):
        value = [value]
    return value


class Mute(Exception):
    """An error that cannot even say what it is."""

    def __str__(self) -> str:
        raise RuntimeError


class Arm(Node):
    """An arm that counts what it did."""

    driver = "arm"

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        assert setup.world is not None
        self.world = setup.world
        self.go = asyncio.Event()
        self.go_thread = threading.Event()
        self.idle = True
        self.present = True
        self.resets = 0
        self.stops = 0
        self.homes = 0
        self.go_reset = asyncio.Event()
        self.go_reset.set()
        self.sees: dict[str, Any] = {"labware": {"gripper": "empty"}, "grip": "open"}
        self.levels: dict[str, float] = {"tape": 12.5}
        self.trouble_now = ""
        self.handle = "run-17"

    async def connect(self) -> None:
        if not self.present:
            raise DeviceError("The arm is switched off.", remedy="Switch it on.")

    async def is_idle(self) -> bool:
        return self.idle

    async def reset(self) -> None:
        self.resets += 1
        self.world.work("arm", "reset")
        await self.go_reset.wait()

    async def stop(self) -> None:
        self.stops += 1
        self.go.set()

    async def observe(self) -> dict[str, Any]:
        return self.sees

    async def resources(self) -> dict[str, float]:
        return self.levels

    async def trouble(self) -> str:
        return self.trouble_now

    @action(aliases=("wave_hand",))
    async def wave(self, times: Annotated[int, Param(minimum=1, maximum=5)] = 1) -> int:
        """Move at once."""
        self.world.work("arm", "wave", times=times)
        return times

    @action()
    async def home(self) -> str:
        """Go home."""
        self.homes += 1
        return "at home"

    @action()
    async def wait(self) -> None:
        """Move, and go on until told."""
        self.world.work("arm", "wait")
        await self.go.wait()

    @action(Move(StationName("nest"), StationName("gripper")))
    async def pick(self) -> None:
        """Carry something, and go on until told."""
        self.world.work("arm", "pick")
        await self.go.wait()

    @action()
    def block(self) -> str:
        """Move, and block the thread until told."""
        self.world.work("arm", "block")
        if not self.go_thread.wait(10):
            raise TimeoutError
        return threading.current_thread().name

    @action(exclusive=False)
    async def look(self) -> str:
        """A pure query."""
        return "nothing"

    @action()
    async def with_handle(self) -> None:
        """Tell the device's own id."""
        await self.note_handle(self.handle)
        await self.go.wait()

    @action()
    async def fail(self, how: str) -> Any:
        """End badly in one of several ways."""
        match how:
            case "device":
                raise DeviceError("The gripper is jammed.", effects="partial", remedy="Free it.")
            case "harmless":
                raise DeviceError("The door is shut.", effects="none")
            case "surprise":
                raise KeyError("oops")
            case "crash":
                self.world.grip("arm", "nowhere")
            case "nan":
                return float("nan")
            case "object":
                return object()
            case "large":
                return "x" * 100_000
            case "integer":
                return {"count": 2**64}
            case "surrogate":
                return ["\ud800"]
            case "deep":
                return nest(200)
            case "endless":
                endless: list[Any] = []
                endless.append(endless)
                return endless
            case "long words":
                raise DeviceError("The gripper is jammed. " * 10_000, effects="none")
            case "odd words":
                raise DeviceError("jammed \ud800\x00\x1b[31m", effects="none")
            case "mute":
                raise Mute


class Kernel:
    """Asks a node what a kernel would ask."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.keys = Keys(LAB)
        self.epoch = 1
        self.journal = ""
        self.results: dict[str, ResultPublished] = {}
        self.states: list[StateReport] = []
        self.alive: dict[str, bool] = {}

    async def listen(self) -> None:
        def on_result(key: str, payload: bytes) -> None:
            result = msgspec.json.decode(payload, type=ResultPublished)
            assert key == self.keys.result(MODULE, result.action)
            self.results[result.action] = result

        await self.bus.subscribe(self.keys.all_results, on_result)
        await self.bus.subscribe(
            self.keys.all_states, lambda _, p: self.states.append(msgspec.json.decode(p, type=StateReport))
        )
        await self.bus.watch_alive(self.keys.all_alive, self.alive.__setitem__)

    async def send(self, message: ActionMessage) -> ActionReply:
        return await self._query("action", message, ActionReply)

    async def start(self, action: str, name: str = "wave", /, attempt: int = 1, **args: Any) -> ActionReply:
        reply = await self.send(self.request(action, name, attempt, **args))
        if reply.outcome is not None:
            told = ResultPublished(action, reply.attempt, reply.journal, reply.outcome)
            self.results.setdefault(action, told)
        return reply

    def request(self, action: str, name: str = "wave", attempt: int = 1, **args: Any) -> Start:
        position = int(action.strip("a")) * 10 + attempt
        return Start(LAB, self.epoch, self.journal, action, attempt, position, name, args)

    async def ask(self, action: str, attempt: int = 1, *, void: bool = False) -> ActionReply:
        position = int(action.strip("a")) * 10 + attempt
        return await self.send(Ask(LAB, self.epoch, action, attempt, position, void))

    async def acknowledge(self, position: int) -> ActionReply:
        return await self.send(Acknowledge(LAB, self.epoch, position))

    async def about(self) -> AboutReport:
        return await self._query("about", None, AboutReport)

    async def state(self) -> StateReport:
        return await self._query("state", None, StateReport)

    async def admin(self, command: str, *, epoch: int | None = None, **args: Any) -> AdminReply:
        request = AdminRequest(LAB, self.epoch if epoch is None else epoch, command, args)
        return await self._query("admin", request, AdminReply)

    async def reset(self, action: str, name: str = "reset", attempt: int = 1) -> ActionReply:
        """Send to the operation ``reset`` what ``start`` sends to ``action``."""
        return await self._query("reset", self.request(action, name, attempt), ActionReply)

    async def recover(self, action: str) -> Outcome:
        """Reset, and wait for the end of it."""
        reply = await self.reset(action)
        if reply.outcome is not None:
            return reply.outcome  # it was over at once
        assert reply.status == "accepted", reply
        return await self.outcome(action)

    async def outcome(self, action: str) -> Outcome:
        await until(lambda: action in self.results)
        return self.results[action].outcome

    async def _query(self, operation: str, message: Any, kind: Any) -> Any:
        key = self.keys.operation(MODULE, operation)
        return msgspec.json.decode(await self.bus.query(key, msgspec.json.encode(message), 5.0), type=kind)


class Bench:
    """One router, a kernel on it, and nodes that can be started and killed."""

    def __init__(self, folder: Path, stack: AsyncExitStack, kernel: Kernel, endpoint: str) -> None:
        self.folder = folder
        self.kernel = kernel
        self.endpoint = endpoint
        self.world = World(str(folder / "world.sqlite"))
        self._stack = stack
        stack.callback(self.world.close)

    async def bus(self) -> Bus:
        """For a node."""
        bus = await open_bus(connect=[self.endpoint])
        self._stack.push_async_callback(bus.close)
        return bus

    async def node(
        self,
        *,
        name: str = "arm",
        prepare: Callable[[Arm], None] = lambda arm: None,
        file: JournalFile | None = None,
        **options: Any,
    ) -> NodeServer:
        """Start a node; ``file`` in place of its journal on disk."""
        arm = Arm(Setup(name, "cell", world=self.world))
        prepare(arm)
        bus = await self.bus()
        journal = await Journal.open(file or FileJournalFile(self.folder / f"{name}.journal"), Uuid7Ids())
        options = {"idle_poll_s": 0.02, "settle_s": 0.02, "grace_s": 0.2, **options}
        server = NodeServer(arm, bus, LAB, journal, SystemClock(), Uuid7Ids(), **options)
        self._stack.push_async_callback(server.close)
        await server.start()
        self.kernel.journal = journal.memory.id
        return server


@asynccontextmanager
async def bench(folder: Path, endpoint: str) -> AsyncIterator[Bench]:
    async with AsyncExitStack() as stack:
        hub = await open_bus(mode="router", listen=[endpoint])
        stack.push_async_callback(hub.close)
        kernel = Kernel(hub)
        await kernel.listen()
        yield Bench(folder, stack, kernel, endpoint)


def arm_of(server: NodeServer) -> Arm:
    assert isinstance(server.node, Arm)
    return server.node
