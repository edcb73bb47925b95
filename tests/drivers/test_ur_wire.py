"""The UR driver and a simulated UR controller behind its dashboard."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from labos.errors import DeviceError, Garbled, LinkLost, NotConnected, WrongDevice
from labos.link import TcpEnd
from labos.node import World
from labos_drivers._wired import parse_host_port
from labos_drivers.ur import UR, protocol, rtde
from labos_drivers.ur import driver as ur_driver
from labos_drivers.ur.wire import UROnWire
from tests.drivers.wires import at_port, power_on, run, setup_of, until

PROGRAMS = [
    {"program": "chem2tecan.urp", "source": "chemspeed.default", "target": "tecan.default"},
    {"program": "/programs/pick chem.urp", "source": "chemspeed.default", "target": "gripper"},
    {"program": "put tecan.urp", "source": "gripper", "target": "tecan.default"},
    {"program": "wave.urp"},
]
TOLD: dict[str, Any] = {"config": {"programs": PROGRAMS, "gripper": "robotiq"}}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm lives a hundred times as fast as a real one."""
    monkeypatch.setattr(ur_driver, "POLL_S", 0.005)


@pytest.fixture
def arm(world: World) -> Iterator[UROnWire]:
    with power_on(UROnWire, "ur5", world, told=TOLD, pace=200) as device:
        yield device


@asynccontextmanager
async def drive(arm: UROnWire, **config: Any) -> AsyncIterator[UR]:
    node = at_port(UR, "ur5", arm.address, key="host", config={**TOLD["config"], **config})
    await node.connect()
    try:
        yield node
    finally:
        await node.close()


def test_programs_carry_labware(arm: UROnWire, world: World) -> None:
    plates = world.stock("chemspeed.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            await node.transfer("chemspeed.default", "rpl/tecan.positions.default", "chem2tecan.urp")
            assert world.at("tecan.default") == plates
            assert await node.observe() == {"labware": {"gripper": False}}
            world.carry(plates[0], "chemspeed.default")
            await node.pick("chemspeed.default")
            assert await node.observe() == {"labware": {"gripper": True}}
            with pytest.raises(DeviceError, match="its hand is full") as full:
                await node.transfer("chemspeed.default", "tecan.default")
            assert full.value.effects == "none"
            await node.put_down("tecan.default")
            await node.run_urp_program("wave.urp")
            assert await node.is_idle()

    run(body)
    assert world.at("tecan.default") == plates
    assert [m.facts for m in world.motions("program")] == [{"program": "wave.urp"}]
    assert world.crashes() == []


def test_nothing_in_the_hand_is_told(arm: UROnWire) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="the gripper holds nothing"):
                await node.pick("chemspeed.default")
            with pytest.raises(DeviceError, match="its hand is empty") as told:
                await node.put_down("tecan.default")
            assert told.value.effects == "none"
        async with drive(arm, gripper="") as blind:
            assert await blind.observe() == {}

    run(body)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"remote": False}, "not in remote control"),
        ({"mode": protocol.IDLE}, "robotmode is IDLE"),
        ({"safety": "SAFEGUARD_STOP"}, "safetystatus is SAFEGUARD_STOP"),
        ({"state": protocol.PLAYING}, "a program is PLAYING"),
    ],
)
def test_what_cannot_be_done_now_is_refused(arm: UROnWire, change: dict[str, Any], why: str) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            for name, value in change.items():
                setattr(arm, name, value)
            with pytest.raises(DeviceError, match=why) as told:
                await node.run_urp_program("wave.urp")
            assert told.value.effects == "none"

    run(body)


def test_a_cb3_is_driven(arm: UROnWire, world: World) -> None:
    """Its dashboard knows neither remote control nor `safetystatus`."""
    arm.is_cb3 = True

    async def body() -> None:
        async with drive(arm) as node:
            await node.run_urp_program("wave.urp")
            arm.safety = "SAFEGUARD_STOP"
            with pytest.raises(DeviceError, match="safetystatus is SAFEGUARD_STOP") as told:
                await node.run_urp_program("wave.urp")
            assert told.value.effects == "none"
            arm.safety = protocol.NORMAL
            await node.reset()
            await node.run_urp_program("wave.urp")

    run(body)
    assert len(world.motions("program")) == 2


def test_what_is_no_program_is_refused(arm: UROnWire) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            for work, why in (
                (node.run_urp_program("none.urp"), "File not found"),
                (node.run_urp_program("wave.urp\nshutdown"), "no name of a program"),
                (node.transfer("tecan.default", "chemspeed.default"), "no program that goes from"),
                (node.transfer("chemspeed.default", "tecan.default", "wave.urp"), "not wave.urp"),
            ):
                with pytest.raises(DeviceError, match=why) as told:
                    await work
                assert told.value.effects == "none"

    run(body)


def test_a_stop_stops_the_program(arm: UROnWire, world: World) -> None:
    arm._pace = 50.0  # so slow that it is met on its way
    world.stock("chemspeed.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            work = asyncio.create_task(node.transfer("chemspeed.default", "tecan.default"))
            await until(lambda: bool(world.at("hand:ur5")))
            await node.stop()
            with pytest.raises(DeviceError, match="was stopped") as told:
                await work
            assert told.value.effects == "unknown"
            assert await node.observe() == {"labware": {"gripper": True}}
            await node.reset()
            await node.put_down("tecan.default")

    run(body)
    assert world.crashes() == []


def test_a_transfer_of_nothing_is_told(arm: UROnWire, world: World) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="was not seen to hold anything") as nothing:
                await node.transfer("chemspeed.default", "tecan.default")
            world.stock("chemspeed.default", "plate")
            arm.stopped_by_hand = True
            arm._pace = 30.0  # so slow that it is seen to run before
            with pytest.raises(DeviceError, match="was not seen to hold anything") as stopped:
                await node.transfer("chemspeed.default", "tecan.default")
            assert (nothing.value.effects, stopped.value.effects) == ("unknown", "unknown")

    run(body)
    assert world.at("chemspeed.default") == ["plate1"]


def test_a_gripper_that_is_lost_at_the_end_leaves_open_what_it_did(arm: UROnWire, world: World) -> None:
    world.stock("chemspeed.default", "plate")
    end = arm._end

    def ends(entry: dict[str, Any]) -> None:
        arm.fingers.unplug()
        end(entry)

    arm._end = ends  # type: ignore[method-assign]

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises((LinkLost, NotConnected)) as told:
                await node.pick("chemspeed.default")
            assert told.value.effects == "unknown"

    run(body)
    assert world.at("hand:ur5") == ["plate1"]


def test_what_is_no_answer_to_play_says_nothing_of_what_moves(
    arm: UROnWire, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = arm._answer
    said = {"play": "Startin"}
    monkeypatch.setattr(arm, "_answer", lambda line: said.get(line) or answer(line))

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(Garbled, match="does not say whether wave") as noise:
                await node.run_urp_program("wave.urp")
            said["play"] = "Failed to execute: play"
            with pytest.raises(DeviceError, match="refuses to play wave") as refused:
                await node.run_urp_program("wave.urp")
            assert (noise.value.effects, refused.value.effects) == ("unknown", "none")

    run(body)


def test_a_fault_of_the_safety_system_is_reset(arm: UROnWire) -> None:
    async def body() -> None:
        async with drive(arm) as node:
            arm.safety, arm.mode = "FAULT", protocol.OFF
            await node.reset()
            assert (arm.safety, arm.mode) == (protocol.NORMAL, protocol.RUNNING)

    run(body)


def test_a_collision_is_told_and_unlocked(arm: UROnWire, world: World) -> None:
    world.stock("chemspeed.default", "plate")
    world.stock("tecan.default", "plate")

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match=r"PROTECTIVE_STOP in chem2tecan\.urp") as told:
                await node.transfer("chemspeed.default", "tecan.default")
            assert told.value.effects == "unknown"
            await node.reset()
            assert (arm.safety, arm.state) == (protocol.NORMAL, protocol.STOPPED)

    run(body)
    assert len(world.crashes()) == 1


def test_one_that_is_off_is_started_by_a_reset_only(world: World) -> None:
    async def body(arm: UROnWire) -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="robotmode is POWER_OFF"):
                await node.run_urp_program("wave.urp")
            await node.reset()
            await node.run_urp_program("wave.urp")
            arm.after(0, arm.press_stop)
            await until(lambda: arm.mode == protocol.OFF)
            with pytest.raises(DeviceError, match="safety status is ROBOT_EMERGENCY_STOP") as told:
                await node.reset()
            assert told.value.effects == "none"

    with power_on(UROnWire, "ur5", world, told=TOLD, pace=200, started=False) as arm:
        run(lambda: body(arm))


def test_unplugged_in_mid_program(arm: UROnWire, world: World) -> None:
    arm._pace = 50.0  # so slow that it is met on its way

    async def body() -> None:
        async with drive(arm) as node:
            work = asyncio.create_task(node.run_urp_program("wave.urp"))
            await until(lambda: arm.state == protocol.PLAYING)
            arm.end.unplug()
            with pytest.raises((LinkLost, NotConnected)) as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(NotConnected) as gone:
                await node.run_urp_program("wave.urp")
            assert gone.value.effects == "none"
            arm.end.plug()
            await asyncio.to_thread(node.device.link.open, 5.0)  # type: ignore[union-attr]
            await until(lambda: arm.state == protocol.STOPPED)
            assert await node.is_idle()

    run(body)


def test_garbled_and_late_answers_are_no_answers(arm: UROnWire, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = arm._answer

    async def body() -> None:
        async with drive(arm) as node:
            monkeypatch.setattr(arm, "_answer", lambda line: "Robotmode: RUNNING")  # to another question
            with pytest.raises(Garbled, match="no state of a program"):
                await node.is_idle()
            monkeypatch.setattr(ur_driver, "ANSWER_S", 0.1)
            monkeypatch.setattr(arm, "receive", lambda data: None)
            with pytest.raises(DeviceError, match="does not answer"):
                await node.is_idle()
            monkeypatch.undo()
            monkeypatch.setattr(arm, "_answer", answer)
            arm.end.write(b"PLAYING late.urp\n")  # to the question that was given up
            assert await node.is_idle()

    run(body)


def test_who_does_not_greet_is_no_dashboard(monkeypatch: pytest.MonkeyPatch) -> None:
    silent, other = TcpEnd(), TcpEnd(greeting=b"220 mail.example.org\n")

    async def body() -> None:
        work = asyncio.create_task(at_port(UR, "ur5", other.address, key="host").connect())
        await asyncio.to_thread(other.read, 2.0)
        with pytest.raises(WrongDevice, match="mail"):
            await work
        monkeypatch.setattr(ur_driver, "ANSWER_S", 0.2)
        with pytest.raises(NotConnected, match="does not identify itself"):
            await at_port(UR, "ur5", silent.address, key="host").connect()

    run(body)
    silent.close()
    other.close()


def test_the_client_of_ur_rtde_drives_it(world: World) -> None:
    dashboard_client = pytest.importorskip("dashboard_client", reason="ur-rtde is not installed")
    with power_on(UROnWire, "ur5", world, told=TOLD, pace=200, started=False) as arm:
        host, port = parse_host_port(arm.address.partition(",")[0], 0)
        client = dashboard_client.DashboardClient(host, port)
        client.connect()
        assert client.robotmode() == "Robotmode: POWER_OFF"
        assert client.isInRemoteControl()
        client.powerOn()
        client.brakeRelease()
        while client.robotmode() != "Robotmode: RUNNING":
            pass
        client.loadURP("wave.urp")
        assert client.getLoadedProgram() == "Loaded program: wave.urp"
        client.play()
        assert client.running()
        client.stop()
        assert client.programState().startswith("STOPPED")
        client.disconnect()


RECEIVER = """
import sys, time
from rtde_receive import RTDEReceiveInterface

def tell(*what):
    print(*what, file=sys.stderr, flush=True)  # what it says itself goes to the other one

names = "timestamp actual_q actual_qd robot_mode safety_mode runtime_state robot_status_bits"
receiver = RTDEReceiveInterface(sys.argv[1], 50.0, [*names.split(), "actual_digital_input_bits"])

def until(reached):
    while not reached():
        time.sleep(0.002)

tell(receiver.getRobotMode(), receiver.getSafetyMode(), receiver.getRuntimeState())
until(receiver.getActualDigitalInputBits)
tell(receiver.getActualDigitalInputBits())
until(lambda: receiver.getRuntimeState() == 2)
tell(receiver.getRobotStatus() & 2, receiver.getActualQd()[0] > 0)
until(lambda: receiver.getRuntimeState() == 1)
tell(receiver.getActualQd(), receiver.getActualQ()[1])
receiver.disconnect()
"""


@pytest.mark.timeout(60)
def test_the_receiver_of_ur_rtde_reads_its_state(world: World) -> None:
    pytest.importorskip("rtde_receive", reason="ur-rtde is not installed")
    # Its port cannot be chosen: it is free at an address of our own.
    host = f"127.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250 + 1}.30"
    # It lets no other thread run while it connects.
    command = [sys.executable, "-c", RECEIVER, host]
    with power_on(UROnWire, "ur5", world, told=TOLD, pace=50, data=TcpEnd(host, rtde.PORT)) as arm:
        receiver = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        with receiver:
            told = receiver.stderr
            assert told is not None
            try:
                assert told.readline() == f"7 1 {rtde.STOPPED}\n"
                arm.inputs.add(rtde.TOOL_INPUTS)
                assert told.readline() == f"{1 << rtde.TOOL_INPUTS}\n"
                arm._load("wave.urp")
                arm.after(0, lambda: arm.send(arm._play().encode()))
                assert told.readline() == "2 True\n"
                assert told.readline() == "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0] -1.57\n"
            finally:
                receiver.kill()


SAMPLE = {"plate": "wc.wells", "well": "A1", "liquid_1": "water", "liquid_2": "silica"}
PENDANT = {
    "pipette_input": 16,
    "tip_input": 17,
    "pick_pipette": "pick_pipette.urp",
    "place_pipette": "place_pipette.urp",
    "create_sample": [{**SAMPLE, "program": "water_silica_a1.urp"}],
    "run_droplet": "droplet.urp",
    "dispose_tip": "dispose_tip.urp",
}


def test_a_pendant_drop(world: World) -> None:
    """The workflow ``demo`` of the public workcell 8IDI."""
    world.stock("wc.wells", "plate")
    world.supply("ur5", "tips", 3)
    config = {"config": {**TOLD["config"], "pendant": PENDANT}}

    async def body(arm: UROnWire) -> None:
        async with drive(arm, pendant=PENDANT) as node:
            await node.pick_pipette()
            assert await node.observe() == {"tool": "pipette", "tip": "", "labware": {"gripper": False}}
            for work, why in (
                (node.pick_pipette(), "tool is pipette; pick_pipette needs none"),
                (node.transfer("chemspeed.default", "tecan.default"), "its gripper needs none"),
                (node.create_sample(**{**SAMPLE, "well": "B7"}), "no program for create_sample with plate"),
                (node.dispose_tip(), "tip is none; dispose_tip needs sample"),
            ):
                with pytest.raises(DeviceError, match=why) as told:
                    await work
                assert told.value.effects == "none"
            await node.create_sample(**SAMPLE)
            await node.place_pipette()
            await node.run_droplet()
            await node.pick_pipette()
            await node.dispose_tip()
            await node.place_pipette()
            assert await node.observe() == {"tool": "", "tip": "", "labware": {"gripper": False}}
            arm.inputs.add(16)  # the changer does not let go
            with pytest.raises(DeviceError, match="its tool is pipette") as stuck:
                await node.run_droplet()
            assert stuck.value.effects == "none"

    with power_on(UROnWire, "ur5", world, told=config, pace=200) as arm:
        run(lambda: body(arm))
    done = [m.verb for m in world.motions() if m.device == "ur5" and m.verb not in ("enter", "leave", "use")]
    steps = "pick_pipette create_sample place_pipette run_droplet pick_pipette dispose_tip place_pipette"
    assert done == steps.split()
    assert world.find_level("ur5", "tips") == 1
    assert world.crashes() == []


def test_what_the_inputs_tell_after_an_action_is_held_against_it(world: World) -> None:
    config = {"config": {**TOLD["config"], "pendant": PENDANT}}

    async def body(arm: UROnWire) -> None:
        async with drive(arm, pendant=PENDANT) as node:
            arm.programs["pick_pipette.urp"] = {"program": "pick_pipette.urp"}  # it misses the pipette
            with pytest.raises(DeviceError, match="its tool is none; after pick_pipette") as told:
                await node.pick_pipette()
            assert told.value.effects == "unknown"
        async with drive(arm, rtde=False, pendant=PENDANT) as blind:
            await blind.pick_pipette()
            assert await blind.observe() == {"labware": {"gripper": False}}

    with power_on(UROnWire, "ur5", world, told=config, pace=200) as arm:
        run(lambda: body(arm))


def test_a_gripper_may_tell_by_an_input(arm: UROnWire, world: World) -> None:
    async def body() -> None:
        async with drive(arm, gripper={"input": 3}) as node:
            assert await node.observe() == {"labware": {"gripper": False}}
            arm.inputs.add(3)
            while await node.observe() != {"labware": {"gripper": True}}:
                pass
            with pytest.raises(DeviceError, match="its hand is full"):
                await node.transfer("chemspeed.default", "tecan.default")

    run(body)


@pytest.mark.parametrize(
    "config",
    [{"gripper": {"input": 18}}, {"pendant": {"tip_input": -1}}, {"pendant": {"pipette_input": "16"}}],
)
def test_an_input_that_no_controller_has_is_refused(arm: UROnWire, config: dict[str, Any]) -> None:
    async def body() -> None:
        with pytest.raises(DeviceError, match="is no digital input, of which there are 0 to 17") as told:
            await at_port(UR, "ur5", arm.address, key="host", config=config).connect()
        assert told.value.effects == "none"

    run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    plates = world.stock("chemspeed.default", "plate")

    async def body() -> None:
        node = UR(setup_of("ur5", world, 200, wire=True, **TOLD))
        await node.connect()
        await node.transfer("chemspeed.default", "tecan.default")
        await node.close()

    run(body)
    assert world.at("tecan.default") == plates


def test_a_gripper_whose_fingers_never_rest_is_not_known_to_be_empty(
    arm: UROnWire, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_driver, "FINGERS_S", 0.1)
    world.stock("chemspeed.default", "plate")
    arm.fingers_move = True

    async def body() -> None:
        async with drive(arm) as node:
            assert await node.observe() == {}
            for work in (node.transfer("chemspeed.default", "tecan.default"), node.pick("chemspeed.default")):
                with pytest.raises(DeviceError, match="whether it holds something is not known") as told:
                    await work
                assert told.value.effects == "none"
            await node.run_urp_program("wave.urp")  # as the one that activates it

    run(body)
    assert world.at("chemspeed.default") == ["plate1"]


def test_what_fingers_hold_that_still_move_after_a_program_is_not_known(
    arm: UROnWire, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_driver, "FINGERS_S", 0.1)
    world.stock("chemspeed.default", "plate")
    end = arm._end

    def ends(entry: dict[str, Any]) -> None:
        arm.fingers_move = True
        end(entry)

    arm._end = ends  # type: ignore[method-assign]

    async def body() -> None:
        async with drive(arm) as node:
            with pytest.raises(DeviceError, match="whether it holds something is not known") as told:
                await node.pick("chemspeed.default")
            assert told.value.effects == "unknown"

    run(body)
    assert world.at("hand:ur5") == ["plate1"]
