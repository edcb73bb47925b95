"""A lab on real processes with modules whose drivers are told by a table: a PLC and an axis, each at the far
end of a real wire."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.node import World
from labos_drivers.axis.wire import DriveOnSlcan
from labos_drivers.plc.interface import HATCH
from labos_drivers.plc.wire import HatchOnTcp
from tests.drivers.wires import power_on
from tests.support.lab_process import Up, labos, until

CELL = """
labos: 1
name: wall
modules:
  - name: hatch
    driver: plc
    config: {{address: "{hatch}", plc: hatch.yaml}}
  - name: stage
    driver: axis
    config:
      interface: slcan
      channel: {stage}
      bus: {{sleep_after_open: 0}}
      axis:
        counts_per_turn: 4096
        gear: 3.5
        travel_per_turn: 10.0
        minimum: 0.0
        maximum: 200.0
        speed: 50.0
        acceleration: 500.0
        homed_bit: 15
"""

FLOW = """
labos: 1
name: behind the door
steps:
  - {name: home, module: stage, action: home}
  - {name: there, module: stage, action: move_to, args: {position: 150.0}}
  - {name: shut, module: hatch, action: close, args: {speed: 80.0}}
  - {name: measure, module: hatch, action: read_temperature}
  - {name: open, module: hatch, action: open}
"""

pytestmark = [pytest.mark.timeout(180), pytest.mark.full]


@pytest.fixture
def world() -> Iterator[World]:
    world = World()
    yield world
    world.close()


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--real", "--declare")
    yield up
    up.clean_up()


def verbs(world: World) -> list[str]:
    return [motion.verb for motion in world.motions()]


def test_a_workflow_over_both_and_a_node_that_is_killed(lab: Up, world: World, tmp_path: Path) -> None:
    cell, flow = tmp_path / "wall.yaml", tmp_path / "flow.yaml"
    (tmp_path / "hatch.yaml").write_text(HATCH.read_text())
    flow.write_text(FLOW)
    with (
        power_on(HatchOnTcp, "hatch", world, pace=20) as hatch,
        power_on(DriveOnSlcan, "stage", world, pace=20) as stage,
    ):
        cell.write_text(CELL.format(hatch=hatch.address, stage=stage.address))
        assert labos("validate", str(cell)).returncode == 0
        far = labos("validate", str(_with(flow, "150.0", "250.0")), "--workcell", str(cell))
        assert (far.returncode, "position" in far.stdout + far.stderr) == (1, True)
        lab.start(str(cell))
        # The lab keeps the table: its nodes do not need the file.
        (tmp_path / "hatch.yaml").unlink()
        with lab.client() as client:
            assert client.wait(client.submit(flow, user="ada"), timeout_s=60).status == "completed"
            assert verbs(world) == [
                *("homes", "stands at 0", "moves", "stands at 150"),
                *("closes", "shut", "locks", "opens", "open"),
            ]
            slow = _with(flow, "speed: 80.0", "speed: 10.0")
            run = client.submit(slow, user="ada")
            until(lambda: verbs(world).count("closes") == 2, "it closes again")
            (pid,) = [
                json.loads(note.read_text())["pid"]
                for note in (lab.home / "nodes").glob("*.json")
                if "hatch" in note.name
            ]
            os.kill(pid, signal.SIGKILL)
            assert client.wait(run, timeout_s=90).status == "completed"
        assert verbs(world).count("closes") == 2
        assert lab.interrupt() == 0, lab.read_log()
    assert "intervention.requested" not in lab.types()
    assert "action.unknown" not in lab.types()


def _with(flow: Path, good: str, other: str) -> Path:
    text = flow.read_text()
    assert good in text
    changed = flow.with_name(f"{len(other)}-{flow.name}")
    changed.write_text(text.replace(good, other))
    return changed
