"""Foreign drivers at the other end: those of PyLabRobot drive the simulated devices, unmodified."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from labos.node import World
from labos_drivers.a4s_sealer.wire import SealerOnWire
from labos_drivers.brooks_peeler.wire import PeelerOnWire
from tests.drivers.wires import powered

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

    with powered(SealerOnWire, "sealer", world, tmp_path / "port", pace=40) as device:
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

    with powered(PeelerOnWire, "peeler", world, tmp_path / "port", pace=200) as device:
        asyncio.run(body(device.address))
    assert len(world.motions("peel")) == 1
