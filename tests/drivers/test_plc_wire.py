"""The PLC's driver and the simulated PLC of the hatch, over the network and over a serial line."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from labos.bootstrap import descriptions
from labos.errors import BadInput, DeviceError, NotConnected, OutcomeUnknown
from labos.node import Node, World
from labos.node.node import current_action, handle_keeper
from labos.spec import load_workcell
from labos.spec.source import read
from labos.torture import torture
from labos_drivers.plc import driver
from labos_drivers.plc.interface import HATCH, Plc
from labos_drivers.plc.torture import close_door, open_door
from labos_drivers.plc.wire import Hatch, HatchOnTcp
from tests.docs.markdown import ROOT, blocks
from tests.drivers.plc_rtu import HatchOnLine
from tests.drivers.wires import power_on, run, setup_of, until

PAGE = ROOT / "docs" / "drivers" / "plc.md"
PACE = 40.0


@pytest.fixture(params=[HatchOnTcp, HatchOnLine])
def hatch(request: pytest.FixtureRequest, world: World) -> Iterator[Hatch]:
    with power_on(request.param, "hatch", world, pace=PACE) as device:
        yield device


@pytest.fixture
def on_tcp(world: World) -> Iterator[Hatch]:
    with power_on(HatchOnTcp, "hatch", world, pace=PACE) as device:
        yield device


def node_at(device: Hatch, **config: Any) -> Plc:
    # A pseudo-terminal knows no parity.
    told = {"address": device.address, "parity": "N", "late_s": 0.1, **config}
    node = Plc.for_config(told)(setup_of("hatch", None, 1.0, config=told))
    assert isinstance(node, Plc)
    return node


def table() -> dict[str, Any]:
    """The mapping as a table that a test may change."""
    told: dict[str, Any] = yaml.safe_load(HATCH.read_text("utf-8"))
    return told


async def do(node: Node, action: str, **args: Any) -> Any:
    return await node.methods()[action](**args)


def verbs(world: World) -> list[str]:
    return [motion.verb for motion in world.motions() if motion.device == "hatch"]


def test_opens_and_closes_and_tells_what_it_sees(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        world.stock("hatch.nest", "plate96")
        await until(lambda: hatch.plate)
        await do(node, "close")
        assert (await node.observe())["door"] == "closed"
        assert world.is_shut("hatch.nest")
        await do(node, "open", speed=100.0)
        assert await node.observe() == {"door": "open", "labware": {"nest": True}}
        assert await do(node, "read_temperature") == 21.5
        assert verbs(world) == ["closes", "shut", "locks", "opens", "open"]
        assert await node.is_idle()
        await node.close()

    run(body)


def test_what_cannot_be_done_moves_nothing(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        hatch.curtain = True
        await until(lambda: hatch._shown[0][5])
        with pytest.raises(
            DeviceError, match=r"somebody reaches into the light curtain\. Step back."
        ) as curtain:
            await do(node, "close")
        with pytest.raises(DeviceError, match="speed cannot be 500 mm/s") as fast:
            await do(node, "open", speed=500.0)
        hatch.emergency = True
        await until(lambda: hatch._shown[0][4])
        with pytest.raises(DeviceError, match=r"the emergency stop is pressed\. Release it") as pressed:
            await do(node, "open")
        assert {told.value.effects for told in (curtain, fast, pressed)} == {"none"}
        assert verbs(world) == []
        await node.close()

    run(body)


def test_a_jam_is_an_error_that_stays_until_a_reset(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        hatch.jammed = True
        with pytest.raises(DeviceError, match=r"the door is jammed \(fault 1\). Free the door") as jam:
            await do(node, "close")
        assert jam.value.effects == "unknown"
        assert (await node.observe())["door"] == "between"
        with pytest.raises(DeviceError, match="jammed") as again:
            await do(node, "close")
        assert again.value.effects == "none"
        hatch.jammed = False
        await node.reset()
        await do(node, "close")
        assert (await node.observe())["door"] == "closed"
        await node.close()

    run(body)


def test_a_stop_ends_a_motion(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        work = asyncio.create_task(do(node, "close", speed=10.0))
        await until(lambda: verbs(world)[:1] == ["closes"])
        await node.stop()
        with pytest.raises(DeviceError, match="stopped in mid-motion") as stopped:
            await work
        assert stopped.value.effects == "unknown"
        await until(lambda: hatch.fault == 3)
        with pytest.raises(DeviceError, match=r"was stopped\. Reset it"):
            await do(node, "open")
        await node.reset()
        await do(node, "open")
        await node.close()

    run(body)


def test_a_stop_before_the_start_leaves_nothing_to_stop(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        device: Any = node.device
        begun = await device.prepare("close", {"speed": 50.0}, "a1")
        await node.stop()
        with pytest.raises(DeviceError, match=r"was stopped\. Reset it") as told:
            await device.start("close", begun)
        assert told.value.effects == "none"
        assert verbs(world) == []
        await node.reset()
        await do(node, "close")
        await node.close()

    run(body)


def test_errors_that_stay_are_trouble_and_end_by_themselves(on_tcp: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(on_tcp)
        await node.connect()
        on_tcp.emergency = True
        await until(lambda: on_tcp._shown[0][4])
        assert await node.trouble() == ""  # it may only flicker
        assert "the emergency stop is pressed" in await node.trouble()
        on_tcp.emergency = False
        await node.reset()
        assert await node.trouble() == ""
        await node.close()

    run(body)


async def interrupt(node: Plc, device: Hatch, world: World, began: str) -> str:
    """Begin to close, and die in mid-action; returns what the journal has."""
    handles: list[str] = []

    async def keep(handle: str) -> None:
        handles.append(handle)

    await node.connect()
    handle_keeper.set(keep)
    current_action.set("a1")
    work = asyncio.create_task(do(node, "close"))
    await until(lambda: began in verbs(world))
    work.cancel()
    node.device._halted.set()  # type: ignore[union-attr]
    await node.device.run(lambda: None)  # type: ignore[union-attr]
    await node.close()
    return handles[-1]


def test_a_node_that_was_restarted_sees_the_end_and_writes_nothing(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        handle = await interrupt(node_at(hatch), hatch, world, "closes")
        again = node_at(hatch)
        await again.connect()
        await again.take_up("close", handle)
        assert (await again.observe())["door"] == "closed"
        assert verbs(world).count("closes") == 1
        # It has ended meanwhile; then it is asked once more.
        await again.take_up("close", handle)
        assert verbs(world).count("closes") == 1
        with pytest.raises(DeviceError, match="before it passed the action on") as never:
            await again.take_up("close", "")
        assert never.value.effects == "none"
        await again.close()

    run(body)


def test_a_plc_that_was_switched_off_meanwhile_knows_nothing(
    on_tcp: Hatch, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body() -> None:
        handle = await interrupt(node_at(on_tcp), on_tcp, world, "closes")
        on_tcp.close()
        with power_on(HatchOnTcp, "hatch", world, pace=PACE) as other:
            again = node_at(other)
            await again.connect()
            with pytest.raises(OutcomeUnknown, match="restarted meanwhile"):
                await again.take_up("close", handle)
            without = {key: value for key, value in table().items() if key != "boot"}
            blind = node_at(other, plc=without)
            await blind.connect()
            with pytest.raises(OutcomeUnknown, match="does not show that it has accepted"):
                await blind.take_up("close", handle.replace('"boot":', '"was":'))
            await again.close()
            await blind.close()
        assert verbs(world).count("closes") == 1

    monkeypatch.setattr(driver, "TAKE_S", 0.3)
    run(body)


def test_without_a_handshake_nobody_knows(on_tcp: Hatch, world: World) -> None:
    async def body() -> None:
        told = table()
        del told["handshake"]
        for action in ("open", "close"):
            told["actions"][action]["start"] = {"point": "number", "value": 7}
        del told["boot"]
        node = node_at(on_tcp, plc=told)
        handle = await interrupt(node, on_tcp, world, "closes")
        again = node_at(on_tcp, plc=told)
        await again.connect()
        with pytest.raises(OutcomeUnknown, match="the PLC does not distinguish this attempt from others"):
            await again.take_up("close", handle)
        await until(lambda: on_tcp._shown[0][1])
        assert (await again.observe())["door"] == "closed"
        await again.close()

    run(body)


def test_what_a_plc_does_not_take_is_withdrawn(
    hatch: Hatch, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        hatch.local = True
        with pytest.raises(DeviceError, match="has not accepted close, which was withdrawn") as told:
            await do(node, "close")
        assert told.value.effects == "none"
        hatch.local = False
        await do(node, "close")
        assert verbs(world).count("closes") == 1
        await node.close()

    monkeypatch.setattr(driver, "TAKE_S", 0.2)
    run(body)


def test_a_reset_starts_nothing_that_was_left_over(hatch: Hatch, world: World) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        device: Any = node.device
        begun = await device.prepare("close", {"speed": 50.0}, "a1")
        hatch.emergency = True
        await until(lambda: hatch._shown[0][4])
        await device.start("close", begun)
        with pytest.raises(DeviceError, match="the emergency stop is pressed"):
            await device.await_end("close", begun, sure=True)
        hatch.emergency = False
        await node.reset()
        assert verbs(world) == []
        await do(node, "close")
        assert verbs(world).count("closes") == 1
        await node.close()

    run(body)


def test_unplugged(hatch: Hatch, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        node = node_at(hatch)
        await node.connect()
        work = asyncio.create_task(do(node, "close", speed=10.0))
        await until(lambda: "closes" in verbs(world))
        hatch.close()
        with pytest.raises(DeviceError) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(DeviceError) as later:
            await do(node, "open")
        assert later.value.effects == "none"
        await node.close()

    monkeypatch.setattr(driver, "PATIENCE_S", 0.5)
    monkeypatch.setattr("labos_drivers.plc.points.ANSWER_S", 0.3)
    run(body)


def test_a_point_that_is_not_there(on_tcp: Hatch) -> None:
    async def body() -> None:
        told = table()
        told["points"]["fault"] = {"input": 900}
        node = node_at(on_tcp, plc=told)
        with pytest.raises(DeviceError, match=r"no such address .* The request was for fault"):
            await node.connect()
        with pytest.raises(NotConnected):
            await Plc(setup_of("hatch", None, 1.0, config={"address": "127.0.0.1:1"})).connect()

    run(body)


def test_a_value_is_written_and_waited_for(on_tcp: Hatch) -> None:
    async def body() -> None:
        told = {key: value for key, value in table().items() if key != "handshake"}
        told["actions"] = {
            "set_speed": {
                "description": "Set the speed.",
                "start": {"point": "speed", "value": "{mm_s}"},
                "done": {"point": "speed", "near": "{mm_s}", "within": 0.05},
                "result": {"speed": "speed", "fault": "fault"},
            }
        }
        node = node_at(on_tcp, plc=told)
        (spec,) = [action for action in node.describe().actions if action.name == "set_speed"]
        assert [(arg.name, arg.unit, arg.required) for arg in spec.args] == [("mm_s", "mm/s", True)]
        await node.connect()
        assert await do(node, "set_speed", mm_s=72.5) == {"speed": 72.5, "fault": 0}
        await node.close()

    run(body)


def test_simulated(world: World) -> None:
    async def body() -> None:
        for wire in (False, True):
            node = Plc(setup_of("hatch", world, PACE, wire=wire))
            await node.connect()
            await do(node, "close")
            assert (await node.observe())["door"] == "closed"
            assert world.is_shut("hatch.nest")
            await do(node, "open")
            assert not world.is_shut("hatch.nest")
            await node.close()

    run(body)


@pytest.mark.full
@pytest.mark.timeout(600)
def test_torture_over_a_serial_line() -> None:
    report = asyncio.run(torture(str(Path(__file__).with_name("plc_rtu.py")), motion_s=0.6))
    assert (report.badge, [f for f in report.findings if f.verdict == "failed"]) == ("gold", [])


# -- the page ----------------------------------------------------------------------------------


def list_blocks(language: str) -> list[str]:
    return [block.text for block in blocks(PAGE.read_text()) if block.language == language]


def test_the_page_is_about_this_plc(on_tcp: Hatch, world: World, tmp_path: Path) -> None:
    workcell, door = list_blocks("yaml")
    (tmp_path / "lab.yaml").write_text(f"labos: 1\nname: lab\n{workcell}")
    (tmp_path / "door.yaml").write_text(door)
    cell = load_workcell(tmp_path / "lab.yaml", descriptions())
    config = cell.workcell.modules[0].config["config"]

    async def body() -> None:
        node = node_at(on_tcp, plc=config["plc"])
        await node.connect()
        await do(node, "close")
        assert (await node.observe())["door"] == "closed"
        open_door(on_tcp, world)
        on_tcp.jammed = True
        with pytest.raises(DeviceError, match="the door is jammed"):
            await do(node, "close")
        on_tcp.jammed = False
        await node.reset()
        close_door(on_tcp, world)
        await do(node, "open", speed=80.0)
        assert (await node.observe())["door"] == "open"
        await node.close()

    run(body)


def test_the_page_shows_what_is_said_of_a_slip(tmp_path: Path) -> None:
    door = list_blocks("yaml")[1]
    (tmp_path / "door.yaml").write_text(door.replace("done: is_open", "done: is_opened"))
    (tmp_path / "lab.yaml").write_text(f"labos: 1\nname: lab\n{list_blocks('yaml')[0]}")
    with pytest.raises(BadInput) as told:
        load_workcell(tmp_path / "lab.yaml", descriptions())
    said = str(told.value).splitlines()[0].removeprefix(f"{tmp_path}/")
    assert said in [line for text in list_blocks("text") for line in text.splitlines()]


def test_the_page_names_every_key() -> None:
    keys = set(read(HATCH).data) - {"description"}
    first_cells = re.findall(r"^\| (.*?) \|", PAGE.read_text(), re.MULTILINE)
    assert keys <= {key for cell in first_cells for key in re.findall(r"`(\w+)`", cell)}
