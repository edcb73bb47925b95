"""A node whose device remembers: what was under way when the node died is taken up again; what
nobody can know is said to be unknown."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.errors import OutcomeUnknown
from labos.node import Node, Setup, action
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.server import NodeServer
from tests.integration.bus.contract import until
from tests.integration.node.bench import LAB, Bench, bench
from tests.integration.ports import free_endpoint


class Device:
    """Outlives the node, and knows its own jobs."""

    def __init__(self) -> None:
        self.jobs: dict[str, asyncio.Event] = {}
        self.idle = True
        self.broken = ""


class Robot(Node):
    """A node of a device with jobs."""

    driver = "robot"

    def __init__(self, setup: Setup, device: Device) -> None:
        super().__init__(setup)
        self.device = device

    async def is_idle(self) -> bool:
        return self.device.idle

    async def trouble(self) -> str:
        return self.device.broken

    @action()
    async def run(self) -> str:
        """Start a job and wait for its end."""
        name = f"job{len(self.device.jobs) + 1}"
        await self.note_handle(name)
        self.device.jobs[name] = asyncio.Event()
        return await self._end(name)

    @action()
    async def vanish(self) -> None:
        """Start a job of which nothing is heard any more."""
        self.device.idle = False
        raise OutcomeUnknown("the device fell silent")

    async def take_up(self, name: str, handle: str) -> Any:
        if handle not in self.device.jobs:
            raise OutcomeUnknown("the device knows nothing of it")
        return await self._end(handle)

    async def _end(self, name: str) -> str:
        await self.device.jobs[name].wait()
        return f"{name} is done"


@asynccontextmanager
async def robot(here: Bench, device: Device) -> AsyncIterator[NodeServer]:
    async with AsyncExitStack() as stack:
        bus = await open_bus(connect=[here.endpoint])
        stack.push_async_callback(bus.close)
        journal = await Journal.open(FileJournalFile(here.folder / "arm.journal"), Uuid7Ids())
        node = Robot(Setup("arm", "cell"), device)
        quick = {"idle_poll_s": 0.02, "settle_s": 0.02, "heartbeat_s": 0.05}
        server = NodeServer(node, bus, LAB, journal, SystemClock(), Uuid7Ids(), **quick)  # type: ignore[arg-type]
        stack.push_async_callback(server.close)
        await server.start()
        here.kernel.journal = journal.memory.id
        yield server


def test_what_the_device_still_does_goes_on(tmp_path: Path) -> None:
    async def main() -> None:
        async with bench(tmp_path, free_endpoint()) as here:
            kernel, device = here.kernel, Device()
            async with robot(here, device):
                await kernel.start("a1", "run")
                await until(lambda: "job1" in device.jobs)
            async with robot(here, device):
                assert (await kernel.ask("a1", void=True)).status == "running"
                device.jobs["job1"].set()
                outcome = await kernel.outcome("a1")
                assert (outcome.succeeded, outcome.result) == (True, "job1 is done")
                assert (await kernel.start("a1", "run")).outcome == outcome
            assert list(device.jobs) == ["job1"]

    asyncio.run(main())


def test_what_the_device_has_forgotten_is_unknown(tmp_path: Path) -> None:
    async def main() -> None:
        async with bench(tmp_path, free_endpoint()) as here:
            kernel, device = here.kernel, Device()
            async with robot(here, device):
                await kernel.start("a1", "run")
                await until(lambda: "job1" in device.jobs)
            device.jobs.clear()
            async with robot(here, device):
                await until(lambda: "a1" in kernel.states[-1].interrupted)
                told = await kernel.ask("a1", void=True)
                assert (told.status, told.why) == ("interrupted", "the device knows nothing of it")
                # Asked for once more, it does not run.
                assert (await kernel.start("a1", "run")).status == "interrupted"
                assert device.jobs == {}

    asyncio.run(main())


def test_an_unknown_outcome_is_neither_done_nor_failed(tmp_path: Path) -> None:
    async def main() -> None:
        async with bench(tmp_path, free_endpoint()) as here:
            kernel, device = here.kernel, Device()
            async with robot(here, device):
                await kernel.start("a1", "vanish")
                await until(lambda: "a1" in kernel.states[-1].interrupted)
                assert (await kernel.ask("a1")).why == "the device fell silent"
                # Nothing begins before the device is seen to stand still.
                assert (await kernel.start("a2", "run")).status == "refused"
                device.idle = True
                await until(lambda: kernel.states[-1].status == "IDLE")
                assert (await kernel.start("a3", "run")).status == "accepted"

    asyncio.run(main())


def test_trouble_of_the_device_comes_and_goes(tmp_path: Path) -> None:
    async def main() -> None:
        async with bench(tmp_path, free_endpoint()) as here:
            kernel, device = here.kernel, Device()
            async with robot(here, device):
                device.broken = "The lid is open."
                await until(lambda: any(state.error == "The lid is open." for state in kernel.states))
                assert (await kernel.start("a1", "run")).status == "refused"
                device.broken = ""
                await until(lambda: kernel.states[-1].status == "IDLE")

    asyncio.run(main())
