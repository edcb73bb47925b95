"""The drivers of the SciClops and the PlateCrane, and simulated ones on a pseudo-terminal."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError, Garbled, LinkLost, NoReply, NotConnected, WrongDevice
from labos.link import PtyEnd, keep_transcript, read_transcript
from labos.node import World
from labos_drivers import _hudson
from labos_drivers._hudson_device import HudsonOnWire
from labos_drivers.platecrane import PlateCrane
from labos_drivers.platecrane.wire import PlateCraneOnWire
from labos_drivers.sciclops import Sciclops
from labos_drivers.sciclops.wire import SciclopsOnWire
from tests.drivers.wires import at_port, power_on, run, setup_of, until

KINDS: dict[str, Any] = {"sciclops": (Sciclops, SciclopsOnWire), "crane": (PlateCrane, PlateCraneOnWire)}
STACK = {"sciclops": "tower2", "crane": "Stack2"}
NEST = {"sciclops": "exchange", "crane": "hidex.default"}
LID_NEST = {"sciclops": "lidnest1", "crane": "LidNest1"}
TOLD: dict[str, dict[str, Any]] = {
    "sciclops": {"poses": {"sciclops.exchange": [0, 0, 0, 0], "wc.beyond": [-380, 400, 33, 100]}},
    "crane": {
        "poses": {
            "hidex.default": [182_000, -30_000, 460, 4_000],
            "wc.beyond": [400_000, -30_000, 460, 4_000],
        }
    },
}


@pytest.fixture(params=sorted(KINDS))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "arm"


@pytest.fixture
def arm(kind: str, world: World, port: Path) -> Iterator[HudsonOnWire]:
    with power_on(KINDS[kind][1], kind, world, port, told=TOLD[kind], pace=2000) as device:
        yield device


@asynccontextmanager
async def drive(kind: str, port: Path) -> AsyncIterator[Any]:
    node = at_port(KINDS[kind][0], kind, port, **TOLD[kind])
    await node.connect()
    try:
        yield node
    finally:
        await node.close()


def place(kind: str, name: str) -> str:
    return name if "." in name else f"{kind}.{name}"


def test_plates_leave_a_stack_from_the_top(
    kind: str, arm: HudsonOnWire, world: World, port: Path, tmp_path: Path
) -> None:
    plates = world.stock(place(kind, STACK[kind]), "plate", 3)

    async def body() -> None:
        async with drive(kind, port) as node:
            await node.transfer(STACK[kind], NEST[kind])
            assert world.at(place(kind, NEST[kind])) == plates[-1:]
            assert await node.observe() == {"labware": {"gripper": False}}
            await node.transfer(NEST[kind], STACK[kind])
            assert await node.is_idle()

    with keep_transcript(tmp_path / "talk.txt"):
        run(body)
    assert world.at(place(kind, STACK[kind])) == plates
    assert world.crashes() == []
    sent = b"".join(record.data for record in read_transcript(tmp_path / "talk.txt") if record.mark == ">")
    assert sent.startswith(b"GETPOS\r\n")
    assert sent.count(b"JOG Z,-") == 2  # only to find the top of the stack
    assert sent.count(b"LOADPOINT TEMP, ") == sent.count(b"MOVE TEMP\r\n") == sent.count(b"DELETEPOINT TEMP")


def test_lids_come_off_and_go_on(kind: str, arm: HudsonOnWire, world: World, port: Path) -> None:
    (plate,) = world.stock(place(kind, NEST[kind]), "plate+lid")

    async def body() -> None:
        async with drive(kind, port) as node:
            await node.remove_lid(NEST[kind], LID_NEST[kind])
            assert world.at(place(kind, LID_NEST[kind])) == [f"lid of {plate}"]
            await node.replace_lid(LID_NEST[kind], NEST[kind])

    run(body)
    assert world.at(f"lid:{plate}") == [f"lid of {plate}"]
    assert world.crashes() == []


def test_an_empty_place_is_told(kind: str, arm: HudsonOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        async with drive(kind, port) as node:
            with pytest.raises(DeviceError, match="the gripper touched the floor") as empty:
                await node.transfer(STACK[kind], NEST[kind])
            with pytest.raises(DeviceError, match="nothing came between the fingers") as bare:
                await node.transfer(NEST[kind], STACK[kind])
            assert (empty.value.effects, bare.value.effects) == ("none", "none")
            world.stock(place(kind, STACK[kind]), "plate")
            await node.transfer(STACK[kind], NEST[kind])

    run(body)
    assert world.crashes() == []


def test_what_is_lost_on_the_way_is_not_put_down(
    kind: str, arm: HudsonOnWire, world: World, port: Path
) -> None:
    world.stock(place(kind, STACK[kind]), "plate")
    arm.is_slippery = True

    async def body() -> None:
        async with drive(kind, port) as node:
            with pytest.raises(DeviceError, match="lost what it held on its way") as told:
                await node.transfer(STACK[kind], NEST[kind])
            assert told.value.effects == "unknown"

    run(body)
    assert world.list_contents() == {"floor": ["plate1"]}


def test_what_cannot_be_reached_is_refused_before_anything_moves(
    kind: str, arm: HudsonOnWire, world: World, port: Path
) -> None:
    before = arm.at

    async def body() -> None:
        async with drive(kind, port) as node:
            for target, why in (("wc.beyond", "out of reach: R at 400"), ("wc.nowhere", "was not taught")):
                with pytest.raises(DeviceError, match=why) as told:
                    await node.transfer(STACK[kind], target)
                assert told.value.effects == "none"
            node.setup.poses["wc.short"] = [1.0, 2.0]
            with pytest.raises(DeviceError, match="taught with 2 axes"):
                await node.transfer(STACK[kind], "wc.short")
            with pytest.raises(DeviceError, match="its hand is empty"):
                await node.put_down(NEST[kind])

    run(body)
    assert arm.at == before


def test_a_crash_is_told_and_what_is_held_is_seen(
    kind: str, arm: HudsonOnWire, world: World, port: Path
) -> None:
    world.stock(place(kind, STACK[kind]), "plate")
    (in_the_way,) = world.stock(place(kind, NEST[kind]), "plate")

    async def body() -> None:
        async with drive(kind, port) as node:
            with pytest.raises(DeviceError, match=r"Hudson error 1400.*has hit something") as told:
                await node.transfer(STACK[kind], NEST[kind])
            assert told.value.effects == "unknown"
            assert await node.observe() == {"labware": {"gripper": True}}
            await node.reset()
            with pytest.raises(DeviceError, match="its hand is full") as full:
                await node.transfer(STACK[kind], NEST[kind])
            assert full.value.effects == "none"
            world.carry(in_the_way, "")
            await node.put_down(NEST[kind])

    run(body)
    assert len(world.crashes()) == 1
    assert len(world.at(place(kind, NEST[kind]))) == 1


def test_one_that_is_not_homed_is_homed_by_a_reset_only(kind: str, world: World, port: Path) -> None:
    async def body(arm: HudsonOnWire) -> None:
        async with drive(kind, port) as node:
            with pytest.raises(DeviceError, match="it is not homed") as told:
                await node.transfer(STACK[kind], NEST[kind])
            assert told.value.effects == "none"
            assert not arm.homed
            await node.reset()
            assert arm.homed

    with power_on(KINDS[kind][1], kind, world, port, told=TOLD[kind], pace=2000, homed=False) as arm:
        run(lambda: body(arm))


def test_a_stop_sends_nothing_more(kind: str, world: World, port: Path) -> None:
    world.stock(place(kind, STACK[kind]), "plate")

    async def body(arm: HudsonOnWire) -> None:
        async with drive(kind, port) as node:
            work = asyncio.create_task(node.transfer(STACK[kind], NEST[kind]))
            await until(lambda: arm.is_in_motion)
            with pytest.raises(DeviceError, match="takes no stop over its wire"):
                await node.stop()
            with pytest.raises(DeviceError, match="was stopped") as told:
                await work
            assert told.value.effects == "unknown"
            await node.reset()
            await node.transfer(STACK[kind], NEST[kind])

    with power_on(KINDS[kind][1], kind, world, port, told=TOLD[kind], pace=500) as arm:
        run(lambda: body(arm))


def test_unplugged_in_mid_motion(kind: str, world: World, port: Path) -> None:
    world.stock(place(kind, STACK[kind]), "plate")

    async def body(arm: HudsonOnWire) -> None:
        async with drive(kind, port) as node:
            work = asyncio.create_task(node.transfer(STACK[kind], NEST[kind]))
            await until(lambda: arm.is_in_motion)
            arm.end.unplug()
            with pytest.raises(LinkLost) as told:
                await work
            assert told.value.effects == "unknown"
            with pytest.raises(NotConnected) as gone:
                await node.transfer(STACK[kind], NEST[kind])
            assert gone.value.effects == "none"
            arm.end.plug()
            await until(lambda: not arm.is_in_motion)
            await asyncio.to_thread(node.device.link.open, 5.0)
            await node.reset()
            assert await node.is_idle()

    with power_on(KINDS[kind][1], kind, world, port, told=TOLD[kind], pace=500) as arm:
        run(lambda: body(arm))


def test_two_cables_are_swapped(kind: str, world: World, port: Path) -> None:
    other = KINDS["crane" if kind == "sciclops" else "sciclops"][1]

    async def body() -> None:
        with pytest.raises(WrongDevice, match="was expected, but a") as told:
            await at_port(KINDS[kind][0], kind, port).connect()
        assert told.value.effects == "none"

    with power_on(other, kind, world, port):
        run(body)


def test_late_and_garbled_answers_are_no_answers(
    kind: str, arm: HudsonOnWire, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    obey = arm._obey

    async def body() -> None:
        async with drive(kind, port) as node:
            # The echo comes, the result does not; then it comes late, before the next answer.
            monkeypatch.setattr(_hudson, "ANSWER_S", 0.1)
            monkeypatch.setattr(arm, "_obey", lambda line: None)
            with pytest.raises(NoReply):
                await node.is_idle()
            monkeypatch.setattr(_hudson, "ANSWER_S", 10.0)
            arm.end.write(b"0000 late\r\n")
            monkeypatch.setattr(arm, "_obey", obey)
            assert await node.observe() == {"labware": {"gripper": False}}
            monkeypatch.setattr(arm, "_obey", lambda line: arm.send(b"ATS\r\n"))
            with pytest.raises(Garbled, match="does not tell where the fingers are"):
                await node.observe()

    run(body)


def test_who_repeats_nothing_is_no_arm(kind: str, port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_hudson, "ECHO_S", 0.1)
    end = PtyEnd(port)

    async def body() -> None:
        with pytest.raises(NotConnected, match="does not identify itself") as told:
            await at_port(KINDS[kind][0], kind, port).connect()
        assert told.value.effects == "none"

    run(body)
    end.close()


def test_simulated_behind_its_wire(kind: str, world: World) -> None:
    world.stock(place(kind, STACK[kind]), "plate")

    async def body() -> None:
        node = KINDS[kind][0](setup_of(kind, world, 2000, wire=True, **TOLD[kind]))
        await node.connect()
        await node.transfer(STACK[kind], NEST[kind])
        await node.close()

    run(body)
    assert len(world.at(place(kind, NEST[kind]))) == 1


def test_get_plate_and_home(world: World, port: Path) -> None:
    async def body() -> None:
        async with drive("sciclops", port) as node:
            await node.home()
            await node.get_plate("tower1")

    world.stock("sciclops.tower1", "plate", 2)
    with power_on(SciclopsOnWire, "sciclops", world, port, pace=2000):
        run(body)
    assert len(world.at("sciclops.exchange")) == 1


def test_height_offsets_raise_both_ends(world: World, port: Path) -> None:
    async def body() -> None:
        async with drive("crane", port) as node:
            await node.transfer("LidNest1", "LidNest2", height_offset=50)

    (plate,) = world.stock("crane.LidNest1", "plate")
    with power_on(PlateCraneOnWire, "crane", world, port, pace=2000):
        run(body)
    assert world.at("crane.LidNest2") == [plate]


@pytest.mark.parametrize("noise", ["0000 Success", "0000", "0000 Success\r\n\r\n0000"])
def test_data_may_come_on_a_later_line(
    arm: HudsonOnWire, kind: str, world: World, port: Path, monkeypatch: pytest.MonkeyPatch, noise: str
) -> None:
    (plate,) = world.stock(place(kind, STACK[kind]), "plate")
    data = arm._send_data

    def late(text: str) -> None:
        arm.send(noise.encode() + b"\r\n")
        data(text)
        arm.send(b"0000 Success\r\n")

    monkeypatch.setattr(arm, "_send_data", late)

    async def body() -> None:
        async with drive(kind, port) as node:
            assert await node.is_idle()
            await node.transfer(STACK[kind], NEST[kind])

    run(body)
    assert world.at(place(kind, NEST[kind])) == [plate]


@pytest.mark.parametrize("status", ["2", "14", "BUSY", ""])
def test_a_status_that_is_not_known_is_not_ready(
    arm: HudsonOnWire, kind: str, world: World, port: Path, monkeypatch: pytest.MonkeyPatch, status: str
) -> None:
    monkeypatch.setattr(_hudson, "LATER_S", 0.05)
    world.stock(place(kind, STACK[kind]), "plate")
    obey = arm._obey
    monkeypatch.setattr(
        arm, "_obey", lambda line: arm.send(f"0000 {status}\r\n".encode()) if line == "STATUS" else obey(line)
    )

    async def body() -> None:
        async with drive(kind, port) as node:
            assert not await node.is_idle()
            with pytest.raises(DeviceError, match="not known to mean that it is ready") as told:
                await node.transfer(STACK[kind], NEST[kind])
            assert told.value.effects == "none"
        config = {"port": str(port), "ready_status": [status]}
        node = KINDS[kind][0](setup_of(kind, None, 1.0, config=config, **TOLD[kind]))
        await node.connect()
        assert await node.is_idle()
        await node.close()

    run(body)


def say_both(arm: HudsonOnWire, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the sensors of its fingers say that these are open and shut at once."""
    obey = arm._obey
    both = "GETGRIPPERISOPEN", "GETGRIPPERISCLOSED"
    monkeypatch.setattr(arm, "_obey", lambda line: arm.send(b"true\r\n") if line in both else obey(line))


def test_fingers_that_are_open_and_shut_are_not_empty(
    arm: HudsonOnWire, kind: str, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.stock(place(kind, STACK[kind]), "plate")
    say_both(arm, monkeypatch)

    async def body() -> None:
        async with drive(kind, port) as node:
            assert await node.observe() == {}
            with pytest.raises(DeviceError, match="whether it holds something is not known") as told:
                await node.transfer(STACK[kind], NEST[kind])
            assert told.value.effects == "none"

    run(body)
    assert [motion for motion in world.motions() if motion.device == kind] == []


def test_fingers_that_do_not_tell_what_they_took_do_not_open_again(
    arm: HudsonOnWire, kind: str, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (plate,) = world.stock(place(kind, STACK[kind]), "plate")
    grip = world.grip

    def grips(*args: Any) -> None:
        grip(*args)
        say_both(arm, monkeypatch)

    monkeypatch.setattr(world, "grip", grips)

    async def body() -> None:
        async with drive(kind, port) as node:
            with pytest.raises(DeviceError, match="whether it holds something is not known") as told:
                await node.transfer(STACK[kind], NEST[kind])
            assert told.value.effects == "unknown"

    run(body)
    assert world.at(f"hand:{kind}") == [plate]
