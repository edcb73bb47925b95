"""The Inheco driver and a simulated incubator on a pseudo-terminal, which PyLabRobot's driver drives too."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError, Garbled, LinkLost, NotConnected, WrongDevice
from labos.link import BadFrame, PtyEnd
from labos.node import Setup, World
from labos_drivers.inheco import Inheco, protocol
from labos_drivers.inheco import driver as inheco_driver
from labos_drivers.inheco.wire import InhecoOnWire
from tests.drivers.conftest import Bench
from tests.drivers.wires import at_port, power_on, run, until
from tests.integration.link.far import answer_on


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inheco_driver, "POLL_S", 0.01)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "inheco"


@pytest.fixture
def incubator(world: World, port: Path) -> Iterator[InhecoOnWire]:
    with power_on(InhecoOnWire, "inheco", world, port) as device:
        yield device


# -- frames ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "frame"),
    [
        ("RTS", "09 32 c6 54 30 30 52 54 53 46"),
        ("AOD", "09 32 c6 54 30 30 41 4f 44 39"),
        ("STT370", "0c 32 c9 54 30 30 53 54 54 33 37 30 39"),
    ],
)
def test_questions_as_they_are_on_the_wire(command: str, frame: str) -> None:
    assert protocol.make_command(command, 0) == bytes.fromhex(frame)


def test_answers_are_taken_whole_or_not_at_all() -> None:
    answers = protocol.Answers(2)
    buffer = bytearray(protocol.make_answer("370", 0))
    assert answers.take(buffer) == b"\x00370"
    whole = protocol.make_answer("", 7)
    for cut in range(len(whole)):
        buffer = bytearray(whole[:cut])
        assert answers.take(buffer) is None
    buffer = bytearray(whole + protocol.make_answer("1", 0))
    assert (answers.take(buffer), answers.take(buffer)) == (b"\x07", b"\x001")
    with pytest.raises(BadFrame, match="does not have the start"):
        answers.take(bytearray(b"370" + whole))
    with pytest.raises(BadFrame, match="without a terminator"):
        answers.take(bytearray(b"\xb2" + b"3" * 300))


# -- the device --------------------------------------------------------------------------------


def test_a_plate_is_taken_in_warmed_and_shaken(incubator: InhecoOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(Inheco, "inheco", port)
        await node.connect()
        assert await node.observe() == {"door": "closed", "shaking": False, "labware": {"default": False}}
        await node.open_door()
        world.stock("inheco.default", "plate96")
        assert await node.observe() == {"door": "open", "shaking": False}
        await node.close_door()
        assert (await node.observe())["labware"] == {"default": True}
        await node.set_temperature(37.0)
        await node.begin_shake(speed=900, amplitude=1.5)
        status = await node.get_status()
        assert (status["shaking"], status["heating"], status["target"]) == (True, True, 37.0)
        assert 22.0 <= await node.get_temperature() <= 37.0
        with pytest.raises(DeviceError, match="it shakes") as told:
            await node.open_door()
        assert told.value.effects == "none"
        await node.begin_shake(speed=600)
        await node.end_shake()
        await node.stop_temperature()
        assert (await node.get_status())["heating"] is False
        assert await node.is_idle()
        await node.close()

    run(body)
    assert [motion.facts for motion in world.motions("shake")] == [
        {"rpm": 900, "mm": 1.5},
        {"rpm": 600, "mm": 2.0},
    ]


def test_what_cannot_be_done_moves_nothing(incubator: InhecoOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(Inheco, "inheco", port)
        await node.connect()
        with pytest.raises(DeviceError, match="Inheco error 10 to ASE1: it finds a plate") as no_plate:
            await node.begin_shake()
        await node.open_door()
        with pytest.raises(DeviceError, match="the door is not closed") as is_open:
            await node.begin_shake()
        incubator.kind = protocol.MP
        with pytest.raises(DeviceError, match="has no shaker") as no_shaker:
            await node.begin_shake()
        incubator.heater_broken = True
        with pytest.raises(DeviceError, match="heater off"):
            await node.set_temperature(37.0)
        assert (await node.get_status())["errors"] == 256
        assert {told.value.effects for told in (no_plate, is_open, no_shaker)} == {"none"}
        await node.close()

    run(body)
    assert world.motions("shake") == []


def test_a_moment_without_power(incubator: InhecoOnWire, world: World, port: Path) -> None:
    """It says so once, refuses all until it is initialised, and is set again to what it was set to."""

    async def body() -> None:
        node = at_port(Inheco, "inheco", port)
        await node.connect()
        await node.set_temperature(40.0)
        incubator._initialised, incubator._reports_reset, incubator.heats = False, True, False
        with pytest.raises(DeviceError, match="error 1 to RSE: it was reset") as told:
            await node.open_door()
        assert told.value.effects == "none"
        with pytest.raises(DeviceError, match="error 7 to AOD: it is not initialised"):
            await node.open_door()
        await node.reset()
        assert incubator.heats
        assert (await node.get_status())["target"] == 40.0
        await node.open_door()
        await node.close()

    run(body)


def test_a_drawer_that_jams(
    incubator: InhecoOnWire, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual_s = inheco_driver.DRAWER_S

    async def body() -> None:
        node = at_port(Inheco, "inheco", port)
        await node.connect()
        incubator.jammed = True
        monkeypatch.setattr(inheco_driver, "DRAWER_S", 0.5)
        with pytest.raises(DeviceError, match=r"not reached its end within 0\.5 s") as told:
            await node.open_door()
        assert told.value.effects == "unknown"
        assert not await node.is_idle()
        assert "door" not in await node.observe()
        assert (await node.get_status())["door"] == "moving"
        with pytest.raises(DeviceError, match="cannot be stopped"):
            await node.stop()
        incubator.jammed = False
        incubator.pull(open_=False)
        monkeypatch.setattr(inheco_driver, "DRAWER_S", usual_s)
        await node.reset()
        await node.open_door()
        await node.close()

    run(body)


def test_unplugged_in_mid_motion(world: World, port: Path) -> None:
    async def body(incubator: InhecoOnWire) -> None:
        node = at_port(Inheco, "inheco", port)
        await node.connect()
        work = asyncio.create_task(node.open_door())
        await until(lambda: incubator.drawer == "")
        incubator.end.unplug()
        with pytest.raises(LinkLost) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(NotConnected):
            await node.close_door()
        await node.close()

    with power_on(InhecoOnWire, "inheco", world, port, pace=20) as device:
        run(lambda: body(device))


def test_another_device_or_another_floor(incubator: InhecoOnWire, world: World, port: Path) -> None:
    with pytest.raises(WrongDevice, match="what answers with error 14"):
        run(at_port(Inheco, "inheco", port, config={"floor": 1}).connect)
    with pytest.raises(DeviceError, match="`floor:` is 6"):
        run(at_port(Inheco, "inheco", port, config={"floor": 6}).connect)


def test_an_answer_to_something_else(port: Path) -> None:
    question = protocol.make_command("RTS", 0)
    says: dict[bytes, Any] = {b"": protocol.make_answer("370", 0)}
    with answer_on(PtyEnd(port), says, stop=question), pytest.raises(NotConnected) as told:
        run(at_port(Inheco, "inheco", port).connect)
    assert isinstance(told.value.__cause__, Garbled)


def test_on_the_bench(bench: Bench, world: World) -> None:
    async def body() -> None:
        node = await bench.start(Inheco, "inheco")
        assert await node.observe() == {"door": "closed", "shaking": False, "labware": {"default": False}}
        await node.open_door()
        world.stock("inheco.default", "plate96")
        await node.close_door()
        await node.set_temperature(37.0)
        assert (await node.get_status())["target"] == 37.0
        await node.begin_shake()
        await node.end_shake()
        again = await bench.start(Inheco, "inheco")
        await again.open_door()
        third = await bench.start(Inheco, "inheco")
        assert (await third.observe())["door"] == "open"
        await third.stop()
        await third.reset()
        assert (await third.observe())["door"] == "closed"

    run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = Inheco(Setup(name="inheco", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        await node.open_door()
        assert not world.is_shut("inheco.default")
        await node.close()

    run(body)


# -- a foreign driver --------------------------------------------------------------------------


def test_pylabrobots_driver_incubates_and_shakes(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pseudo-terminal has no DTR and no RTS that it could switch off."""
    pytest.importorskip("pylabrobot", reason="PyLabRobot is not installed (it is with the extra `test`)")
    import serial
    from pylabrobot.storage.inheco.incubator_shaker_backend import (
        InhecoError,
        InhecoIncubatorShakerStackBackend,
    )

    monkeypatch.setattr(serial.Serial, "_update_dtr_state", lambda port: None)
    monkeypatch.setattr(serial.Serial, "_update_rts_state", lambda port: None)

    async def body(address: str, device: InhecoOnWire) -> None:
        stack = InhecoIncubatorShakerStackBackend(dip_switch_id=2, port=address)
        await stack.setup()
        assert stack.unit_composition == ["incubator_shaker_mp"]
        assert await stack.request_drawer_status(stack_index=0) == "closed"
        await stack.open(stack_index=0)
        await until(lambda: device.drawer == "1")
        world.stock("inheco.default", "plate96")
        assert await stack.request_drawer_status(stack_index=0) == "open"
        await stack.close(stack_index=0)
        await until(lambda: device.drawer == "0")
        assert await stack.request_plate_in_incubator(stack_index=0)
        await stack.start_temperature_control(37.0, stack_index=0)
        assert await stack.request_target_temperature(stack_index=0) == 37.0
        assert await stack.is_temperature_control_enabled(stack_index=0)
        assert 22.0 <= await stack.get_temperature(stack_index=0) <= 37.0
        await stack.shake(stack_index=0, rpm=600, amplitude_x_mm=2.0, amplitude_y_mm=2.0)
        await until(lambda: bool(world.motions("shake")))
        with pytest.raises(InhecoError, match="E08"):
            await stack.open(stack_index=0)
        await stack.stop_shaking(stack_index=0)
        await until(lambda: device.shaker == "0")
        await stack.stop()
        assert not device.heats

    with power_on(InhecoOnWire, "inheco", world, tmp_path / "port", pace=40, started=False) as device:
        device._reports_reset = False  # that driver does not expect it
        run(lambda: body(device.address, device))
    assert [motion.facts for motion in world.motions("shake")] == [{"rpm": 600, "mm": 2.0}]
