"""What the kernel asks of nodes: real kernel, log and bus; the node's end of the wire is held by the test."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import msgspec

from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.canonical import digest
from labos.core.decide.actions import FinishAction
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.nodes import JoinNode, LoseNode
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ActionId, ModuleName
from labos.core.model import ModuleSpec, Plan, PlanStep, Workcell
from labos.errors import StoreUnavailable
from labos.node.protocol import Acknowledge, ActionReply, Ask, Keys, Start
from labos.ports import EventStore, Head, Record
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.writer import ThreadWriter
from labos.settings import free_port
from labos.store import open_store
from tests.integration.bus.contract import until

MODULE = ModuleName("cell/dev")
WORKCELL = Workcell("cell", digest(b""), (ModuleSpec(MODULE, "driver"),), ())
PLAN = Plan("one", "cell", (PlanStep("only", MODULE, "work"),))
_decode = msgspec.json.Decoder(Start | Ask | Acknowledge).decode


class Breaking:
    """A store whose connection breaks in the midst of the commit of a second attempt when it is told to:
    nothing is written."""

    def __init__(self, store: EventStore) -> None:
        self._store = store
        self.breaks = False
        self.tried = threading.Event()
        self.broken = threading.Event()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._store, name)

    def append(self, expected: Head, records: Sequence[Record]) -> Head:
        if self.breaks and any(b'"attempt":2' in record.payload for record in records):
            self.breaks = False
            self.tried.set()
            self.broken.wait(30.0)
            raise StoreUnavailable("The connection broke during the commit.")
        return self._store.append(expected, records)


class Wire:
    """The node's end. Its answer to a start makes no sense before ``hears``; it says that what it is asked
    about never ran, and keeps whoever asks again waiting until ``released``."""

    def __init__(self, store: Breaking) -> None:
        self._store = store
        self.asked: list[int] = []
        self.hears = False
        self.released = asyncio.Event()

    async def on_action(self, payload: bytes) -> bytes:
        message = _decode(payload)
        if isinstance(message, Start):
            return self._says("accepted", message.attempt) if self.hears else b"?"
        if isinstance(message, Acknowledge):
            return self._says("done", 0)
        self.asked.append(message.attempt)
        if self.asked == [1]:
            self._store.breaks = True  # what follows from this answer is never written
        else:
            await self.released.wait()
        return self._says("void", 0)

    def _says(self, status: Any, attempt: int) -> bytes:
        return msgspec.json.encode(ActionReply(status, "journal", attempt=attempt))


def test_what_was_asked_of_an_attempt_that_was_never_written_is_asked_again(tmp_path: Path) -> None:
    """Else nobody would ask any more, and the action would be open for ever."""

    async def main() -> None:
        async with AsyncExitStack() as stack:
            store = Breaking(open_store(f"sqlite:///{tmp_path}/labos.db"))
            stack.callback(store.close)
            kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
            await kernel.open()
            stack.push_async_callback(kernel.close)
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            bus = await open_bus(mode="router", listen=[endpoint])
            stack.push_async_callback(bus.close)
            theirs = await open_bus(connect=[endpoint])
            stack.push_async_callback(theirs.close)
            wire = Wire(store)
            await theirs.serve(Keys(kernel.lab).operation(MODULE, "action"), wire.on_action)
            dispatcher = Dispatcher(kernel, bus, answer_s=30.0)
            await dispatcher.start()
            stack.push_async_callback(dispatcher.close)

            await kernel.execute(ApplyWorkcell(WORKCELL), "ada")
            about = ("journal", "instance", "driver", "1", "about", "IDLE")
            await kernel.execute(JoinNode(MODULE, *about), str(MODULE))
            await kernel.execute(SubmitRun(PLAN, "ada"), "ada")
            (action,) = kernel.state.actions.open.values()
            await until(store.tried.is_set, 10.0)
            assert attempt_of(kernel, action.id) == 2
            dispatcher.find_out(action.id)  # as when its node joins
            await until(lambda: wire.asked == [1, 2], 10.0)
            store.broken.set()
            await until(lambda: attempt_of(kernel, action.id) == 1, 10.0)
            wire.hears = True
            wire.released.set()
            await until(lambda: kernel.state.actions.open[action.id].status == "accepted", 10.0)

    asyncio.run(main())


class SlowNode:
    """The node's end; it takes its time to accept a start, and knows nothing of it meanwhile."""

    def __init__(self) -> None:
        self.started: list[int] = []
        self.asked: list[int] = []
        self.accepts = asyncio.Event()

    async def on_action(self, payload: bytes) -> bytes:
        message = _decode(payload)
        if isinstance(message, Start):
            self.started.append(message.attempt)
            await self.accepts.wait()
            return msgspec.json.encode(ActionReply("accepted", "journal", attempt=message.attempt))
        if isinstance(message, Ask):
            self.asked.append(message.attempt)
            return msgspec.json.encode(ActionReply("void", "journal", attempt=0))
        return msgspec.json.encode(ActionReply("done", "journal", attempt=0))


def test_a_node_is_not_asked_about_a_start_that_it_has_still_to_answer(tmp_path: Path) -> None:
    """As when it is greeted twice: the question would end the attempt. Its successor is asked."""

    async def main() -> None:
        async with AsyncExitStack() as stack:
            store = open_store(f"sqlite:///{tmp_path}/labos.db")
            stack.callback(store.close)
            kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
            await kernel.open()
            stack.push_async_callback(kernel.close)
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            bus = await open_bus(mode="router", listen=[endpoint])
            stack.push_async_callback(bus.close)
            theirs = await open_bus(connect=[endpoint])
            stack.push_async_callback(theirs.close)
            node = SlowNode()
            await theirs.serve(Keys(kernel.lab).operation(MODULE, "action"), node.on_action)
            dispatcher = Dispatcher(kernel, bus, answer_s=60.0)
            await dispatcher.start()
            stack.push_async_callback(dispatcher.close)

            await kernel.execute(ApplyWorkcell(WORKCELL), "ada")
            await kernel.execute(
                JoinNode(MODULE, "journal", "first", "driver", "1", "about", "IDLE"), str(MODULE)
            )
            await kernel.execute(SubmitRun(PLAN, "ada"), "ada")
            (action,) = kernel.state.actions.open.values()
            await until(lambda: node.started == [1], 10.0)
            dispatcher.find_out(action.id)
            node.accepts.set()
            await until(lambda: kernel.state.actions.open[action.id].status == "accepted", 10.0)
            assert (attempt_of(kernel, action.id), node.asked) == (1, [])

            node.accepts.clear()
            await kernel.execute(SubmitRun(PLAN, "bo"), "bo")
            await kernel.execute(FinishAction(action.id, 1, True, "all"), str(MODULE))
            (action,) = kernel.state.actions.open.values()
            await until(lambda: node.started == [1, 1], 10.0)
            await kernel.execute(LoseNode(MODULE, "first", "its process has ended"), str(MODULE))
            await kernel.execute(
                JoinNode(MODULE, "journal", "second", "driver", "1", "about", "IDLE"), str(MODULE)
            )
            dispatcher.find_out(action.id)
            await until(lambda: attempt_of(kernel, action.id) == 2, 10.0)
            assert node.asked == [1]
            node.accepts.set()
            await until(lambda: kernel.state.actions.open[action.id].status == "accepted", 10.0)

    asyncio.run(main())


def attempt_of(kernel: Kernel, name: ActionId) -> int:
    """The attempt that an action is at; 0 while the log is read again."""
    try:
        return kernel.state.actions.open[name].attempt
    except StoreUnavailable:
        return 0
