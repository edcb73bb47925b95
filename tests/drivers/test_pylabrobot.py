"""Foreign drivers at the other end: those of PyLabRobot drive the simulated devices, unmodified."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from labos.link import TcpEnd
from labos.node import World
from labos_drivers.a4s_sealer.wire import SealerOnWire
from labos_drivers.brooks_peeler.wire import PeelerOnWire
from labos_drivers.liconic.wire import LiconicOnWire
from labos_drivers.pf400.wire import PF400OnWire
from tests.drivers.wires import power_on

pytest.importorskip("pylabrobot", reason="PyLabRobot is not installed (it is with the extra `test`)")


def test_its_sealer_driver_seals(world: World, tmp_path: Path) -> None:
    from pylabrobot.sealing.a4s_backend import A4SBackend

    async def body(port: str) -> None:
        sealer = A4SBackend(port, timeout=20)
        await sealer.setup()
        assert not (await sealer.close()).sensor_status.shuttle_open_sensor
        assert (await sealer.open()).sensor_status.shuttle_open_sensor
        done = await sealer.seal(temperature=170, duration=3)
        assert done.sensor_status.shuttle_open_sensor
        assert done.current_temperature == 170.0
        await sealer.stop()

    with power_on(SealerOnWire, "sealer", world, tmp_path / "port", pace=40) as device:
        (plate,) = world.stock("sealer.default", "plate")
        asyncio.run(body(device.address))
    assert [motion.plate for motion in world.motions("seal")] == [plate]


def test_its_peeler_driver_looks_and_resets(
    world: World, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its ``peel`` sends seconds where the device takes a code, and is refused as an illegal command."""
    from pylabrobot.peeling.xpeel_backend import XPeelBackend

    async def body(port: str) -> None:
        peeler = XPeelBackend(port, timeout=5)
        await peeler.setup()
        assert await peeler.get_version() == ["*1.4"]
        assert await peeler.seal_check() == "plate_not_detected"
        world.stock("peeler.default", "plate")
        world.work("somebody", "seal", "peeler.default")
        assert await peeler.seal_check() == "seal_detected"
        await peeler._send_command("*xpeel:41", expect_ack=True, wait_for_ready=True)
        assert await peeler.seal_check() == "no_seal"
        refused = await peeler.peel(begin_location=0, fast=False, adhere_time=2.5)
        assert refused[-1].startswith("*ready:05")
        assert (await peeler.reset())[0] == "*ack"
        await peeler.stop()

    with power_on(PeelerOnWire, "peeler", world, tmp_path / "port", pace=200) as device:
        asyncio.run(body(device.address))
    assert len(world.motions("peel")) == 1


def test_its_arm_driver_homes_moves_halts_and_carries(world: World) -> None:
    from pylabrobot.arms.precise_flex.joints import PFAxis
    from pylabrobot.arms.precise_flex.pf_400 import PreciseFlex400Backend
    from pylabrobot.arms.precise_flex.precise_flex_backend import PreciseFlexError

    poses = {"sealer.default": [205.0, -2.8, 264.4, 365.9, 79.1, 0.0], "nest": [180.0, 40, 90, 400, 79, 0.0]}

    def joints(pose: list[float], **other: float) -> dict[int, float]:
        return {axis: other.get(axis.name, pose[axis - 1]) for axis in PFAxis if axis != PFAxis.RAIL}

    async def body(host: str, port: int) -> None:
        arm = PreciseFlex400Backend(host, port)
        await arm.setup()
        assert await arm.get_version() == "TCS 3.0D4"
        await arm.set_speed(100)
        assert await arm.get_power_state() == 1
        await arm.move_j(1, joints(poses["nest"], BASE=300.0))
        found = await arm.get_joint_position()  # behind a waitForEom of its own
        assert found[PFAxis.BASE] == 300.0
        await arm.open_gripper(90)
        await arm.pick_up_resource(joints(poses["sealer.default"], GRIPPER=90.0), plate_width=85)
        assert world.at("hand:pf400") == ["plate1"]
        assert not await arm.is_gripper_closed()
        await arm.set_joint_angles(1, joints(poses["nest"], GRIPPER=85.0))
        await arm.place_plate_to_stored_position(1)
        await arm.move_j(1, joints(poses["nest"], BASE=0.0))
        await arm.halt()
        assert (await arm.get_joint_position())[PFAxis.BASE] > 1
        with pytest.raises(PreciseFlexError, match="-1012"):
            await arm.move_j(1, joints(poses["nest"], SHOULDER=120.0))
        await arm.stop()

    world.stock("sealer.default", "plate")
    told = {"poses": poses}
    with power_on(PF400OnWire, "pf400", world, told=told, pace=60, started=False) as device:
        assert isinstance(device.end, TcpEnd)
        asyncio.run(body(device.end.host, device.end.port))
        assert not device.powered
    assert world.at("pf400.nest") == ["plate1"]
    assert world.crashes() == []


def driving_an_incubator(world: World, port: Path, use: Callable[[Any], Awaitable[None]]) -> None:
    """What its driver does between ``setup`` and ``stop``; after each question it reads for a whole
    second, so that nothing here is quick."""
    from pylabrobot.storage.liconic.liconic_backend import ExperimentalLiconicBackend

    async def body(address: str) -> None:
        incubator = ExperimentalLiconicBackend("STX44_IC", address)
        await incubator.setup()  # even parity and RTS/CTS, as with the instrument
        await use(incubator)
        await incubator.stop()

    with power_on(LiconicOnWire, "liconic", world, port, pace=200) as device:
        asyncio.run(body(device.address))


@pytest.mark.slow
def test_its_incubator_driver_takes_a_plate_in(world: World, tmp_path: Path) -> None:
    from pylabrobot.resources import cor_96_wellplate_360uL_Fb
    from pylabrobot.storage.liconic.racks import liconic_rack_17mm_22

    (plate,) = world.stock("liconic.exchange", "plate")

    async def use(incubator: Any) -> None:
        racks = [liconic_rack_17mm_22(f"rack{number}") for number in (1, 2)]
        with pytest.warns(UserWarning, match="configured manually"):
            await incubator.set_racks(racks)
        await incubator.take_in_plate(cor_96_wellplate_360uL_Fb("any"), racks[1].sites[6])

    driving_an_incubator(world, tmp_path / "port", use)
    assert world.list_contents() == {"liconic.stacker2_slot7": [plate]}
    assert world.crashes() == []


@pytest.mark.full
def test_its_incubator_driver_hands_it_out_and_sets_the_climate(world: World, tmp_path: Path) -> None:
    from pylabrobot.resources import cor_96_wellplate_360uL_Fb
    from pylabrobot.storage.liconic.racks import liconic_rack_17mm_22

    (plate,) = world.stock("liconic.stacker1_slot22", "plate")

    async def use(incubator: Any) -> None:
        rack = liconic_rack_17mm_22("rack1")
        with pytest.warns(UserWarning, match="configured manually"):
            await incubator.set_racks([rack])
        rack.sites[21].assign_child_resource(cor_96_wellplate_360uL_Fb("any"))
        assert not await incubator.check_transfer_sensor()
        await incubator.fetch_plate_to_loading_tray(rack.sites[21].resource)
        assert world.list_contents() == {"liconic.exchange": [plate]}
        assert await incubator.check_transfer_sensor()
        assert not await incubator.check_shovel_sensor()
        await incubator.set_temperature(37.0)
        await incubator.set_humidity(0.9)
        assert await incubator.get_target_temperature() == 37.0
        assert await incubator.get_target_humidity() == 0.9
        assert 22.0 <= await incubator.get_temperature() <= 37.0
        await incubator.start_shaking(25)
        await incubator.stop_shaking()

    driving_an_incubator(world, tmp_path / "port", use)
    assert [motion.place for motion in world.motions("grip")] == ["liconic.stacker1_slot22"]
    assert world.crashes() == []
