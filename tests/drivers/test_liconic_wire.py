"""The Liconic driver and a simulated STX on a pseudo-terminal."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.errors import DeviceError, LinkLost, NotConnected, WrongDevice
from labos.link import PtyEnd
from labos.node import Setup, World
from labos_drivers.liconic import Liconic
from labos_drivers.liconic.wire import LiconicOnWire
from tests.drivers.wires import power_on, run, until
from tests.integration.link.far import answer_on


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "liconic"


@pytest.fixture
def stx(world: World, port: Path) -> Iterator[LiconicOnWire]:
    with power_on(LiconicOnWire, "liconic", world, port) as device:
        yield device


def node_at(port: Path) -> Liconic:
    # A pseudo-terminal takes even parity once; who connects again is refused.
    return Liconic(Setup(name="liconic", workcell="rpl", config={"port": str(port), "parity": "N"}))


def test_takes_a_plate_in_and_hands_it_out(stx: LiconicOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = node_at(port)
        await node.connect()
        (plate,) = world.stock("liconic.exchange", "plate")
        assert (await node.observe())["labware"] == {"exchange": True, "gripper": False}
        await node.load_plate(2, 7)
        assert world.list_contents() == {"liconic.stacker2_slot7": [plate]}
        assert (await node.observe())["labware"] == {"exchange": False, "gripper": False}
        await node.retrieve("stacker2_slot7")
        assert world.list_contents() == {"liconic.exchange": [plate]}
        await node.close()

    run(body)


def test_what_cannot_be_done_moves_nothing(stx: LiconicOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = node_at(port)
        await node.connect()
        with pytest.raises(DeviceError, match="no plate stands on the transfer station") as empty:
            await node.load_plate(1, 1)
        world.stock("liconic.exchange", "plate")
        with pytest.raises(DeviceError, match="a plate stands on the transfer station") as full:
            await node.unload_plate(1, 1)
        await node.begin_shake(20)
        assert (await node.observe())["shaking"] is True
        with pytest.raises(DeviceError, match="it shakes") as shaking:
            await node.load_plate(1, 1)
        await node.end_shake()
        with pytest.raises(DeviceError, match="does not choose slots") as chooses:
            await node.store()
        refused = (empty, full, shaking, chooses)
        assert {told.value.effects for told in refused} == {"none"}
        assert world.motions("grip") == []
        await node.close()

    run(body)


def test_an_empty_slot_is_an_error_that_stays_until_a_reset(
    stx: LiconicOnWire, world: World, port: Path
) -> None:
    async def body() -> None:
        node = node_at(port)
        await node.connect()
        with pytest.raises(DeviceError, match="00016: no plate is on the shovel") as told:
            await node.unload_plate(1, 1)
        assert told.value.effects == "unknown"
        world.stock("liconic.exchange", "plate")
        with pytest.raises(DeviceError, match="00016") as again:
            await node.load_plate(1, 1)
        assert again.value.effects == "none"
        await node.reset()
        await node.load_plate(1, 1)
        await node.close()

    run(body)


def test_climate_is_read_and_set_while_a_plate_moves(world: World, port: Path) -> None:
    async def body() -> None:
        with power_on(LiconicOnWire, "liconic", world, port, pace=50) as stx:
            node = node_at(port)
            await node.connect()
            world.stock("liconic.exchange", "plate")
            moving = asyncio.create_task(node.load_plate(1, 3))
            await until(lambda: not stx.ready)
            await node.set_target_temp(37.0)
            await node.set_target_humidity(90.0)
            assert (await node.get_target_temp(), await node.get_target_humidity()) == (37.0, 90.0)
            assert 22.0 <= await node.get_current_temp() < 37.0
            assert 40.0 <= await node.get_current_humidity() < 90.0
            assert not moving.done()
            await moving
            await node.close()

    run(body)


def test_one_that_was_switched_off_waits_for_a_reset(stx: LiconicOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = node_at(port)
        await node.connect()
        stx.power_cycle()
        with pytest.raises(DeviceError, match="the conversation is not open") as told:
            await node.load_plate(1, 1)
        assert told.value.effects == "none"
        await node.reset()
        assert await node.is_idle()
        await node.close()

    run(body)


def test_a_reset_does_not_believe_a_ready_flag_of_before(stx: LiconicOnWire, port: Path) -> None:
    async def body() -> None:
        node = node_at(port)
        await node.connect()
        stx.stale_s = 200.0  # one second here
        await node.reset()
        assert stx.initialised == 1
        await node.close()

    run(body)


def test_unplugged_in_mid_motion(stx: LiconicOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = node_at(port)
        await node.connect()
        world.stock("liconic.exchange", "plate")
        work = asyncio.create_task(node.load_plate(1, 1))
        await until(lambda: not stx.ready)
        stx.end.unplug()
        # Whether the line fails in a question or between two, the plate is under way.
        with pytest.raises(LinkLost) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(NotConnected):
            await node.load_plate(1, 2)
        await node.close()

    run(body)


def test_another_device_at_its_port(port: Path) -> None:
    async def body() -> None:
        with pytest.raises(WrongDevice, match="what answers b'ready' answers"):
            await node_at(port).connect()

    with answer_on(PtyEnd(port), {b"CR": b"ready\r\n"}, stop=b"\r"):
        run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = Liconic(Setup(name="liconic", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        world.stock("liconic.exchange", "plate")
        await node.load_plate(3, 22)
        assert list(world.list_contents()) == ["liconic.stacker3_slot22"]
        await node.close()

    run(body)


def test_a_shovel_that_is_not_seen_to_be_emptied_is_not(
    stx: LiconicOnWire, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (plate,) = world.stock("liconic.exchange", "plate")
    world.grip("liconic", "liconic.exchange")
    monkeypatch.setattr(stx, "_place", lambda target, back_s: stx.after(back_s, stx._become_ready))

    async def body() -> None:
        node = node_at(port)
        await node.connect()
        with pytest.raises(DeviceError, match="its sensors do not show the plate where it should be") as told:
            await node.put_down()
        assert told.value.effects == "unknown"
        await node.close()

    run(body)
    assert world.at("hand:liconic") == [plate]
