"""What people see and give on real processes: a plate is missed, found elsewhere, and handed over."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.ports import LogQuery
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import PATIENCE_S, labos, until

CELL = """\
labos: 1
name: corner
modules: [{name: camera, model: camera, config: {observes: [wc.shelf]}}]
stations:
  wc.shelf: {kind: nest}
  wc.table: {kind: nest}
stock:
  camera.plate_station: {plate96: 1}
"""


def test_a_plate_is_missed_found_and_given(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    home = tmp_path / "lab"
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())

    def say(*words: str, fails: bool = False) -> str:
        done = labos(*words, "--home", str(home))
        assert (done.returncode != 0) == fails, done.stderr
        return done.stderr if fails else done.stdout

    with (
        LabThread(Settings.make(home, speed=5000.0, simulate=True), [cell]) as lab,
        LabClient(lab.url) as client,
    ):
        (plate,) = [item["id"] for item in client.state()["labware"]]
        assert "Recorded: wc.shelf, empty" in say("observe", "wc.shelf", "empty")
        follows: dict[str, Any] = json.loads(say("observe", "camera.plate_station", "empty", "--json"))
        assert list(follows["uncertain"]) == [plate]
        (question,) = client.state(waits=False)["interventions"]
        assert (question["kind"], question["id"]) == ("contradiction", follows["asked"][0]["id"])
        told = say("observe", "wc.table", plate)
        assert f"{plate} stands at wc.table." in told
        assert f"{question['id']} is auto-resolved." in told
        assert client.state(waits=False)["interventions"] == []

        told = say("observe", "wc.shelf", "plate96")
        assert "where nothing should stand" in told
        assert "labos resolve I2 new" in told
        say("resolve", "I2", "new")
        assert "is neither labware on the bench nor a labware type" in say(
            "observe", "wc.shelf", "x", fails=True
        )

        say("give", plate, "--to", "user", "bob", "--user", "ada")
        assert "belongs to user bob, not to ada" in say(
            "give", plate, "--to", "shared", "--user", "ada", fails=True
        )
        assert "Add --why" in say("give", plate, "--to", "shared", "--user", "eve", "--force", fails=True)
        say("give", plate, "--to", "shared", "--user", "eve", "--force", "--why", "bob has left")
        say("give", plate, "--to", "user", fails=True)
        owners = {item["id"]: item["owner"] for item in client.state()["labware"]}
        assert set(owners.values()) == {"shared"}
    assert "given by eve: bob has left" in say("log", "--type", "labware.handed_over")


WATCHED = """\
labos: 1
name: corner
modules:
  - {name: pf400, model: pf400}
  - {name: camera, model: camera, config: {observes: [wc.shelf, wc.table]}}
stations:
  wc.shelf: {kind: nest}
  wc.table: {kind: nest}
stock:
  wc.shelf: {plate96: 1}
"""

CARRY = """\
labos: 1
name: carry
workcell: corner
steps:
  - {name: Carry, module: pf400, action: transfer, args: {source: wc.shelf, target: wc.table}}
"""


def test_nodes_say_where_what_an_arm_missed_is_not(tmp_path: Path) -> None:
    """Somebody takes a plate away and tells nobody: the arm's hand and the camera are asked."""
    (tmp_path / "corner.yaml").write_text(WATCHED)
    workflow = tmp_path / "carry.yaml"
    workflow.write_text(CARRY)
    home = tmp_path / "lab"
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    with (
        LabThread(Settings.make(home, speed=5000.0, simulate=True), [cell]) as lab,
        LabClient(lab.url) as client,
    ):
        world = lab.runtime.world("corner")
        (plate,) = world.at("wc.shelf")
        world.carry(plate, "")
        run = client.submit(workflow, user="ada")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "failed"

        def sights() -> set[tuple[str, str]]:
            """Who saw which place empty: the lab looks again whenever a module is at rest again."""
            records = lab.runtime.store.select(LogQuery(types=("station.observed",)))
            seen = [json.loads(record.payload) for record in records]
            return {(item["by"], item["station"]) for item in seen if item["count"] == 0}

        hand = {("pf400", "corner/pf400.gripper")}
        until(lambda: sights() == hand, "the hand is seen empty")
        (labware,) = (item["id"] for item in client.state()["labware"])
        (question,) = client.state(waits=False)["interventions"]
        assert question["kind"] == "lost_labware"
        assert sights() == hand, "where all is empty nothing is found by elimination"
        # Said before it is done: a camera that looks once more would else answer before the person does.
        done = labos("observe", "wc.table", labware, "--home", str(home))
        assert f"{labware} stands at wc.table." in done.stdout
        assert f"{question['id']} is auto-resolved." in done.stdout
