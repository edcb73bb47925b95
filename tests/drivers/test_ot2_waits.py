"""An OT-2 that waits for a person: its node tells the lab while the run goes on, and a person is told."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.envelope import Envelope
from labos.core.modules import NodeStateChanged
from labos.errors import DeviceError
from labos.node import Setup, World
from labos.node.files import Files
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Keys
from labos.node.server import NodeServer
from labos.services.notify.notices import Notice, read_event
from labos_drivers.ot2 import OT2
from labos_drivers.ot2 import driver as ot2_driver
from labos_drivers.ot2.wire import OT2OnWire
from tests.drivers.test_ot2_wire import PROTOCOL, drive, keep_handles, status_of
from tests.drivers.wires import power_on, run, until
from tests.integration.adapter.bench import Bench, bench
from tests.integration.node.bench import LAB
from tests.integration.ports import free_endpoint


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ot2_driver, "POLL_S", 0.01)


def on_the_bus(folder: Path, robot: OT2OnWire, scenario: Callable[[Bench], Awaitable[None]]) -> None:
    """The robot's node on a bus with a stand-in for the kernel."""

    async def main() -> None:
        async with bench(folder, free_endpoint()) as here, AsyncExitStack() as stack:
            bus = await open_bus(connect=[here.endpoint])
            stack.push_async_callback(bus.close)
            journal = await Journal.open(FileJournalFile(folder / "arm.journal"), Uuid7Ids())
            node = OT2(Setup("arm", "cell", {"url": robot.address}))
            files = Files(bus, Keys(LAB).files, folder / "files")
            often: dict[str, Any] = {"idle_poll_s": 0.02, "settle_s": 0.02, "heartbeat_s": 0.05}
            server = NodeServer(node, bus, LAB, journal, SystemClock(), Uuid7Ids(), files=files, **often)
            await server.start()
            stack.push_async_callback(server.close)
            here.kernel.journal = server.journal.memory.id
            await asyncio.wait_for(scenario(here), 30.0)

    asyncio.run(main())


def test_a_run_that_waits_is_an_error_with_its_reason_and_is_gone_on_with(
    world: World, tmp_path: Path
) -> None:
    world.stock("ot2.deck2", "plate")

    async def scenario(here: Bench) -> None:
        await here.idle()
        await here.start("a1", "run_protocol", {"mix.py": PROTOCOL.encode()}, config_path="mix.py")
        await until(lambda: status_of(robot) == "running")
        robot.after(0, robot.open_door)
        await here.in_error("Its door or top window is open: close it, then resume the run")
        state = await here.kernel.state()
        assert state.running == ["a1"], "it is waited for"
        event = NodeStateChanged("cell/arm", "ERROR", state.error)  # type: ignore[arg-type]
        told = read_event(event, head())
        assert isinstance(told, Notice)
        assert "close it, then resume the run" in told.text
        robot.after(0, robot.shut_door)
        await here.in_error("The run is paused")
        await here.start("a2", "resume_run")
        assert (await here.outcome("a2")).succeeded
        assert (await here.outcome("a1")).succeeded
        await here.idle()

    with power_on(OT2OnWire, "ot2", world, pace=400) as robot:
        on_the_bus(tmp_path, robot, scenario)


def head() -> Envelope:
    """Of an event that was just written."""
    return Envelope(
        lab="lab", position=1, id="e1", stream="cell/arm", version=1, type="node.state_changed", schema=1,
        recorded_at=0, actor="kernel", correlation="", causation="", digest="",
    )  # fmt: skip


def test_what_waited_and_was_lost_waits_no_more(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run is paused, and the robot is switched off for good."""
    world.stock("ot2.deck2", "plate")
    (tmp_path / "mix.py").write_text(PROTOCOL)
    monkeypatch.setattr(ot2_driver, "LOST_S", 0.2)

    async def body(robot: OT2OnWire) -> None:
        keep_handles()
        async with drive(robot) as node:
            work = asyncio.create_task(node.run_protocol(str(tmp_path / "mix.py")))
            await until(lambda: status_of(robot) == "running")
            robot.after(0, lambda: robot._act(robot.runs[robot.current], "pause"))
            await until(lambda: "is paused" in node.device.waits_for)  # type: ignore[union-attr]
            robot.end.unplug()
            with pytest.raises(DeviceError):
                await work
            assert await node.trouble() == ""

    with power_on(OT2OnWire, "ot2", world, pace=400) as robot:
        run(lambda: body(robot))


def test_a_run_that_nobody_follows_waits_for_a_person_too(world: World, tmp_path: Path) -> None:
    """It was begun here, its node was restarted and knows nothing of it; the module is not idle for it."""
    world.stock("ot2.deck2", "plate")
    (tmp_path / "mix.py").write_text(PROTOCOL)

    async def body(robot: OT2OnWire) -> None:
        keep_handles()
        async with drive(robot) as first, drive(robot) as second:
            work = asyncio.create_task(first.run_protocol(str(tmp_path / "mix.py")))
            await until(lambda: status_of(robot) == "running")
            robot.after(0, robot.open_door)
            await until(lambda: status_of(robot) == "blocked-by-open-door")
            assert not await second.is_idle()
            assert "Its door or top window is open" in await second.trouble()
            robot.after(0, robot.shut_door)
            await until(lambda: status_of(robot) == "paused")
            await second.resume_run()
            await work
            assert await second.is_idle()
            assert await second.trouble() == ""

    with power_on(OT2OnWire, "ot2", world, pace=400) as robot:
        run(lambda: body(robot))
