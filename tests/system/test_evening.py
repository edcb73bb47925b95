"""An evening as a new user: another lab's files, one run, one rescue, one file fetched."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.lab_process import Up, labos, until

WORKCELL = """\
name: corner
modules:
  - {name: sciclops, model: sciclops, interface: wei_ros_node, config: {ros_node: /std_ns/SciclopsNode}}
  - {name: pf400, model: pf400, interface: wei_ros_node, config: {ros_node: /std_ns/pf400Node}}
  - {name: sealer, model: sealer, interface: wei_ros_node, config: {ros_node: /std_ns/SealerNode}}
  - {name: camera_module, interface: wei_ros_camera, config: {ros_node: /std_ns/camera_module}}
locations:
  pf400:
    sciclops.exchange: [262.55, 20.608, 119.29, 662.57, 0.0, 574.367]
    sealer.default: [231.788, -27.154, 313.011, 342.317, 0.0, 683.702]
    camera_module.plate_station: [90.597, 26.416, 66.422, 714.811, 81.916, 995.074]
"""

FLOW = """\
metadata: {name: Look at a plate, author: Somebody}
workcell: /home/rpl/workspace/corner.yaml
modules: [{name: sciclops}, {name: pf400}, {name: sealer}, {name: camera_module}]
flowdef:
  - {name: Fetch, module: sciclops, command: get_plate, args: {pos: tower2}, checks: null, comment: Stage it}
  - name: To sealer
    module: pf400
    command: transfer
    args:
      source: sciclops.positions.exchange
      target: sealer.positions.default
      source_plate_rotation: narrow
      target_plate_rotation: narrow
  - name: To camera
    module: pf400
    command: transfer
    args:
      source: sealer.positions.default
      target: camera_module.positions.plate_station
      source_plate_rotation: narrow
      target_plate_rotation: narrow
  - {name: Picture, module: camera_module, command: take_picture, args: {file_name: final_image.jpg}}
"""


@pytest.fixture
def evening(tmp_path: Path) -> Iterator[Up]:
    foreign = tmp_path / "foreign"
    (foreign / "workflows").mkdir(parents=True)
    (foreign / "corner.yaml").write_text(WORKCELL)
    (foreign / "workflows" / "look.yaml").write_text(FLOW)
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "10")
    yield lab
    lab.clean_up()


def run_command(*argv: str) -> str:
    done = labos(*argv)
    assert done.returncode == 0, done.stderr
    return done.stdout


def module(lab: Up, name: str) -> dict[str, Any]:
    with lab.client() as client:
        known = client.state(waits=False)["modules"]
    return next(found for found in known if found["name"] == f"corner/{name}")


def is_carrying(lab: Up) -> int:
    """The process of the arm's node while the arm moves; 0 while it does not."""
    arm = module(lab, "pf400")
    moves = any(action["status"] == "accepted" for action in arm["doing"])
    return int(arm["process"]["pid"]) if moves else 0


@pytest.mark.timeout(240)
def test_import_run_rescue_and_fetch(evening: Up, tmp_path: Path) -> None:
    home = ("--home", str(evening.home))
    mine = tmp_path / "mine"
    assert "2 written, 0 skipped, 0 refused." in run_command(
        "import", str(tmp_path / "foreign"), "-o", str(mine)
    )
    evening.start(str(mine / "corner.yaml"))
    assert run_command("submit", str(mine / "workflows" / "look.yaml"), *home).strip() == "R1"

    os.kill(until(lambda: is_carrying(evening), "the arm moves"), signal.SIGKILL)
    with evening.client() as client:
        until(lambda: client.state(waits=False)["interventions"], "somebody is asked")
    assert "Other open questions: I1. See: labos interventions" in run_command("inbox", *home)
    told = run_command("interventions", *home)
    assert "its node was restarted in mid-motion" in told
    assert "labos resolve I1 not_done" in told
    assert "transfer for R1 (outcome unknown)" in run_command("nodes", *home)

    bench = json.loads(run_command("bench", "show", "--json", *home))["workcells"][0]["places"]
    (plate,) = [place for place, plates in bench.items() if any(each.startswith("P1") for each in plates)]
    # What the hand holds, or has put down, is at the target once a person says so.
    choice = "not_done" if plate == "sciclops.exchange" else "done"
    assert (
        run_command("resolve", "I1", choice, "--why", "looked", "--user", "ada", *home)
        == f"I1 is answered: {choice}.\n"
    )
    second = labos("resolve", "I1", "gone", *home)
    assert second.returncode == 1
    assert "ada answered I1" in second.stderr

    with evening.client() as client:
        assert client.wait("R1", timeout_s=60).status == "completed"
    assert "labos files R1 final_image.jpg -o ." in run_command("files", "R1", "final_image.jpg", *home)
    run_command("files", "R1", "final_image.jpg", "-o", str(tmp_path), *home)
    assert (tmp_path / "final_image.jpg").read_bytes().startswith(b"\xff\xd8")
