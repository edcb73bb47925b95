"""A person guides the PF400 by hand, so that it learns a place; nothing else moves it meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError
from labos.link import keep_transcript, read_transcript
from labos.node import Requires, Sets, World
from labos_drivers.pf400 import PF400, protocol
from labos_drivers.pf400 import driver as pf400_driver
from labos_drivers.pf400.wire import PF400OnWire
from tests.drivers.conftest import Bench
from tests.drivers.wires import at_port, power_on, run

SEALER = [205.128, -2.814, 264.373, 365.863, 79.144, 411.553]
PUSHED = (150.0, -20.0, 250.0, 380.0, 130.0, 300.0)
TOLD: dict[str, Any] = {
    "poses": {"sealer.default": SEALER, "ot2.deck2": [163.2, -59, 271, 415, 79.1, -951.5]}
}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pf400_driver, "POLL_S", 0.005)
    monkeypatch.setattr(pf400_driver, "BEGIN_S", 0.3)


@pytest.fixture
def arm(world: World) -> Iterator[PF400OnWire]:
    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=400) as device:
        yield device


def node_at(arm: PF400OnWire) -> PF400:
    return at_port(PF400, "pf400", arm.address, key="host", **TOLD)


def test_all_that_moves_it_waits_until_nobody_guides_it() -> None:
    """``tests/system/test_by_hand.py`` holds a lab to it."""
    for spec in PF400.describe().actions:
        moves = spec.exclusive and not any(isinstance(e, Sets) for e in spec.effects)
        assert (Requires("module", "free", False) in spec.effects) is moves, spec.name


def test_a_place_is_taught_by_hand(arm: PF400OnWire, world: World, tmp_path: Path) -> None:
    world.stock("sealer.default", "plate")

    async def body() -> None:
        node = node_at(arm)
        await node.connect()
        before = await node.read_pose()
        await node.free_mode()
        assert await node.observe() == {"free": True, "labware": {"gripper": False}}
        arm.guide(PUSHED)
        # Fingers and column stand where they stood.
        assert await node.read_pose() == [before[0], *PUSHED[1:4], before[4], PUSHED[5]]
        for work in (node.transfer("sealer.default", "ot2.deck2"), node.explore_workcell()):
            with pytest.raises(DeviceError, match="somebody guides it by hand") as refused:
                await work
            assert refused.value.effects == "none"
        await node.end_free_mode()
        assert await node.observe() == {"free": False, "labware": {"gripper": False}}
        assert (await node.read_pose())[:4] == list(protocol.NEUTRAL)
        await node.transfer("sealer.default", "ot2.deck2")
        await node.close()

    with keep_transcript(tmp_path / "talk.txt"):
        run(body)
    sent = b"".join(record.data for record in read_transcript(tmp_path / "talk.txt") if record.mark == ">")
    freed = [line for line in sent.split(b"\n") if line.startswith(b"freemode")]
    assert freed == [b"freemode 2", b"freemode 3", b"freemode 4", b"freemode 6", b"freemode -1"]
    assert [m.verb for m in world.motions() if m.verb in ("yield", "hold")] == ["yield", "hold"]
    assert world.at("ot2.deck2") == ["plate1"]
    assert world.crashes() == []


def test_the_column_yields_if_it_is_asked_for(arm: PF400OnWire) -> None:
    async def body() -> None:
        node = node_at(arm)
        await node.connect()
        await node.free_mode(column=True)
        arm.guide(PUSHED)
        assert await node.read_pose() == [*PUSHED[:4], protocol.NARROW.open_mm, PUSHED[5]]
        await node.reset()  # ends it too
        assert not arm.free_axes
        assert (await node.read_pose())[:4] == list(protocol.NEUTRAL)
        await node.close()

    run(body)


def test_an_arm_beyond_its_limits_is_brought_back_by_hand(arm: PF400OnWire, world: World) -> None:
    arm.joints = (300.0, -95.0, *arm.joints[2:])

    async def body() -> None:
        node = node_at(arm)
        await node.connect()
        with pytest.raises(DeviceError, match="-1012"):
            await node.reset()
        await node.free_mode()
        arm.guide((300.0, -80.0, *arm.joints[2:]))
        await node.end_free_mode()
        assert await node.is_idle()
        await node.close()

    run(body)
    assert world.crashes() == []


def test_it_is_not_freed_without_power_nor_with_a_plate(arm: PF400OnWire, world: World) -> None:
    async def body() -> None:
        node = node_at(arm)
        await node.connect()
        arm.set_fingers(protocol.NARROW.closed_mm)
        with pytest.raises(DeviceError, match="its hand is full") as full:
            await node.free_mode()
        arm.set_fingers(protocol.NARROW.open_mm)
        arm.powered = arm.attached = False
        with pytest.raises(DeviceError, match="its power is off") as off:
            await node.free_mode()
        assert (full.value.effects, off.value.effects) == ("none", "none")
        assert not arm.free_axes
        await node.close()

    run(body)
    assert world.motions("yield") == []


def test_a_new_node_does_not_pretend_to_know(arm: PF400OnWire) -> None:
    """As after `labos teach`, which starts the node again: that the arm is free is in the lab's log."""

    async def body() -> None:
        node = node_at(arm)
        await node.connect()
        await node.free_mode()
        await node.close()
        again = node_at(arm)
        await again.connect()
        assert "free" not in await again.observe()
        assert arm.free_axes
        await again.end_free_mode()
        assert not arm.free_axes
        await again.close()

    run(body)


def test_on_the_bench_it_crashes_who_moves_it_nevertheless(bench: Bench, world: World) -> None:
    world.stock("sealer.default", "plate")

    async def body() -> None:
        node = await bench.start(PF400, "pf400")
        await node.free_mode()
        assert (await node.observe())["free"] is True
        again = await bench.start(PF400, "pf400")
        assert (await again.observe())["free"] is True
        with pytest.raises(Exception, match="moves while a person guides it"):
            await again.transfer("sealer.default", "ot2.deck2")
        await again.end_free_mode()
        await again.transfer("sealer.default", "ot2.deck2")

    asyncio.run(body())
    assert len(world.crashes()) == 1
