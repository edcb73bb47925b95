"""An adapter on the bus, beside a foreign node, and a stand-in for the kernel."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec

from labos.adapter import find_adapter_class
from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.model import Description
from labos.node import Setup
from labos.node.files import Files
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Keys, Start
from labos.node.server import NodeServer
from labos.runtime.files import FileDesk
from labos.store import FolderBlobs
from tests.integration.bus.contract import until
from tests.integration.node.bench import LAB, Kernel

ROOT = Path(__file__).parents[3]
QUICK = {"poll_s": 0.1, "patience_s": 2.0}


async def start_adapter(
    endpoint: str, folder: Path, interface: str, description: Description, config: dict[str, Any]
) -> tuple[NodeServer, Any]:
    bus = await open_bus(connect=[endpoint])
    node = find_adapter_class(interface, description)(Setup("arm", "cell", config))
    journal = await Journal.open(FileJournalFile(folder / "arm.journal"), Uuid7Ids())
    quick = {"idle_poll_s": 0.05, "settle_s": 0.02, "grace_s": 2.0, "heartbeat_s": 0.2}
    files = Files(bus, Keys(LAB).files, folder / "files")
    server = NodeServer(node, bus, LAB, journal, SystemClock(), Uuid7Ids(), files=files, **quick)  # type: ignore[arg-type]
    await server.start()
    return server, bus


class Bench:
    """A router, a kernel with files on it, and adapters."""

    def __init__(
        self, folder: Path, endpoint: str, kernel: Kernel, blobs: FolderBlobs, stack: AsyncExitStack
    ):
        self.folder, self.endpoint, self.kernel, self.blobs, self._stack = (
            folder,
            endpoint,
            kernel,
            blobs,
            stack,
        )

    async def adapter(self, interface: str, description: Description, **config: Any) -> NodeServer:
        """An adapter in this process, ready for work."""
        server, bus = await start_adapter(
            self.endpoint, self.folder, interface, description, {**QUICK, **config}
        )
        self._stack.push_async_callback(bus.close)
        self._stack.push_async_callback(server.close)
        self.kernel.journal = server.journal.memory.id
        return server

    async def process(
        self, interface: str, description: Description, **config: Any
    ) -> subprocess.Popen[bytes]:
        """An adapter in a process of its own, which answers; `idle` waits until its device is connected."""
        told = msgspec.json.encode([interface, msgspec.to_builtins(description), {**QUICK, **config}])
        command = [
            sys.executable,
            "-m",
            "tests.integration.adapter.bench",
            self.endpoint,
            str(self.folder),
            told,
        ]
        process = subprocess.Popen(command, cwd=ROOT)  # noqa: ASYNC220 - it returns at once
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        await until(lambda: any(self.kernel.alive.values()), 30.0)
        self.kernel.journal = (await self.kernel.about()).journal
        return process

    async def await_node_gone(self) -> None:
        await until(lambda: not any(self.kernel.alive.values()), 10.0)

    async def start(self, action: str, name: str, files: dict[str, bytes] | None = None, **args: Any) -> Any:
        """Send a start as the kernel would, its files pinned."""
        pinned = {known: self.blobs.put(data) for known, data in (files or {}).items()}
        request = self.kernel.request(action, name, **args)
        assert isinstance(request, Start)
        reply = await self.kernel.send(msgspec.structs.replace(request, files=pinned))
        if reply.outcome is not None:
            self.kernel.results[action] = reply
        return reply

    async def outcome(self, action: str, timeout_s: float = 20.0) -> Any:
        await until(lambda: action in self.kernel.results, timeout_s)
        return self.kernel.results[action].outcome

    async def status(self, action: str, wanted: str, timeout_s: float = 20.0) -> Any:
        """Ask until the answer is that one."""
        give_up = asyncio.get_running_loop().time() + timeout_s
        while True:
            told = await self.kernel.ask(action, void=True)
            if told.status == wanted:
                return told
            assert asyncio.get_running_loop().time() < give_up, told
            await asyncio.sleep(0.05)

    async def await_taken(self) -> None:
        """The foreign node has answered a start whose end it tells later, and the adapter has noted that."""
        await until(lambda: b"taken" in (self.folder / "arm.journal").read_bytes(), 20.0)

    async def idle(self, timeout_s: float = 20.0) -> None:
        give_up = asyncio.get_running_loop().time() + timeout_s
        while (told := await self.kernel.state()).status != "IDLE":
            assert asyncio.get_running_loop().time() < give_up, told
            await asyncio.sleep(0.05)

    async def in_error(self, words: str, timeout_s: float = 20.0) -> None:
        give_up = asyncio.get_running_loop().time() + timeout_s
        while (told := await self.kernel.state()).status != "ERROR" or words not in told.error:
            assert asyncio.get_running_loop().time() < give_up, told
            await asyncio.sleep(0.05)


@asynccontextmanager
async def bench(folder: Path, endpoint: str) -> AsyncIterator[Bench]:
    async with AsyncExitStack() as stack:
        hub = await open_bus(mode="router", listen=[endpoint])
        stack.push_async_callback(hub.close)
        kernel = Kernel(hub)
        await kernel.listen()
        blobs = FolderBlobs(folder / "blobs")
        await hub.serve(Keys(LAB).files, FileDesk(blobs, folder / "arriving").on_request)
        yield Bench(folder, endpoint, kernel, blobs, stack)


async def main(endpoint: str, folder: Path, told: str) -> None:
    interface, description, config = json.loads(told)
    server, bus = await start_adapter(
        endpoint, folder, interface, msgspec.convert(description, Description), config
    )
    await server.stopping.wait()
    await server.close()
    await bus.close()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], Path(sys.argv[2]), sys.argv[3]))
