"""The XPeel driver and a simulated XPeel on a pseudo-terminal."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.errors import DeviceError, Garbled, LinkLost, NotConnected, OutcomeUnknown
from labos.link import Link, OffScript, ScriptedWire, Terminated, keep_transcript, read_transcript
from labos.node import Setup, World
from labos.node.node import handle_keeper
from labos_drivers.a4s_sealer.wire import SealerOnWire
from labos_drivers.brooks_peeler import BrooksPeeler
from labos_drivers.brooks_peeler import driver as peeler_driver
from labos_drivers.brooks_peeler.driver import PeelerDriver
from labos_drivers.brooks_peeler.wire import PeelerOnWire
from tests.drivers.wires import at_port, power_on, run, until


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "peeler"


@pytest.fixture
def peeler(world: World, port: Path) -> Iterator[PeelerOnWire]:
    with power_on(PeelerOnWire, "peeler", world, port) as device:
        yield device


def place_sealed_plate(world: World) -> str:
    (plate,) = world.stock("peeler.default", "plate")
    world.work("somebody", "seal", "peeler.default")
    return plate


def test_peels_a_plate(peeler: PeelerOnWire, world: World, port: Path, tmp_path: Path) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        assert await node.resources() == {}
        plate = place_sealed_plate(world)
        assert await node.sealcheck() == "sealed"
        await node.peel(parameter_set=4, adhere=7.5)
        assert [(m.plate, m.facts) for m in world.motions("peel")] == [(plate, {"set": 4, "adhere_s": 7.5})]
        assert await node.sealcheck() == "unsealed"
        assert await node.resources() == {"tape": 590}
        assert await node.is_idle()
        await node.close()

    with keep_transcript(tmp_path / "talk.txt"):
        run(body)
    sent = [record.data for record in read_transcript(tmp_path / "talk.txt") if record.mark == ">"]
    assert b"*xpeel:43\r\n" in sent


def test_looks_before_it_peels(peeler: PeelerOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        assert await node.sealcheck() == "no plate"
        with pytest.raises(DeviceError, match="06: no plate found") as empty:
            await node.peel()
        world.stock("peeler.default", "plate")
        with pytest.raises(DeviceError, match="no seal on the plate") as bare:
            await node.peel()
        assert {empty.value.effects, bare.value.effects} == {"none"}
        assert world.motions("peel") == []
        await node.close()

    run(body)


def test_little_tape_is_a_warning_and_none_is_an_error(
    peeler: PeelerOnWire, world: World, port: Path
) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        world.supply("peeler", "tape", 1)
        place_sealed_plate(world)
        await node.peel()
        assert peeler.codes == (20, 0, 0)
        world.work("somebody", "seal", "peeler.default")
        with pytest.raises(DeviceError, match="07: out of tape") as told:
            await node.peel()
        assert told.value.effects == "unknown"
        # The code stays until the next motion, and is no second failure.
        assert await node.is_idle()
        await node.reset()
        await node.close()

    run(body)


def test_an_open_cover_and_a_pressed_button(peeler: PeelerOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        place_sealed_plate(world)
        peeler.cover_is_shut = False
        with pytest.raises(DeviceError, match="the cover is open") as told:
            await node.peel()
        assert told.value.remedy.startswith("Close the cover")
        peeler.cover_is_shut = True
        work = asyncio.create_task(node.peel())
        await until(lambda: peeler.world.is_shut("peeler.default"))
        peeler.stop_button()
        with pytest.raises(DeviceError, match="stop button"):
            await work
        await node.reset()
        await node.close()

    run(body)


def test_homes_when_it_is_switched_on(world: World, port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peeler_driver, "ANSWER_S", 1.0)

    async def body() -> None:
        with power_on(PeelerOnWire, "peeler", world, port, pace=20, homes=True):
            node = at_port(BrooksPeeler, "peeler", port)
            await node.connect()
            assert await node.is_idle()
            await node.close()

    run(body)


def test_unplugged_in_mid_motion(peeler: PeelerOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        place_sealed_plate(world)
        work = asyncio.create_task(node.peel())
        await until(lambda: world.is_shut("peeler.default"))
        peeler.end.unplug()
        with pytest.raises(LinkLost) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(NotConnected) as gone:
            await node.peel()
        assert gone.value.effects == "none"
        await node.close()

    run(body)


def test_a_node_that_ends_does_not_wait_for_the_device(world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        place_sealed_plate(world)
        work = asyncio.create_task(node.peel())
        await until(lambda: world.is_shut("peeler.default"))
        began = time.monotonic()
        work.cancel()
        await node.close()
        assert time.monotonic() - began < 5

    with power_on(PeelerOnWire, "peeler", world, port, pace=0.1):
        run(body)


def test_a_peel_is_taken_up_by_what_the_device_says_of_its_last_motion(world: World, port: Path) -> None:
    """A node is lost in the midst of it; another one asks, and starts nothing."""

    async def body(peeler: PeelerOnWire) -> None:
        handles: list[str] = []

        async def keep(handle: str) -> None:
            handles.append(handle)

        handle_keeper.set(keep)
        first = at_port(BrooksPeeler, "peeler", port)
        await first.connect()
        place_sealed_plate(world)
        work = asyncio.create_task(first.peel(4))
        await until(lambda: peeler.peels)
        assert handles == ["*xpeel:41"]
        peeler.end.unplug()
        with pytest.raises(LinkLost):
            await work
        await first.close()
        peeler.end.plug()

        again = at_port(BrooksPeeler, "peeler", port)
        await again.connect()
        await again.take_up("peel", handles[0])
        assert not peeler.peels
        ended = world.last_motion()
        await again.take_up("peel", handles[0])
        with pytest.raises(DeviceError, match="never begun") as before:
            await again.take_up("peel", "")
        assert world.last_motion() == ended
        world.work("somebody", "seal", "peeler.default")
        assert await again.sealcheck() == "sealed"
        with pytest.raises(DeviceError, match="the seal is still on") as on:
            await again.take_up("peel", handles[0])
        peeler.cover_is_shut = False
        with pytest.raises(DeviceError, match="51"):
            await again.sealcheck()
        with pytest.raises(DeviceError, match="cover is open") as cover:
            await again.take_up("peel", handles[0])
        told = (before, on, cover)
        assert [error.value.effects for error in told] == ["none", "partial", "unknown"]
        await again.close()

    with power_on(PeelerOnWire, "peeler", world, port, pace=20) as device:
        run(lambda: body(device))
    assert len(world.motions("peel")) == 1


def test_one_that_was_switched_off_knows_nothing_of_its_peel(
    peeler: PeelerOnWire, world: World, port: Path
) -> None:
    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        with pytest.raises(OutcomeUnknown, match="switched off since"):
            await node.take_up("peel", "*xpeel:41")
        await node.close()

    run(body)


OLD_NEWS = """# labos transcript 1
0.1\tp\t>\t*version\\r\\n
0.2\tp\t<\t*1.4\\r\\n*ready:04,00,00\\r\\n
1.0\tp\t>\t*sealcheck\\r\\n
1.1\tp\t<\t*ready:04,00,00\\r\\n*ack\\r\\n
9.0\tp\t<\t*ready:00,00,00\\r\\n
"""


def test_what_is_ready_before_it_was_told_anything_is_old_news(tmp_path: Path) -> None:
    """Played back from a transcript: a stale line comes just before the acknowledgement."""
    (tmp_path / "talk.txt").write_text(OLD_NEWS)
    script = ScriptedWire(tmp_path / "talk.txt")

    async def body() -> None:
        driver = PeelerDriver(Setup(name="peeler", workcell="rpl"), "nowhere")
        driver.link = Link(script, Terminated(), identify=driver._recognise)
        await driver.connect()
        assert await driver.sealcheck() == "unsealed"
        assert script.is_over
        with pytest.raises(OffScript):
            await driver.peel("*xpeel:11")

    run(body)


def test_the_wire_of_another_device(world: World, port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peeler_driver, "ANSWER_S", 0.2)

    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        with pytest.raises(NotConnected, match="does not identify itself"):
            await node.connect()

    with power_on(SealerOnWire, "sealer", world, port):
        run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = BrooksPeeler(Setup(name="peeler", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        place_sealed_plate(world)
        await node.peel()
        assert len(world.motions("peel")) == 1
        await node.close()

    run(body)


def test_a_ready_line_that_cannot_be_read_is_no_rest(
    peeler: PeelerOnWire, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peeler, "_send_ready", lambda: peeler._send_line("*ready:moving"))

    async def body() -> None:
        node = at_port(BrooksPeeler, "peeler", port)
        await node.connect()
        with pytest.raises(Garbled, match=r"ready:moving.* is no ready line"):
            await node.is_idle()
        await node.close()

    run(body)
