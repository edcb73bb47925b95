"""The axis' driver and a simulated CiA 402 drive on a CAN bus behind an adapter on a serial port; and that
drive with canopen's own implementation of the profile."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import canopen
import pytest
import yaml
from canopen.profiles.p402 import BaseNode402

from labos.bootstrap import descriptions
from labos.core.effects import Sets
from labos.errors import BadInput, DeviceError, NotConnected, OutcomeUnknown, WrongDevice
from labos.node import World
from labos.node.node import handle_keeper
from labos.spec import load_workcell, parse_workcell
from labos.spec.about import find_description
from labos_drivers.axis import driver, objects, profile, wire
from labos_drivers.axis.interface import Axis
from labos_drivers.axis.profile import State
from labos_drivers.axis.table import STAGE, AxisTable
from labos_drivers.axis.wire import DriveOnSlcan
from tests.docs.markdown import ROOT, blocks
from tests.drivers.wires import power_on, run, setup_of, until

PAGE = ROOT / "docs" / "drivers" / "axis.md"
PACE = 40.0


@pytest.fixture
def drive(world: World) -> Iterator[DriveOnSlcan]:
    with power_on(DriveOnSlcan, "stage", world, pace=PACE) as device:
        yield device


def node_at(device: DriveOnSlcan, **config: Any) -> Axis:
    told = {"interface": "slcan", "channel": device.address, "bus": {"sleep_after_open": 0}, **config}
    node = Axis.for_config(told)(setup_of("stage", None, 1.0, config={"late_s": 0.1, **told}))
    assert isinstance(node, Axis)
    return node


def table(**other: Any) -> dict[str, Any]:
    """The table of the stage, but for what is said."""
    return STAGE.model_dump(exclude_none=True) | other


def verbs(world: World) -> list[str]:
    return [motion.verb for motion in world.motions() if motion.device == "stage"]


def test_homes_and_goes_where_it_is_sent(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        assert await node.observe() == {"homed": False}
        await node.home()
        assert await node.observe() == {"homed": True, "position": 0.0}
        await node.move_to(123.4, speed=100.0)
        assert await node.observe() == {"homed": True, "position": 123.4}
        assert await node.read_position() == 123.4
        await node.move_to(20.0)
        assert verbs(world) == ["homes", "stands at 0", "moves", "stands at 123.4", "moves", "stands at 20"]
        assert await node.is_idle()
        await node.close()

    run(body)


def test_what_cannot_be_done_moves_nothing(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        with pytest.raises(DeviceError, match=r"does not know where it is\. Home it") as lost:
            await node.move_to(100.0)
        with pytest.raises(DeviceError, match="does not know where it is"):
            await node.read_position()
        await node.home()
        drive._node.set_data(profile.LIMITS, profile.HIGHEST, wire._encode(STAGE.counts(80)))
        with pytest.raises(DeviceError, match=r"beyond the drive's own limits\. They are 0 and 80 mm") as far:
            await node.move_to(100.0)
        assert {told.value.effects for told in (lost, far)} == {"none"}
        assert "moves" not in verbs(world)
        await node.close()

    run(body)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("blocked", r"it could not follow \(following error\) \(error 8611\)\. Look for what is in its way"),
        ("hot", r"it is too hot \(error 4310\)\. Let it cool down"),
    ],
)
def test_a_fault_stays_until_a_reset(drive: DriveOnSlcan, world: World, fault: str, words: str) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        await node.home()
        setattr(drive, fault, True)
        with pytest.raises(DeviceError, match=words) as told:
            await node.move_to(200.0)
        assert told.value.effects == "unknown"
        with pytest.raises(DeviceError, match=words) as again:
            await node.move_to(200.0)
        assert again.value.effects == "none"
        assert await node.trouble() == ""  # it may only flicker
        assert re.search(words, await node.trouble())
        setattr(drive, fault, False)
        await node.reset()
        assert await node.trouble() == ""
        await node.move_to(200.0)
        await node.close()

    run(body)


def test_a_home_that_is_not_found(drive: DriveOnSlcan) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        drive.no_switch = True
        with pytest.raises(DeviceError, match="has not found its home") as told:
            await node.home()
        assert told.value.effects == "unknown"
        assert await node.observe() == {"homed": False}
        drive.no_switch = False
        await node.reset()
        await node.home()
        await node.close()

    run(body)


def test_a_home_that_is_not_zero(drive: DriveOnSlcan) -> None:
    async def body() -> None:
        node = node_at(drive, axis=table(home={"method": 17, "position": 25.0}))
        await node.connect()
        await node.home()
        assert await node.observe() == {"homed": True, "position": 25.0}
        await node.move_to(60.0)
        assert drive.table.position(drive.stands) == 35.0
        await node.close()
        home = {"method": 17, "position": 25.0, "offset_is_position": True}
        other = node_at(drive, axis=table(home=home))  # which this drive does not do
        await other.connect()
        with pytest.raises(DeviceError, match="its home is at -25 mm, and should be at 25"):
            await other.home()
        await other.close()

    run(body)


def test_a_stop_is_a_quick_stop(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        await node.home()
        work = asyncio.create_task(node.move_to(500.0, speed=10.0))
        await until(lambda: "moves" in verbs(world))
        await node.stop()
        with pytest.raises(DeviceError, match="stopped in mid-motion") as told:
            await work
        assert told.value.effects == "unknown"
        assert drive.state is State.QUICK_STOP
        assert 0 < (await node.observe())["position"] < 500
        with pytest.raises(DeviceError, match="was stopped") as refused:
            await node.move_to(0.0)
        assert refused.value.effects == "none"
        await node.reset()
        assert drive.state is State.DISABLED
        await node.move_to(10.0)
        await node.close()

    run(body)


async def interrupt(node: Axis, world: World) -> str:
    """Begin a motion, and die in the middle of it; returns what the journal has."""
    handles: list[str] = []

    async def keep(handle: str) -> None:
        handles.append(handle)

    handle_keeper.set(keep)
    await node.connect()
    await node.home()
    work = asyncio.create_task(node.move_to(300.0))
    await until(lambda: "moves" in verbs(world))
    work.cancel()
    node.device._halted.set()  # type: ignore[union-attr]
    await node.device.run(lambda: None)  # type: ignore[union-attr]
    await node.close()
    return handles[-1]


def test_a_node_that_was_restarted_sees_the_end_and_starts_nothing(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        handle = await interrupt(node_at(drive), world)
        again = node_at(drive)
        await again.connect()
        await again.take_up("move_to", handle)
        assert (await again.observe())["position"] == 300.0
        await again.take_up("move_to", handle)  # it has ended meanwhile
        assert verbs(world).count("moves") == 1
        with pytest.raises(DeviceError, match="before the drive was told to start") as never:
            await again.take_up("move_to", "")
        assert never.value.effects == "none"
        with pytest.raises(OutcomeUnknown, match="not of this attempt"):
            await again.take_up("move_to", handle.replace("counts", "count"))
        await again.close()

    run(body)


def test_a_start_that_the_drive_never_heard_of(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        await node.home()
        goal = await node.device.prepare_move(250.0, 25.0)  # type: ignore[union-attr]
        with pytest.raises(OutcomeUnknown, match="stands still, and not where it was sent"):
            await node.device.await_end(goal, sure=False)  # type: ignore[union-attr]
        assert "moves" not in verbs(world)
        assert (await node.observe())["position"] == 0.0
        await node.close()

    run(body)


def test_a_drive_that_was_switched_off_meanwhile(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        handle = await interrupt(node_at(drive), world)
        drive.close()
        with power_on(DriveOnSlcan, "stage", world, pace=PACE) as other:
            again = node_at(other)
            await again.connect()
            with pytest.raises(OutcomeUnknown, match="lost its power meanwhile"):
                await again.take_up("move_to", handle)
            assert await again.observe() == {"homed": False}
            await again.close()

    run(body)


def test_unplugged(drive: DriveOnSlcan, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        await node.home()
        work = asyncio.create_task(node.move_to(500.0, speed=10.0))
        await until(lambda: "moves" in verbs(world))
        drive.end.unplug()
        with pytest.raises(DeviceError) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(NotConnected) as later:
            await node.move_to(0.0)
        assert later.value.effects == "none"
        await node.close()

    monkeypatch.setattr(driver, "PATIENCE_S", 0.5)
    run(body)


def test_a_drive_without_a_word_for_homed(drive: DriveOnSlcan, world: World) -> None:
    async def body() -> None:
        node = node_at(drive, axis={k: v for k, v in table().items() if k != "homed_bit"})
        await node.connect()
        assert await node.observe() == {"homed": False}
        await node.home()
        await node.move_to(50.0)
        assert await node.observe() == {"homed": True, "position": 50.0}
        await node.reset()  # without power it may be moved by hand, or be switched off
        assert await node.observe() == {"homed": False}
        await node.close()

    run(body)


def test_another_device_on_the_bus(drive: DriveOnSlcan, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        drive._node.data_store[profile.DEVICE_TYPE] = {0: (401).to_bytes(4, "little")}
        with pytest.raises(WrongDevice, match="a device of the profile 401 answers"):
            await node_at(drive).connect()
        monkeypatch.setattr(objects, "ANSWER_S", 0.2)
        with pytest.raises(NotConnected, match="does not identify itself"):
            await node_at(drive, node=7).connect()

    run(body)


def test_simulated(world: World) -> None:
    async def body() -> None:
        for wired in (False, True):
            node = Axis(setup_of("stage", world, PACE, wire=wired))
            await node.connect()
            await node.home()
            await node.move_to(40.0)
            assert await node.observe() == {"homed": True, "position": 40.0}
            await node.close()

    run(body)


# -- the drive, driven by others ---------------------------------------------------------------


@contextmanager
def canopens_own(device: DriveOnSlcan) -> Iterator[BaseNode402]:
    """canopen's implementation of the profile, at the same adapter."""
    network = canopen.Network()
    network.connect(interface="slcan", channel=device.address, sleep_after_open=0, timeout=0.02)
    node = BaseNode402(wire.NODE, wire._make_dictionary(canopen.objectdictionary))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 2.0
    node.TIMEOUT_SWITCH_STATE_FINAL = node.TIMEOUT_SWITCH_STATE_SINGLE = 5.0
    node.TIMEOUT_SWITCH_OP_MODE = 5.0
    try:
        yield node
    finally:
        network.disconnect()


def test_canopen_knows_its_states_homes_it_and_resets_its_faults(drive: DriveOnSlcan, world: World) -> None:
    with canopens_own(drive) as node:
        assert node.state == "SWITCH ON DISABLED"
        node.state = "OPERATION ENABLED"
        assert drive.state is State.ENABLED
        node.op_mode = "HOMING"
        assert node.op_mode == "HOMING"
        node.sdo[profile.HOMING_METHOD].raw = 17
        node.sdo[profile.HOMING_SPEEDS][profile.SWITCH_SPEED].raw = STAGE.raw_speed(25.0)
        assert node.homing(timeout=20)
        assert drive.homed
        assert node.sdo[profile.POSITION_NOW].raw == 0
        node.op_mode = "PROFILED POSITION"
        node.sdo[profile.TARGET].raw = STAGE.counts(60.0)
        node.sdo[profile.SPEED].raw = STAGE.raw_speed(50.0)
        node.controlword = profile.ENABLE  # canopen leaves the bit set that starts
        node.controlword = profile.ENABLE | profile.START
        assert node.statusword & profile.ACKNOWLEDGED
        while not node.statusword & profile.REACHED:
            pass
        node.controlword = profile.ENABLE
        assert node.sdo[profile.POSITION_NOW].raw == STAGE.counts(60.0)
        drive.fail(0x8611)
        assert node.is_faulted()
        assert node.emcy.wait(timeout=0.1) is None
        assert [emergency.code for emergency in node.emcy.log] == [0x8611]
        node.reset_from_fault()
        assert node.state == "OPERATION ENABLED"
    assert verbs(world) == ["homes", "stands at 0", "moves", "stands at 60"]


# -- its table ---------------------------------------------------------------------------------

WORKCELL = (
    "labos: 1\nname: lab\nmodules:\n  - name: stage\n    driver: axis\n    config:\n      channel: can0\n"
)


def write_workcell(**other: Any) -> str:
    lines = yaml.safe_dump({"axis": table(**other)}, sort_keys=False).splitlines()
    return WORKCELL + "".join(f"      {line}\n" for line in lines)


def test_what_an_axis_offers_follows_from_its_table() -> None:
    home = {"method": 35, "position": 10.0}
    text = write_workcell(
        unit="deg", minimum=-180.0, maximum=180.0, speed=30.0, highest_speed=90.0, home=home
    )
    (module,) = parse_workcell(text, descriptions(), "lab.yaml").workcell.modules
    about = find_description(module, {})
    assert about is not None
    move, home_ = about.action("move_to"), about.action("home")
    assert move is not None
    assert home_ is not None
    told = [(arg.name, arg.unit, arg.minimum, arg.maximum, arg.default) for arg in move.args]
    assert told == [("position", "deg", -180.0, 180.0, None), ("speed", "deg/s", 0.1, 90.0, 30.0)]
    assert Sets("module", "position", 10.0) in home_.effects
    own = Axis.for_config(module.config["config"]).describe()
    assert own.action("move_to") == move


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"maximum": -1.0}, "axis ends before it begins"),
        ({"home": {"position": 900.0}}, "home outside of its range"),
        ({"counts_per_turn": 2**30}, "are more counts than fit"),
        ({"speed": 900.0}, "faster than `highest_speed`"),
        ({"homed_bit": 3}, "3 is not one of the choices"),
        ({"gears": 3}, "The key 'gears' is not known here. Did you mean 'gear'"),
    ],
)
def test_slips_are_told_with_their_place(other: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput) as told:
        parse_workcell(write_workcell(**other), descriptions(), "lab.yaml")
    first = str(told.value).splitlines()[0]
    assert words in first
    assert re.match(r"lab\.yaml:\d+:\d+: ", first)


def test_counts_and_units() -> None:
    turned = AxisTable.model_validate(table(reversed=True, travel_per_turn=5.0))
    assert turned.counts(10.0) == -28672
    assert turned.position(-28672) == 10.0
    assert turned.raw_speed(25.0) == 71680


@pytest.mark.parametrize("status", [0x0000, 0x0250, 0x0231, 0x0233, 0x0637, 0x0017, 0x001F, 0x0218])
def test_every_state_has_its_statuswords(status: int) -> None:
    assert profile.state_of(status).value[1] == status & profile.state_of(status).value[0]


def test_codes_that_are_not_in_the_profile_have_words_too() -> None:
    assert profile.meaning_of(0x2399)[0] == "its current is wrong"
    assert profile.meaning_of(0xFF07)[0] == "an error of its maker's own"


# -- the page ----------------------------------------------------------------------------------


def test_the_page_is_about_this_axis(drive: DriveOnSlcan, tmp_path: Path) -> None:
    (yaml_,) = [block.text for block in blocks(PAGE.read_text()) if block.language == "yaml"]
    (tmp_path / "lab.yaml").write_text(f"labos: 1\nname: lab\n{yaml_}")
    (module,) = load_workcell(tmp_path / "lab.yaml", descriptions()).workcell.modules

    async def body() -> None:
        node = node_at(drive, axis=module.config["config"]["axis"])
        await node.connect()
        await node.home()
        await node.move_to(80.0)
        assert (await node.observe())["position"] == 80.0
        await node.close()

    run(body)


def test_the_page_names_every_key() -> None:
    said = set(re.findall(r"`(\w+)`", PAGE.read_text()))
    assert {*AxisTable.model_fields, *AxisTable.model_fields["home"].annotation.model_fields} <= said  # type: ignore[union-attr]


def test_a_drive_that_holds_a_speed_does_not_rest(drive: DriveOnSlcan, world: World) -> None:
    """In such a mode "target reached" says that the speed is reached."""

    async def body() -> None:
        node = node_at(drive)
        await node.connect()
        await node.home()
        drive._mode, drive._takes_s, drive._since_s = 3, 1000.0, drive.now_s()
        drive._goal = drive.stands + 1e7
        assert drive.compose_status() & profile.REACHED
        assert not await node.is_idle()
        with pytest.raises(DeviceError, match="moves") as told:
            await node.move_to(50.0)
        assert told.value.effects == "none"
        drive._goal = None
        assert await node.is_idle()
        await node.close()

    run(body)
    assert "moves" not in verbs(world)
