"""A lab in one process whose bus somebody else is on: real kernel, store, bus and nodes, and a stranger's
session that may say whatever it likes."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, closing, suppress
from pathlib import Path
from typing import Any

import msgspec

from labos.bus import ZenohBus, open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.actions import Action
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.runs import SubmitRun
from labos.core.envelope import Record
from labos.core.ids import ModuleName, StationName, local
from labos.core.interventions import Intervention
from labos.core.model import Plan
from labos.core.modules import Module
from labos.errors import Refused
from labos.node import Node, Setup, action
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import AboutReport, ActionReply, AdminReply, Keys, StateReport
from labos.node.server import NodeServer
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.reconcile import Reconciler
from labos.runtime.registry import Registry
from labos.runtime.verify import Verifier
from labos.runtime.writer import ThreadWriter
from labos.settings import free_port
from labos.store import open_store
from tests.integration.bus.contract import until
from tests.support.bench import module as spec
from tests.support.bench import plan, route, station, step, workcell

ARM, OTHER = ModuleName("cell/arm"), ModuleName("cell/other")
CELL = workcell(
    (spec("arm"), spec("other"), spec("away")),
    (station("stack", "stack", 9), station("a"), station("b"), station("trash", "waste", 50)),
)
CARRY = route("stack", "a", "b", "trash")
"""A plate out of the stack, over two nests, and away."""


class Device(Node):
    """Does what it is told as long as its gate is open; else it waits in the midst of it."""

    driver = "driver"

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.gate = asyncio.Event()
        self.gate.set()
        self.done: list[str] = []

    @action(duration_s=0.0)
    async def act(self) -> None:
        """Do it."""
        await self.gate.wait()
        self.done.append("act")


class Attacked:
    """The lab. ``evil`` is the stranger's session on its bus."""

    kernel: Kernel
    bus: ZenohBus
    evil: ZenohBus
    dispatcher: Dispatcher
    registry: Registry

    def __init__(self, home: Path, stack: AsyncExitStack) -> None:
        self.home, self._stack = home, stack
        self.nodes: dict[ModuleName, NodeServer] = {}

    @property
    def keys(self) -> Keys:
        return Keys(self.kernel.lab)

    async def open_kernel(
        self, silence_s: float = 3.0, answer_s: float = 2.0, barred_s: float = 30.0
    ) -> None:
        stack = self._stack
        store = open_store(f"sqlite:///{self.home}/labos.db")
        stack.callback(store.close)
        self.kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
        await self.kernel.open()
        stack.push_async_callback(self.kernel.close)
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.bus = await open_bus(mode="router", listen=[self.endpoint])
        stack.push_async_callback(self.bus.close)
        self.evil = await self.session()
        self.dispatcher = Dispatcher(self.kernel, self.bus, answer_s=answer_s, acknowledge_s=0.2)
        self.registry = Registry(
            self.kernel,
            self.bus,
            self.dispatcher,
            silence_s=silence_s,
            answer_s=answer_s,
            barred_s=barred_s,
        )
        await self.dispatcher.start()
        stack.push_async_callback(self.dispatcher.close)
        await self.registry.start()
        stack.push_async_callback(self.registry.close)
        for part in (Reconciler(self.kernel, self.bus, answer_s=answer_s), Verifier(self.kernel, self.bus)):
            await part.start()
            stack.push_async_callback(part.close)
        await self.kernel.execute(ApplyWorkcell(CELL), "ada")
        for place in CELL.places:
            labware = ("plate",) * 9 if place.kind == "stack" else ()
            await self.kernel.execute(DeclareStation(StationName(place.name), labware), "ada")

    async def session(self) -> ZenohBus:
        bus = await open_bus(connect=[self.endpoint])
        self._stack.push_async_callback(bus.close)
        return bus

    async def start_node(self, module: ModuleName, journal: str = "") -> Device:
        """Start a node of a module, in a session of its own."""
        file = FileJournalFile(self.home / f"{journal or module.replace('/', '.')}.journal")
        device = Device(Setup(module.partition("/")[2], "cell"))
        server = NodeServer(
            device,
            await self.session(),
            self.kernel.lab,
            await Journal.open(file, Uuid7Ids()),
            SystemClock(),
            Uuid7Ids(),
            heartbeat_s=0.2,
        )
        self._stack.push_async_callback(server.close)
        await server.start()
        self.nodes[module] = server
        return device

    # -- what can be seen --------------------------------------------------------------------

    def module(self, name: ModuleName = ARM) -> Module:
        return self.kernel.state.modules.by_name[name]

    def questions(self, kind: str) -> list[Intervention]:
        return [q for q in self.kernel.state.interventions.open.values() if q.kind == kind]

    def in_flight(self) -> Action:
        (found,) = self.kernel.state.actions.open.values()
        return found

    async def submit(self, what: Plan = CARRY) -> str:
        await self.kernel.execute(SubmitRun(what, "ada"), "ada")
        return f"R{self.kernel.state.runs.named}"

    def is_over(self, run: str) -> bool:
        state = self.kernel.state
        return run not in state.runs.active and run not in state.runs.queued

    async def works(self, timeout_s: float = 20.0) -> None:
        """A run still goes from its start to its end."""
        before = self.kernel.state.bench.named
        run = await self.submit()
        await until(lambda: self.is_over(run), timeout_s)
        assert not self.kernel.failed.done()
        plate = f"P{before + 1}"
        assert plate not in self.kernel.state.bench.labware, "it was thrown away"

    async def hold_in_flight(self, device: Device, what: Plan = CARRY) -> Action:
        """A run is under way: its first action has begun and waits for the device's gate."""
        device.gate.clear()
        await self.submit(what)
        await until(
            lambda: any(a.status == "accepted" for a in self.kernel.state.actions.open.values()), 10.0
        )
        return self.in_flight()

    async def keep_busy(self, module: ModuleName) -> None:
        """There is always something to do for a module: a person answers what is asked about it."""
        for question in list(self.kernel.state.interventions.open.values()):
            if question.module == module:
                answer = ResolveIntervention(question.id, question.choices[-1].name, "ada")
                with suppress(Refused):  # its node is away
                    await self.kernel.execute(answer, "ada")
        if not any(action.module == module for action in self.kernel.state.actions.open.values()):
            await self.submit(plan(step(local(module))))

    async def say(self, key: str, message: Any) -> None:
        """Publish something as the stranger."""
        payload = message if isinstance(message, bytes) else msgspec.json.encode(message)
        await self.evil.publish(key, payload)

    async def records(self) -> list[Record]:
        """The log."""
        await self.kernel.flush()
        store = open_store(f"sqlite:///{self.home}/labos.db", create=False, read_only=True)
        try:
            return list(store.read())
        finally:
            store.close()

    async def set_epoch(self, epoch: int) -> None:
        """As when another kernel takes the lab over."""
        with closing(sqlite3.connect(self.home / "labos.db")) as database, database:
            database.execute("UPDATE head SET epoch = ?", (epoch,))

    def count_queries(self) -> list[str]:
        """The keys that the kernel asks from now on, but for those of modules that the lab has."""
        asked: list[str] = []
        query = self.bus.query

        async def listen(key: str, payload: bytes, timeout_s: float) -> bytes:
            if not key.startswith(f"{self.keys.root}/cell/"):
                asked.append(key)
            return await query(key, payload, timeout_s)

        self.bus.query = listen  # type: ignore[method-assign]
        return asked

    async def heartbeats(self, count: int, module: ModuleName = ARM) -> None:
        """Until so many more have been heard from a node."""
        heard = 0
        more = asyncio.Event()

        def note(*_: object) -> None:
            nonlocal heard
            heard += 1
            if heard >= count:
                more.set()

        handle = await self.bus.subscribe(self.keys.operation(module, "state"), note)
        await asyncio.wait_for(more.wait(), 20.0)
        handle.close()

    async def settle(self) -> None:
        """Until the kernel has heard all that the stranger said before: the bus keeps the order."""
        heard = asyncio.Event()
        handle = await self.bus.subscribe(f"{self.keys.root}/@settle", lambda *_: heard.set())
        await self.evil.publish(f"{self.keys.root}/@settle", b"")
        await asyncio.wait_for(heard.wait(), 20.0)
        handle.close()


class Liar:
    """Serves a module's keys and answers what a test wants it to."""

    def __init__(self, lab: Attacked, module: ModuleName) -> None:
        self.lab, self.module = lab, module
        self.about: Any = AboutReport(module, "j", "liar", "d", {"driver": "driver"})
        self.state: Any = StateReport("IDLE", "j", "liar")
        self.reply: Any = ActionReply("accepted", "j", attempt=1)
        self.admin: Any = AdminReply(True, result={})
        self.heard: list[bytes] = []
        self.settles: asyncio.Event | None = None

    @property
    def questions(self) -> int:
        """How often it was asked what became of an action."""
        return sum(b'"op":"ask"' in payload for payload in self.heard)

    @classmethod
    async def show_itself(cls, lab: Attacked, module: ModuleName = ARM, **changed: Any) -> Liar:
        """Shows itself, and has joined unless it ``changed`` its about."""
        liar = cls(lab, module)
        liar.about = msgspec.structs.replace(liar.about, **changed)
        await liar.serve()
        if not changed:
            await until(lambda: lab.module(module).status == "IDLE", 10.0)
        return liar

    async def serve(self) -> None:
        bus = await self.lab.session()
        for operation, answer in {
            "about": self.on_about,
            "state": self.on_state,
            "action": self.on_action,
            "admin": self.on_admin,
        }.items():
            await bus.serve(self.lab.keys.operation(self.module, operation), answer)
        await bus.declare_alive(self.lab.keys.alive(self.module, "liar"))

    async def on_about(self, _: bytes) -> bytes:
        return encode(self.about)

    async def on_state(self, _: bytes) -> bytes:
        return encode(self.state)

    async def on_action(self, payload: bytes) -> bytes:
        self.heard.append(payload)
        return encode(self.reply)

    async def on_admin(self, payload: bytes) -> bytes:
        if self.settles is not None:
            await self.settles.wait()
        return encode(self.admin)


def encode(message: Any) -> bytes:
    return message if isinstance(message, bytes) else msgspec.json.encode(message)


@asynccontextmanager
async def start_attacked(
    home: Path,
    *,
    nodes: tuple[ModuleName, ...] = (ARM, OTHER),
    silence_s: float = 3.0,
    answer_s: float = 2.0,
    barred_s: float = 30.0,
) -> AsyncIterator[tuple[Attacked, dict[ModuleName, Device]]]:
    """A lab with a node for each of some modules, which have joined."""
    async with AsyncExitStack() as stack:
        lab = Attacked(home, stack)
        await lab.open_kernel(silence_s, answer_s, barred_s)
        devices = {name: await lab.start_node(name) for name in nodes}
        await until(lambda: all(lab.module(name).status == "IDLE" for name in nodes), 10.0)
        yield lab, devices
