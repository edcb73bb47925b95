"""The PF400 driver and a simulated PF400 behind a TCP connection."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from labos.errors import BadInput, DeviceError, Garbled, LinkLost, NotConnected, WrongDevice
from labos.link import TcpEnd, keep_transcript, read_transcript
from labos.node import World
from labos_drivers._wired import parse_host_port
from labos_drivers.pf400 import PF400, kinematics, protocol
from labos_drivers.pf400 import driver as pf400_driver
from labos_drivers.pf400.wire import PF400OnWire
from tests.drivers.wires import at_port, power_on, run, setup_of, until

POSES = {
    "sealer.default": [205.128, -2.814, 264.373, 365.863, 79.144, 411.553],
    "ot2.deck2": [163.230, -59.032, 270.965, 415.013, 129.982, -951.510],
    "wc.regrip": [188.2, -12.506, 251.918, 388.242, 80.116, 151.300],
    "wc.lidnest": [188.2, -12.506, 251.918, 388.242, 80.116, 700.0],
    "wc.trash": [218.457, -2.408, 38.829, 683.518, 89.109, 995.074],
    "wc.beyond": [205.128, -94.0, 264.373, 365.863, 79.144, 411.553],
    "wc.ceiling": [390.0, -2.814, 264.373, 365.863, 79.144, 100.0],
    "wc.short": [205.128, -2.814, 264.373, 365.863],
}
TOLD: dict[str, Any] = {"poses": POSES, "regrip": "wc.regrip"}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm moves a few hundred times as fast as a real one."""
    monkeypatch.setattr(pf400_driver, "POLL_S", 0.005)
    monkeypatch.setattr(pf400_driver, "BEGIN_S", 0.3)


@pytest.fixture
def arm(world: World) -> Iterator[PF400OnWire]:
    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=400) as device:
        yield device


@asynccontextmanager
async def drive(arm: PF400OnWire, **told: Any) -> AsyncIterator[PF400]:
    node = at_port(PF400, "pf400", arm.address, key="host", **{**TOLD, **told})
    await node.connect()
    try:
        yield node
    finally:
        await node.close()


def test_the_hand_stays_where_it_is_while_it_turns() -> None:
    pose = tuple(POSES["wc.regrip"])
    turned = kinematics.turn_hand(pose, 90.0, protocol.LIMITS)
    assert turned is not None
    before, after = kinematics.find_hand(pose), kinematics.find_hand(turned)
    assert after[:3] == pytest.approx(before[:3])
    assert abs((after[3] - before[3]) % 360 - 180) == pytest.approx(90)
    assert kinematics.solve_reach(pose, before[3], pose[5]) == pytest.approx(pose)


def test_a_plate_is_carried(arm: PF400OnWire, world: World, tmp_path: Path) -> None:
    (plate,) = world.stock("sealer.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            await node.transfer("sealer.default", "rpl/ot2.positions.deck2")
            assert await node.observe() == {"labware": {"gripper": False}}
            assert await node.is_idle()

    with keep_transcript(tmp_path / "talk.txt"):
        run(body)
    assert world.at("ot2.deck2") == [plate]
    assert world.crashes() == []
    sent = b"".join(record.data for record in read_transcript(tmp_path / "talk.txt") if record.mark == ">")
    assert sent.count(b"GraspPlate 85 100 10\n") == 1
    assert b"waitForEom" not in sent  # behind it a halt would not be heard


def test_the_grip_is_turned_on_the_way(arm: PF400OnWire, world: World) -> None:
    (plate,) = world.stock("sealer.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "wide")

    run(body)
    grips = [(m.verb, m.place, m.facts["how"]) for m in world.motions() if m.verb in ("grip", "release")]
    assert grips == [
        ("grip", "sealer.default", "narrow"),
        ("release", "wc.regrip", "narrow"),
        ("grip", "wc.regrip", "wide"),
        ("release", "ot2.deck2", "wide"),
    ]
    assert world.at("ot2.deck2") == [plate]


def test_the_grip_is_turned_where_the_step_says(arm: PF400OnWire, world: World) -> None:
    """As in the WEI node of the paper's authors, a step may name another place than the arm's own."""
    world.stock("sealer.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "wide", rotation_deck="wc.lidnest")

    run(body)
    grips = [(m.verb, m.place) for m in world.motions() if m.verb in ("grip", "release")]
    assert grips[1:3] == [("release", "wc.lidnest"), ("grip", "wc.lidnest")]


TALL = {
    place: [column + 20, *POSES[place][1:5], rail + 6]
    for place in ("sealer.default", "ot2.deck2", "wc.regrip")
    for column, rail in [(POSES[place][0], POSES[place][5])]
}
"""Where the hand gets round a taller plate, which lies a little off the others."""


def test_each_labware_type_is_found_where_it_is(world: World) -> None:
    told = {**TOLD, "poses_of": {"deep": TALL}}

    async def body(arm: PF400OnWire) -> None:
        async with drive(arm, **told) as node:
            (flat,) = world.stock("sealer.default", "flat")
            await node.transfer("sealer.default", "ot2.deck2", labware_type="flat")
            assert world.at("ot2.deck2") == [flat]
            (deep,) = world.stock("sealer.default", "deep+lid")
            # With the pose of the other type the fingers close beside it.
            for wrong in ("", "flat"):
                with pytest.raises(DeviceError, match="nothing came between the fingers"):
                    await node.transfer("sealer.default", "wc.trash", labware_type=wrong)
            await node.remove_lid("sealer.default", "wc.lidnest", labware_type="lid", plate_type="deep")
            assert world.at("wc.lidnest") == [f"lid of {deep}"]
            await node.replace_lid("wc.lidnest", "sealer.default", labware_type="lid", plate_type="deep")
            await node.transfer("ot2.deck2", "wc.trash", labware_type="flat")
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "wide", labware_type="deep")
            assert world.at("ot2.deck2") == [deep]
            await node.transfer("ot2.deck2", "sealer.default", "wide", "wide", labware_type="deep")
            await node.explore_workcell()

    taught = {name: POSES[name] for name in POSES if name not in ("wc.beyond", "wc.ceiling", "wc.short")}
    told["poses"] = taught
    with power_on(PF400OnWire, "pf400", world, told=told, pace=400) as arm:
        run(lambda: body(arm))
    assert world.crashes() == []
    carried = [(m.verb, m.place, m.plate) for m in world.motions() if m.verb in ("grip", "release")]
    assert ("release", "wc.regrip", "plate2") in carried


def test_a_plate_set_down_by_the_pose_of_another_type_is_dropped(world: World) -> None:
    """What types of poses are for: the device finds out, not the driver."""
    world.stock("sealer.default", "deep")
    told = {**TOLD, "poses_of": {"deep": {"ot2.deck2": TALL["ot2.deck2"]}}}

    async def body(arm: PF400OnWire) -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="error -3100"):
                await node.transfer("sealer.default", "ot2.deck2", labware_type="deep")

    with power_on(PF400OnWire, "pf400", world, told=told, pace=400) as arm:
        run(lambda: body(arm))
    assert [m.facts["what"] for m in world.crashes()] == ["drops a plate"]


def test_lids_and_waste(arm: PF400OnWire, world: World) -> None:
    world.stock("sealer.default", "plate+lid")

    async def body() -> None:
        async with drive(arm) as node:
            await node.remove_lid("sealer.default", "wc.lidnest")
            assert world.at("wc.lidnest") == ["lid of plate1"]
            await node.replace_lid("wc.lidnest", "sealer.default")
            await node.transfer("sealer.default", "wc.trash")

    run(body)
    assert world.list_contents() == {}
    assert [m.plate for m in world.motions("discard")] == ["plate1"]
    assert world.crashes() == []


@pytest.mark.parametrize(
    ("target", "why"),
    [
        ("wc.beyond", "out of reach: shoulder at -94, limits -93 to 93"),
        ("wc.ceiling", "out of reach: column at 405, limits 0 to 400"),
        ("wc.short", "taught with 4 joints"),
        ("wc.nowhere", "was not taught"),
    ],
)
def test_what_cannot_be_reached_is_refused_before_anything_moves(
    arm: PF400OnWire, world: World, target: str, why: str
) -> None:
    world.stock("sealer.default", "plate")
    before = arm.joints

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match=why) as told:
                await node.transfer("sealer.default", target)
            assert told.value.effects == "none"
            node.setup.regrip = ""
            with pytest.raises(DeviceError, match="no place where it could change") as turn:
                await node.transfer("sealer.default", "ot2.deck2", "narrow", "wide")
            assert turn.value.effects == "none"

    run(body)
    assert arm.joints == before


def test_the_arms_own_limits_are_kept(world: World) -> None:
    async def body(arm: PF400OnWire) -> None:
        async with drive(arm) as node:
            # The column of this arm is shorter than the driver knows.
            arm.limits = ((0.0, 180.0), *protocol.LIMITS[1:])
            node.device.link.close()  # type: ignore[union-attr]
            await node.is_idle()
            with pytest.raises(DeviceError, match="limits 0 to 180") as told:
                await node.transfer("ot2.deck2", "sealer.default")
            assert told.value.effects == "none"

    with power_on(PF400OnWire, "pf400", world, told=TOLD) as arm:
        run(lambda: body(arm))


def test_nothing_between_the_fingers_is_told(arm: PF400OnWire, world: World) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="nothing came between the fingers") as told:
                await node.transfer("sealer.default", "ot2.deck2")
            assert told.value.effects == "none"
            world.stock("sealer.default", "plate")
            await node.transfer("sealer.default", "ot2.deck2")

    run(body)
    assert world.crashes() == []


def test_what_is_lost_on_the_way_is_not_put_down(arm: PF400OnWire, world: World) -> None:
    world.stock("sealer.default", "plate")
    arm.is_slippery = True

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="lost what it held on its way") as told:
                await node.transfer("sealer.default", "ot2.deck2")
            assert told.value.effects == "unknown"

    run(body)
    assert world.list_contents() == {"floor": ["plate1"]}


def test_a_question_that_fails_before_a_motion_has_no_effects(arm: PF400OnWire) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            arm._lines.clear()
            arm._profile = lambda words: arm.send(b"noise\r\n")  # type: ignore[method-assign]
            with pytest.raises(Garbled) as told:
                await node.transfer("sealer.default", "ot2.deck2")
            assert told.value.effects == "none"

    run(body)
    assert not arm.is_in_motion


def test_a_stop_halts_the_arm_and_what_it_holds_is_seen(world: World) -> None:
    (plate,) = world.stock("sealer.default", "plate")

    async def body(arm: PF400OnWire) -> None:
        async with drive(arm) as node:
            work = asyncio.create_task(node.transfer("sealer.default", "ot2.deck2"))
            await until(lambda: bool(world.at("hand:pf400")) and arm.is_in_motion)
            await node.stop()
            with pytest.raises(DeviceError, match="was stopped") as told:
                await work
            assert told.value.effects == "unknown"
            assert not arm.is_in_motion
            assert arm.powered
            assert await node.observe() == {"labware": {"gripper": True}}
            with pytest.raises(DeviceError, match="was stopped"):
                await node.put_down("ot2.deck2")
            await node.reset()
            with pytest.raises(DeviceError, match="its hand is full") as full:
                await node.transfer("sealer.default", "ot2.deck2")
            assert full.value.effects == "none"
            await node.put_down("ot2.deck2")
            assert world.at("ot2.deck2") == [plate]
            with pytest.raises(DeviceError, match="its hand is empty"):
                await node.put_down("ot2.deck2")

    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=40) as arm:
        run(lambda: body(arm))


def test_a_collision_is_told_and_the_arm_comes_back(arm: PF400OnWire, world: World) -> None:
    world.stock("sealer.default", "plate")
    world.stock("ot2.deck2", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="error -3100") as told:
                await node.transfer("sealer.default", "ot2.deck2")
            assert told.value.effects == "unknown"
            with pytest.raises(DeviceError, match="its power is off") as off:
                await node.transfer("ot2.deck2", "sealer.default")
            assert off.value.effects == "none"
            await node.reset()
            assert arm.powered
            assert await node.observe() == {"labware": {"gripper": True}}

    run(body)
    assert len(world.crashes()) == 1


def test_an_emergency_stop_in_mid_motion(world: World) -> None:
    world.stock("sealer.default", "plate")

    async def body(arm: PF400OnWire) -> None:
        async with drive(arm) as node:
            work = asyncio.create_task(node.transfer("sealer.default", "ot2.deck2"))
            await until(lambda: arm.is_in_motion)
            arm.press_stop()
            with pytest.raises(DeviceError, match=r"emergency stop is pressed|power is off") as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(DeviceError, match="emergency stop is pressed"):
                await node.reset()
            arm.stop_is_pressed = False
            await node.reset()
            assert await node.is_idle()

    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=100) as arm:
        run(lambda: body(arm))


def test_a_robot_that_was_off_is_started_by_a_reset_only(world: World) -> None:
    taught = {name: POSES[name] for name in ("sealer.default", "ot2.deck2")}

    async def body(arm: PF400OnWire) -> None:
        async with drive(arm, poses=taught) as node:
            with pytest.raises(DeviceError, match="its power is off"):
                await node.explore_workcell()
            assert not arm.powered
            await node.reset()
            assert arm.homed
            await node.explore_workcell()
            node.setup.poses["wc.beyond"] = POSES["wc.beyond"]
            with pytest.raises(DeviceError, match="out of reach"):
                await node.explore_workcell()

    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=400, started=False) as arm:
        run(lambda: body(arm))


def test_unplugged_in_mid_motion(world: World) -> None:
    world.stock("sealer.default", "plate")

    async def body(arm: PF400OnWire) -> None:
        async with drive(arm) as node:
            work = asyncio.create_task(node.transfer("sealer.default", "ot2.deck2"))
            await until(lambda: arm.is_in_motion)
            arm.end.unplug()
            with pytest.raises((LinkLost, NotConnected)) as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(NotConnected) as gone:
                await node.transfer("sealer.default", "ot2.deck2")
            assert gone.value.effects == "none"
            arm.end.plug()
            await until(lambda: not arm.is_in_motion)
            await asyncio.to_thread(node.device.link.open, 5.0)  # type: ignore[union-attr]
            await node.reset()
            assert await node.is_idle()

    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=100) as arm:
        run(lambda: body(arm))


def test_behind_wait_for_eom_a_halt_is_not_heard(world: World) -> None:
    """What the driver avoids, and why."""
    with (
        power_on(PF400OnWire, "pf400", world, told=TOLD, pace=20) as arm,
        socket.create_connection(parse_host_port(arm.address, 0)) as line,
    ):
        received = line.makefile("rb")
        line.sendall(b"movej 1 300 1.4 177.101 537.107 90 800\n")
        assert received.readline() == b"0\r\n"
        line.sendall(b"waitForEom\nhalt\nwherej\n")
        assert [received.readline() for _ in range(2)] == [b"0\r\n", b"0\r\n"]
        assert received.readline().endswith(b" 800.000\r\n")
        line.sendall(b"movej 1 400 1.4 177.101 537.107 90 0\nhalt\nwherej\n")
        assert [received.readline() for _ in range(2)] == [b"0\r\n", b"0\r\n"]
        assert float(received.readline().split()[-1]) > 1
        line.sendall(b"foo\nmovej 1 900 1.4 177.101 537.107 90 0\n")
        assert received.readline().startswith(b"-2805 ")
        assert received.readline().startswith(b"-1012 ")


def answer_with(*answers: bytes) -> tuple[TcpEnd, threading.Thread]:
    """Something at a port that gives these answers, one to each line, the last one for ever."""
    end = TcpEnd()

    def talk() -> None:
        left = list(answers)
        while end._listener.fileno() >= 0:
            for _ in range(end.read(0.05).count(b"\n")):
                end.write(left.pop(0) if len(left) > 1 else left[0])

    thread = threading.Thread(target=talk, daemon=True)
    thread.start()
    return end, thread


@pytest.mark.parametrize(
    ("answers", "error", "why"),
    [
        ((b"0\r\n", b"0\r\n", b"0 15\r\n", b"0 1\r\n"), WrongDevice, "a robot of type 15 answers"),
        ((b"Welcome to a printer\r\n",), NotConnected, "does not identify itself"),
        ((b"0\r\n", b"0\r\n", b"0 twelve\r\n"), NotConnected, "is no number"),
    ],
)
def test_who_is_no_pf400_is_not_driven(
    answers: tuple[bytes, ...], error: type[DeviceError], why: str
) -> None:
    end, thread = answer_with(*answers)

    async def body() -> None:
        with pytest.raises(error, match=why) as told:
            await at_port(PF400, "pf400", end.address, key="host").connect()
        assert told.value.effects == "none"

    run(body)
    end.close()
    thread.join()


@pytest.mark.parametrize("joint", [b"17\xff7.1", b"nan", b"inf", b""])
def test_a_garbled_position_is_no_position(joint: bytes) -> None:
    """Nothing is as near to a joint that is no number as to one that stands still."""
    who = (b"0\r\n", b"0\r\n", b"0 12\r\n", b"0 0,0\r\n", b"0 0,0\r\n")
    where = b"0 400.0 1.4 %s 537.1 90.0 0.0\r\n" % joint if joint else b"0 \r\n"
    end, thread = answer_with(*who, where)

    async def body() -> None:
        node = at_port(PF400, "pf400", end.address, key="host")
        await node.connect()
        with pytest.raises(Garbled, match=r"does not say where the arm is|has 0 joints"):
            await node.is_idle()
        await node.close()

    run(body)
    end.close()
    thread.join()


@pytest.mark.parametrize("told", [(b"0 2", b"0 1"), (b"0 -1", b"0 1"), (b"0 1", b"0 2"), (b"0 1", b"0 -1")])
def test_only_its_word_says_that_it_is_powered_and_homed(told: tuple[bytes, bytes]) -> None:
    who = (b"0\r\n", b"0\r\n", b"0 12\r\n", b"0 0,0\r\n", b"0 0,0\r\n", b"0 A1\r\n", b"0 1\r\n")
    where = b"0 400.0 1.4 177.1 537.1 90.0 0.0\r\n"
    end, thread = answer_with(*who, where, *(each + b"\r\n" for each in told), b"-1046\r\n")

    async def body() -> None:
        node = at_port(PF400, "pf400", end.address, key="host", **TOLD)
        await node.connect()
        with pytest.raises(DeviceError, match=r"its power is off\.|it is not homed\.") as caught:
            await node.transfer("sealer.default", "ot2.deck2")
        assert caught.value.effects == "none"
        assert "-1046" not in str(caught.value), "it was not asked to move"
        await node.close()

    run(body)
    end.close()
    thread.join()


def test_simulated_behind_its_wire(world: World) -> None:
    (plate,) = world.stock("sealer.default", "plate")

    async def body() -> None:
        node = PF400(setup_of("pf400", world, 400, wire=True, **TOLD))
        await node.connect()
        await node.transfer("sealer.default", "ot2.deck2")
        await node.close()

    run(body)
    assert world.at("ot2.deck2") == [plate]


@pytest.mark.parametrize("width", [87.0, 88.0, 82.5, 100.0, 62.0, 124.0, 128.4])
def test_a_hand_that_is_not_seen_open_lets_nothing_go(arm: PF400OnWire, world: World, width: float) -> None:
    """A plate may be between the fingers: to begin a transfer by opening them would drop it."""
    (held,) = world.stock("sealer.default", "plate")
    world.grip("pf400", "sealer.default", "narrow")
    world.stock("sealer.default", "plate")
    arm.set_fingers(width)

    async def body() -> None:
        async with drive(arm) as node:
            for work in (lambda: node.transfer("sealer.default", "ot2.deck2"), node.free_mode):
                with pytest.raises(DeviceError, match="whether its hand is empty") as told:
                    await work()
                assert told.value.effects == "none"
            assert await node.observe() == {}

    run(body)
    assert world.at("hand:pf400") == [held]
    assert world.crashes() == []


@pytest.mark.parametrize("wider_mm", [2.0, -3.0, 3.5])
def test_a_plate_of_another_width_is_carried(arm: PF400OnWire, world: World, wider_mm: float) -> None:
    arm.wider_mm = wider_mm
    (plate,) = world.stock("sealer.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "narrow")
            assert await node.observe() == {"labware": {"gripper": False}}

    run(body)
    assert world.at("ot2.deck2") == [plate]


def test_a_plate_as_wide_as_open_fingers_is_let_go_where_it_stood(arm: PF400OnWire, world: World) -> None:
    arm.wider_mm = 4.5
    (plate,) = world.stock("sealer.default", "deep")

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="as if they were open") as told:
                await node.transfer("sealer.default", "ot2.deck2", "narrow", "narrow")
            assert told.value.effects == "none"
        arm.wider_mm = 0.0
        deep = {"deep": {"narrow": {"open": 95, "closed": 89}}}
        with pytest.raises(BadInput, match="could not be distinguished from closed"):
            await at_port(
                PF400, "pf400", arm.address, key="host", **TOLD, config={"grips_of": deep}
            ).connect()
        arm.set_fingers(94.0)
        config = {"grips": {"narrow": {"open": 94}}, "grips_of": deep}
        async with drive(arm, config=config) as node:
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "narrow", labware_type="deep")

    run(body)
    assert world.at("ot2.deck2") == [plate]


def test_after_a_restart_a_person_says_what_the_hand_holds(world: World) -> None:
    """The node forgot how wide its plate was: the lab knows that it is there, or a person has looked."""
    (plate,) = world.stock("sealer.default", "plate")

    async def body(arm: PF400OnWire) -> None:
        arm.wider_mm = 2.0
        async with drive(arm) as node:
            work = asyncio.create_task(node.transfer("sealer.default", "ot2.deck2", "narrow", "narrow"))
            await until(lambda: bool(world.at("hand:pf400")) and arm.is_in_motion)
            await node.stop()
            with pytest.raises(DeviceError, match="was stopped"):
                await work
            assert await node.observe() == {"labware": {"gripper": True}}
            await node.reset()
            with pytest.raises(DeviceError, match="its hand is full"):
                await node.open_fingers()
        async with drive(arm) as node:
            assert await node.observe() == {}
            with pytest.raises(DeviceError, match="put_down"):
                await node.transfer("sealer.default", "ot2.deck2")
            await node.put_down("sealer.default")
            assert world.at("sealer.default") == [plate]
            arm.set_fingers(62.0)
            with pytest.raises(DeviceError, match="its hand is empty"):
                await node.put_down("sealer.default")
            await node.open_fingers()
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "narrow")

    with power_on(PF400OnWire, "pf400", world, told=TOLD, pace=40) as arm:
        run(lambda: body(arm))
    assert world.at("ot2.deck2") == [plate]
    assert world.crashes() == []


@pytest.mark.parametrize(
    "grips",
    [
        {"narrow": {"open": 86, "closed": 85}},
        {"narrow": {"closed": 20}},
        {"narrow": 90},
        ["narrow"],
        {"thin": {}},
    ],
)
def test_grips_that_cannot_be_are_refused(arm: PF400OnWire, grips: Any) -> None:
    async def body() -> None:
        with pytest.raises(BadInput, match="`grips"):
            await at_port(PF400, "pf400", arm.address, key="host", **TOLD, config={"grips": grips}).connect()

    run(body)


FIVE = {
    "sealer.default": POSES["sealer.default"][:5],
    "ot2.deck2": [700.0, -59.032, 270.965, 415.013, 79.982],
}
TALL_COLUMN = ((0.0, 750.0), *protocol.LIMITS[1:])


def test_an_arm_without_a_rail_with_a_taller_column_and_another_neutral_pose(world: World) -> None:
    (plate,) = world.stock("sealer.default", "plate")
    told: dict[str, Any] = {"poses": FIVE}
    neutral = [740.0, 0.0, 180.0, -180.0]

    async def body(arm: PF400OnWire) -> None:
        arm.joints = (*neutral, 90.0, 0.0)
        async with drive(arm, **told, config={"neutral": neutral}) as node:
            await node.transfer("sealer.default", "ot2.deck2", "narrow", "narrow")
            assert len(await node.read_pose()) == 6
            await node.reset()
        assert arm.joints[:4] == pytest.approx(neutral)

    made = {"has_rail": False, "limits": TALL_COLUMN}
    with power_on(PF400OnWire, "pf400", world, told=told, pace=400, **made) as arm:
        run(lambda: body(arm))
    assert world.at("ot2.deck2") == [plate]
    assert world.crashes() == []


def test_a_pose_without_the_rail_is_refused_by_an_arm_on_a_rail(arm: PF400OnWire) -> None:
    async def body() -> None:
        async with drive(arm, poses={**POSES, "ot2.deck2": FIVE["ot2.deck2"]}) as node:
            with pytest.raises(DeviceError, match="taught with 5 joints, not 6") as told:
                await node.transfer("sealer.default", "ot2.deck2")
            assert told.value.effects == "none"

    run(body)


@pytest.mark.parametrize("how", ["argument", "configuration"])
def test_a_shelf_is_reached_through_its_approach(world: World, tmp_path: Path, how: str) -> None:
    """In front of a hotel the arm comes and leaves horizontally, also after a stop inside."""
    gate = [POSES["ot2.deck2"][0] + 4, -40.0, 250.0, 400.0, 80.0, -951.5]
    told: dict[str, Any] = {"poses": {**POSES, "ot2.gate": gate}, "regrip": "wc.regrip"}
    config = {"approach": {"ot2.deck2": "ot2.gate"}, "approach_mm_of": {"ot2.deck2": 5}}
    (plate,) = world.stock("ot2.deck2", "plate")

    async def body(arm: PF400OnWire) -> None:
        given = {"config": config} if how == "configuration" else {}
        through = {} if given else {"source_approach": "ot2.gate"}
        back = {} if given else {"target_approach": "ot2.gate"}
        async with drive(arm, **told, **given) as node:
            with keep_transcript(tmp_path / "talk.txt"):
                await node.transfer("ot2.deck2", "sealer.default", "wide", "wide", **through)
            assert world.at("sealer.default") == [plate]
            await node.pick_plate("sealer.default", "wide")
            assert world.at("hand:pf400") == [plate]
            await node.put_down("ot2.deck2", "wide", **back)
            if given:
                work = asyncio.create_task(node.transfer("ot2.deck2", "sealer.default", "wide", "wide"))
                await until(lambda: bool(world.at("hand:pf400")))
                await node.stop()
                with pytest.raises(DeviceError, match="was stopped"):
                    await work
                with keep_transcript(tmp_path / "reset.txt"):
                    await node.reset()

    with power_on(PF400OnWire, "pf400", world, told=told, pace=60) as arm:
        run(lambda: body(arm))
    stretched = [moves(path, -40.0) for path in sorted(tmp_path.glob("*.txt"))]
    assert all(stretched), "through the gate"
    assert len(moves(tmp_path / "talk.txt", -40.0)) == 2, "there and back"
    assert world.crashes() == []


def moves(path: Path, shoulder: float) -> list[str]:
    """The motions of a transcript with the shoulder at an angle."""
    sent = [str(line) for line in read_transcript(path)]
    return [line for line in sent if "movej" in line and f" {shoulder:.3f} " in line]


def test_a_way_that_was_not_taught_is_refused(arm: PF400OnWire) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match=r"the place wc\.gate was not taught") as told:
                await node.transfer("sealer.default", "ot2.deck2", source_approach="wc.gate")
            assert told.value.effects == "none"
        with pytest.raises(BadInput, match="`neutral` must be four joints"):
            await at_port(
                PF400, "pf400", arm.address, key="host", **TOLD, config={"neutral": [1, 2]}
            ).connect()

    run(body)
