"""Protocols in YAML, and what the robot makes of them: by Opentrons' own software where it is there."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError
from labos.node import World
from labos_drivers.ot2 import OT2, protocol
from labos_drivers.ot2 import driver as ot2_driver
from labos_drivers.ot2.translate import translate
from labos_drivers.ot2.wire import OT2OnWire
from tests.drivers.wires import at_port, power_on, run
from tests.support.foreign import opentrons_simulate

PROTOCOLS = Path(__file__).parents[2] / "specs" / "workflows" / "protocols"
COMBINED, PCR = PROTOCOLS / "combined_protocol.yaml", PROTOCOLS / "pcr_prep.yaml"
VALUES: dict[str, Any] = {
    "destination_wells": ["A1", "A2"],
    **{f"color_{color}_volumes": [20.0, 0.0 if color == "B" else 350.0] for color in "ABCD"},
}
PLATE = "equipment:\n  - {name: plate, location: '2', alias: dest}\n  - {name: p300, mount: left}\n"


def simulate(content: bytes, folder: Path) -> list[str]:
    """What Opentrons' own software does with a protocol."""
    path = folder / "protocol.py"
    path.write_bytes(protocol.with_values(content, VALUES))
    command = [opentrons_simulate(), path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr
    return [line.strip() for line in done.stdout.splitlines()]


def test_the_robots_own_software_runs_the_colors(tmp_path: Path) -> None:
    lines = simulate(translate(COMBINED.name, COMBINED.read_bytes()), tmp_path)
    aspirated = [line for line in lines if line.startswith("Aspirating") and "Reservoir" in line]
    # A and C go into both wells, the second in two strokes; of B nothing goes into the second.
    assert [line.split()[1] for line in aspirated] == [
        "20.0",
        "175.0",
        "175.0",
        "20.0",
        "20.0",
        "175.0",
        "175.0",
    ]
    assert sum(line.startswith("Picking up tip") for line in lines) == 2  # as many as there are wells


@pytest.mark.slow
def test_the_robots_own_software_prepares_a_pcr(tmp_path: Path) -> None:
    # Its release for Python 3.11 finds no definition of a module of this generation.
    text = PCR.read_text().replace(", module: temperature module gen2", "")
    lines = simulate(translate(PCR.name, text.encode()), tmp_path)
    assert sum(line.startswith("Picking up tip") for line in lines) == 3  # columns
    assert sum(line.startswith("Dispensing 4.0") for line in lines) == 24


@pytest.mark.slow
@pytest.mark.skipif(not os.environ.get("LABOS_CORPUS"), reason="the public workcells are not here")
def test_the_robots_own_software_runs_a_public_protocol(tmp_path: Path) -> None:
    (path,) = Path(os.environ["LABOS_CORPUS"]).glob("**/color_picker_app/**/combined_protocol.yaml")
    lines = simulate(translate(path.name, path.read_bytes()), tmp_path)
    assert sum(line.startswith("Picking up tip") for line in lines) == 4


def test_a_protocol_in_yaml_goes_to_the_robot(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ot2_driver, "POLL_S", 0.01)
    world.stock("ot2.deck2", "plate")

    async def body(robot: OT2OnWire) -> None:
        node = at_port(OT2, "ot2", robot.address, key="url")
        await node.connect()
        await node.run_protocol(str(COMBINED), color_A_volumes=[1.0], destination_wells=["A1"])
        ((name, content),) = robot._files.values()
        assert name == "combined_protocol.py"
        assert b"metadata = {'apiLevel': '2.12'" in content
        await node.close()

    with power_on(OT2OnWire, "ot2", world, pace=4000, simulate="") as robot:
        run(lambda: body(robot))
    assert [m.facts["volumes"] for m in world.motions("pipette")] == [{"color_A": [1.0]}]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("commands: [\n", "not YAML"),
        ("- 1\n", "not a protocol"),
        (PLATE, "its commands are not a list"),
        (PLATE + "commands:\n  - {command: shake}\n", "command 1: 'shake' is not known"),
        (PLATE + "commands:\n  - {source: 'a:A1', volume: 3}\n", "has no destination"),
        (
            PLATE + "commands:\n  - {source: 'a:A1', destination: 'b:A1', volume: 3, touch_tip: true}\n",
            "touch_tip is not translated",
        ),
        (
            PLATE + "commands:\n  - {source: 'a:A1', destination: 'b:A1', volume: 3, drop_tip: [true]}\n",
            "a list for drop_tip",
        ),
        ("equipment:\n  - {name: x, mount: left, speed: 3}\ncommands:\n  - {replace_tip: true}\n", "speed"),
    ],
)
def test_what_would_be_passed_over_is_refused(text: str, why: str) -> None:
    with pytest.raises(DeviceError, match=why) as told:
        translate("mix.yaml", text.encode())
    assert told.value.effects == "none"
