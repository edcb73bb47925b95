"""Protocols that Opentrons' own software runs behind the emulated robot server: what it does is done on the
deck, and what goes wrong in it is told by the driver and the lab."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError
from labos.node import World
from labos_drivers.ot2 import driver as ot2_driver
from labos_drivers.ot2 import protocol
from labos_drivers.ot2.software import VARIABLE, ProtocolOutput, parse_error
from labos_drivers.ot2.wire import OT2OnWire
from tests.drivers.test_ot2_wire import drive
from tests.drivers.wires import power_on, run, setup_of, until
from tests.support.foreign import opentrons_simulate
from tests.support.lab_process import Up, labos

PROTOCOLS = Path(__file__).parents[2] / "specs" / "workflows" / "protocols"
COLORS = PROTOCOLS / "combined_protocol.yaml"
MIX = """\
metadata = {"apiLevel": "2.12"}


def run(protocol):
    plate = protocol.load_labware("corning_96_wellplate_360ul_flat", 2)
    water = protocol.load_labware("nest_12_reservoir_15ml", 3)
    tips = protocol.load_labware("opentrons_96_tiprack_300ul", 1)
    pipette = protocol.load_instrument("p300_single_gen2", "left", tip_racks=[tips])
    for well, volume in zip(LABOS["destination_wells"], LABOS["water_volumes"]):
        pipette.transfer(volume, water["A1"], plate[well], mix_after=(2, 20))
"""
NO_TIP = MIX.replace("pipette.transfer(volume, water", "pipette.aspirate(volume, water").replace(
    ", plate[well], mix_after=(2, 20))", ")"
)
WELLS: dict[str, Any] = {"water_volumes": [50.0, 30.0], "destination_wells": ["A1", "H12"]}


@pytest.fixture
def robot(world: World, monkeypatch: pytest.MonkeyPatch) -> Iterator[OT2OnWire]:
    monkeypatch.setattr(ot2_driver, "POLL_S", 0.05)
    with power_on(OT2OnWire, "ot2", world, pace=4000, simulate=opentrons_simulate()) as device:
        yield device


def write_protocol(folder: Path, text: str) -> str:
    path = folder / "mix.py"
    path.write_text(text)
    return str(path)


@pytest.mark.full
def test_what_the_software_does_is_done_on_the_deck(robot: OT2OnWire, world: World, tmp_path: Path) -> None:
    (plate,) = world.stock("ot2.deck2", "plate")
    world.stock("ot2.deck5", "plate")  # which the protocol does not know

    async def body() -> None:
        async with drive(robot) as node:
            assert (await node.run_protocol(write_protocol(tmp_path, MIX), **WELLS))["status"] == "succeeded"

    run(body)
    (motion,) = world.motions("pipette")
    assert motion.plate == plate
    assert motion.facts["received"] == {"A1": 50.0, "H12": 30.0}
    assert motion.facts["tips"] == 2
    assert not robot._running


@pytest.mark.full
def test_the_colors_are_run_for_real(robot: OT2OnWire, world: World) -> None:
    world.stock("ot2.deck2", "plate")

    async def body() -> None:
        async with drive(robot) as node:
            await node.run_protocol(
                str(COLORS),
                color_A_volumes=[20.0, 350.0],
                color_B_volumes=[20.0, 0.0],
                color_C_volumes=[20.0, 350.0],
                color_D_volumes=[20.0, 350.0],  # of which the protocol makes no use
                destination_wells=["A1", "A2"],
            )

    run(body)
    (motion,) = world.motions("pipette")
    assert motion.facts["received"] == {"A1": 60.0, "A2": 700.0}


@pytest.mark.full
def test_less_than_a_pipette_takes_is_refused_before_anything_moves(robot: OT2OnWire, world: World) -> None:
    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match=r"0.5 uL are less than any pipette here takes") as told:
                await node.run_protocol(str(COLORS), color_A_volumes=[0.5], destination_wells=["A1"])
            assert told.value.effects == "none"

    run(body)
    assert world.motions("pipette") == []


@pytest.mark.slow
def test_a_protocol_that_fails_there_is_refused_with_its_error(
    robot: OT2OnWire, world: World, tmp_path: Path
) -> None:
    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match=r"UnexpectedTipRemovalError 3005: line 10: Cannot") as told:
                await node.run_protocol(write_protocol(tmp_path, NO_TIP), **WELLS)
            assert (told.value.effects, told.value.remedy) == ("none", "Correct the protocol.")

    run(body)
    assert robot.runs == {}
    assert world.motions("pipette") == []


@pytest.mark.full
def test_one_that_fails_only_when_it_is_played_fails_the_run(
    robot: OT2OnWire, world: World, tmp_path: Path
) -> None:
    """What a protocol finds on the robot may be gone when it is played."""
    world.stock("ot2.deck2", "plate")
    once = tmp_path / "once"
    once.touch()
    text = MIX.replace("    plate =", f"    __import__('os').remove({str(once)!r})\n    plate =")

    async def body() -> None:
        async with drive(robot) as node:
            with pytest.raises(DeviceError, match=r"failed: FileNotFoundError 4000: line 5: .*once") as told:
                await node.run_protocol(write_protocol(tmp_path, text), **WELLS)
            assert told.value.effects == "unknown"
            assert "Check the deck" in told.value.remedy
            assert await node.is_idle()

    run(body)
    assert world.motions("pipette") == []


@pytest.mark.full
def test_a_stop_ends_the_software_too(robot: OT2OnWire, world: World, tmp_path: Path) -> None:
    world.stock("ot2.deck2", "plate")
    turn = tmp_path / "turn"
    endless = f"    import os, time\n    while os.path.exists({str(turn)!r}): time.sleep(0.01)\n    plate ="

    async def body() -> None:
        async with drive(robot) as node:
            work = asyncio.create_task(
                node.run_protocol(write_protocol(tmp_path, MIX.replace("    plate =", endless)), **WELLS)
            )
            await until(lambda: bool(robot.runs), 100)
            turn.touch()
            await until(lambda: robot._played is not None, 100)
            process = robot._played._process
            await node.stop()
            with pytest.raises(DeviceError, match="stopped"):
                await work
            assert process.poll() is not None

    run(body)
    assert world.motions("pipette") == []


@pytest.mark.full
@pytest.mark.timeout(240)
def test_a_lab_is_told_why_the_robots_software_refuses(tmp_path: Path) -> None:
    """A kernel, a node's process, the driver, HTTP, the emulated robot, Opentrons' software."""
    (tmp_path / "rpl.yaml").write_text("labos: 1\nname: rpl\nmodules:\n  - {name: ot2, model: ot2}\n")
    for name, text in (("good", MIX), ("bad", NO_TIP)):
        (tmp_path / f"{name}.py").write_text(text)
        (tmp_path / f"{name}.yaml").write_text(
            f"labos: 1\nname: {name}\nsteps:\n"
            f"  - {{name: Mix, module: ot2, action: run_protocol, args: {{config_path: {name}.py, "
            "water_volumes: [50.0, 30.0], destination_wells: [A1, H12]}}\n"
        )
    up = Up(tmp_path / "lab", "--simulate", "--wire", "--speed", "1000")
    up.environment = {VARIABLE: opentrons_simulate()}
    try:
        up.start(str(tmp_path / "rpl.yaml"))
        at = ("--home", str(up.home))
        done = labos("run", str(tmp_path / "good.yaml"), "--place", "ot2.deck2=plate96", *at)
        assert done.returncode == 0, done.stdout + done.stderr
        refused = labos("run", str(tmp_path / "bad.yaml"), *at)
        assert refused.returncode != 0
        why = (
            "UnexpectedTipRemovalError 3005: line 10: Cannot perform PREPARE_ASPIRATE without a tip attached"
        )
        assert f"failed (effects: none): ot2: the robot refuses the protocol: {why}" in refused.stdout
        assert "Correct the protocol" in refused.stdout
        (motion,) = up.motions("pipette")
        assert motion.facts["received"] == {"A1": 50.0, "H12": 30.0}
        assert up.interrupt() == 0
        assert up.disagreements() == []
    finally:
        up.clean_up()


def test_what_it_prints_is_read() -> None:
    ran = ProtocolOutput(
        log=(
            "Transferring 50.0 from A1 of a trough on 3 to A1 of a plate on slot 2",
            "\tPicking up tip from A1 of tips on 1",
            "\tAspirating 50.0 uL from A1 of a trough on 3 at 94.0 uL/sec",
            "\tDispensing 50.0 uL into A1 of a plate on slot 2 at 94.0 uL/sec",
            "\t\tAspirating 20.0 uL from A1 of a plate on slot 2 at 94.0 uL/sec",
            "\t\tDispensing 20.0 uL into A1 of a plate on slot 2 at 94.0 uL/sec",
        )
    )
    assert ran.sum_changes() == {3: {"A1": -50.0}, 2: {"A1": 50.0}}
    assert ran.tips == 1


@pytest.mark.parametrize(
    ("printed", "told"),
    [
        (
            'a warning\nTraceback\n  File "x.py", line 3\n    run()\n    ^^^\n'
            "opentrons.protocols.execution.errors.ExceptionInProtocolError: "
            "TipError [line 8]: Error 3005 NO_TIP (TipError): one\ntwo: x\n",
            "TipError 3005: line 8: one two: x",
        ),
        (
            "nothing found\nTipError [line 2]: Error 4000 GENERAL (TipError): no tip",
            "TipError 4000: line 2: no tip",
        ),
        (
            '  File "x.py", line 1\n    def run(:\n            ^\n\nSyntaxError: bad\n',
            "SyntaxError 4000: bad",
        ),
        ("a.b.KeyError: ", "KeyError 4000:"),
        ("Killed", "UnexpectedProtocolError 4000: Killed"),
        ("", "UnexpectedProtocolError 4000: it ended with 3"),
    ],
)
def test_the_error_is_what_it_says_last(printed: str, told: str) -> None:
    assert protocol.find_innermost([parse_error(printed, 3)]) == told


def test_a_program_that_is_not_there_is_told(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "/nowhere/opentrons_simulate")
    with pytest.raises(DeviceError, match="no program /nowhere/opentrons_simulate") as told:
        OT2OnWire(setup_of("ot2", world))
    assert VARIABLE in told.value.remedy
