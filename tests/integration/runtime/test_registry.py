"""Which nodes the kernel believes in: real kernel, bus and nodes."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.canonical import digest
from labos.core.decide.lab import ApplyWorkcell
from labos.core.ids import ModuleName
from labos.core.model import ModuleSpec, Workcell
from labos.node import Node, Setup, action
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.server import NodeServer
from labos.ports import AliveListener, Bus, Handle
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.registry import Registry
from labos.runtime.writer import ThreadWriter
from labos.settings import free_port
from labos.store import open_store
from tests.integration.bus.contract import until

MODULE = ModuleName("cell/still")


class Still(Node):
    """A device that does nothing."""

    driver = "still"

    @action(duration_s=0.0)
    async def wait(self) -> None:
        """Do nothing."""


class HalfDeaf:
    """A bus on which the kernel never hears that a node has gone: that word was lost, or came too early."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    async def watch_alive(self, keys: str, listener: AliveListener) -> Handle:
        def hear(key: str, living: bool) -> None:
            if living:
                listener(key, True)

        return await self._bus.watch_alive(keys, hear)


def test_a_node_without_a_heartbeat_keeps_nobody_out(tmp_path: Path) -> None:
    """Though its successor's heartbeat is heard under the same name."""

    async def main() -> None:
        async with AsyncExitStack() as stack:
            store = open_store(f"sqlite:///{tmp_path}/labos.db")
            stack.callback(store.close)
            kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
            await kernel.open()
            stack.push_async_callback(kernel.close)
            await kernel.execute(
                ApplyWorkcell(Workcell("cell", digest(b""), (ModuleSpec(MODULE, "still"),), ())), "ada"
            )
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            bus = await open_bus(mode="router", listen=[endpoint])
            stack.push_async_callback(bus.close)
            dispatcher = Dispatcher(kernel, bus)
            await dispatcher.start()
            stack.push_async_callback(dispatcher.close)
            registry = Registry(kernel, HalfDeaf(bus), dispatcher, silence_s=1.0)
            await registry.start()
            stack.push_async_callback(registry.close)

            async def node() -> NodeServer:
                theirs = await open_bus(connect=[endpoint])
                stack.push_async_callback(theirs.close)
                journal = await Journal.open(FileJournalFile(tmp_path / "still.journal"), Uuid7Ids())
                server = NodeServer(
                    Still(Setup("still", "cell")),
                    theirs,
                    kernel.lab,
                    journal,
                    SystemClock(),
                    Uuid7Ids(),
                    heartbeat_s=0.1,
                )
                stack.push_async_callback(server.close)
                await server.start()
                return server

            def is_believed() -> str:
                known = kernel.state.modules.by_name[MODULE]
                return "" if known.status == "GONE" else known.instance

            first = await node()
            await until(lambda: is_believed() == first.instance, 10.0)
            await first.close()
            second = await node()
            await until(lambda: is_believed() == second.instance, 10.0)
            assert MODULE not in registry.rejected

    asyncio.run(main())
