"""The program that the paper prints (A.4) runs, and is in the log in the words of the paper's table."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client.paper import Experiment
from labos.errors import BadInput
from labos.node.world import World
from labos.settings import Settings
from labos.spec import load_workcell
from tests.apps.support import list_standing
from tests.support.cells import rpl_with
from tests.support.reading import open_reading_lab

FOLDER = Path(__file__).parent / "paper"
PRINTED = Path(__file__).parents[1] / "unit" / "spec" / "paper" / "cp_wf_mixcolor.yaml"
MODULES = ("sciclops", "pf400", "ot2_cp_gamma", "camera_module")


@pytest.mark.slow
def test_the_printed_program_mixes_colors(tmp_path: Path) -> None:
    cell = load_workcell(rpl_with(MODULES, tmp_path / "rpl.yaml"), descriptions())
    settings = Settings.make(tmp_path / "lab", simulate=True, speed=5000)
    with LabThread(settings, [cell]) as lab, LabClient(lab.url) as client:
        address, _, port = lab.url.removeprefix("http://").partition(":")
        argv = [sys.executable, str(FOLDER / "color_picker_app.py"), address, port, "8", "4"]
        done = subprocess.run(argv, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
        assert done.returncode == 0, done.stderr
        notes = [event["payload"] for event in client.events(type="experiment.noted")]
        runs = [client.status(f"R{number}") for number in range(1, 5)]
        assert list_standing(client) == []
        world = World(str(lab.runtime.settings.world("rpl")))
        mixed = [motion.facts["wells"] for motion in world.motions("pipette")]
        world.close()
    assert mixed == [["A1", "A2", "A3", "A4"], ["A5", "A6", "A7", "A8"]]
    assert [run.workflow.split(" - ")[1] for run in runs] == [
        "New Plate",
        "Mix Colors",
        "Mix Colors",
        "Trash Plate",
    ]
    loop = ["compute", "local_compute", "flow", "condition_checked"]
    assert [note["kind"] for note in notes] == ["loop_started", *loop, *loop, "loop_ended"]
    checks = [note["facts"] for note in notes if note["kind"] == "condition_checked"]
    assert checks == [{"loop": "Main Loop", "result": True}, {"loop": "Main Loop", "result": False}]
    report = json.loads(
        (tmp_path / "experiments" / "Color_Picker_E1" / "published" / "report.txt").read_text()
    )
    assert 0 < report["best_diff"] < 255


def test_the_workflow_is_the_printed_one() -> None:
    assert (FOLDER / "workflows" / PRINTED.name).read_bytes() == PRINTED.read_bytes()


@pytest.mark.slow
def test_in_the_papers_words(tmp_path: Path) -> None:
    """Four lines are enough to run a workflow: the experiment is registered by itself."""
    with open_reading_lab(tmp_path) as lab, LabClient(lab.url) as client:
        address, _, port = lab.url.removeprefix("http://").partition(":")
        client.place("hidex.default", "plate96", "ada")
        client.give("P1", "shared", "ada")
        experiment = Experiment(address, port, "reading", user="ada", folder=tmp_path / "out")
        info = experiment.run_job(tmp_path / "read.yaml", payload={"assay": "OD600"})
        assert (info["run_id"], info["status"]) == ("R1", "completed")
        assert info["hist"]["Close"]["action_response"] == "succeeded"
        assert json.loads(info["hist"]["Read"]["action_msg"])["quantity"] == "absorbance"
        with pytest.raises(BadInput, match="No loop was started"):
            experiment.events.log_loop_end()
        experiment.events.log_decision("Go on", dec_value=True)
        experiment.events.end_experiment()
        assert client.state()["experiments"] == []
        (note,) = client.events(type="experiment.noted")
        assert note["payload"]["facts"] == {"value": True}
        (ended,) = client.events(type="experiment.ended")
        assert ended["payload"]["why"] == "ended"
