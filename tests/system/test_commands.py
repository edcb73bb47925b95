"""What the commands say to bad input, and the paper's own files from start to end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from labos.settings import find_kernel
from tests.support.lab_process import Up, labos

PAPER = Path(__file__).parents[1] / "unit" / "spec" / "paper"

WORKFLOW = """\
labos: 1
name: one
modules: [{module}]
steps:
  - name: Do it
    module: {module}
    action: {action}
    args: {args}
"""

BAD = {
    "broken YAML": ("steps: [", ":1:", "This is not YAML"),
    "unknown module": (
        WORKFLOW.format(module="sealor", action="seal", args="{}"),
        ":6:",
        "Did you mean 'sealer'",
    ),
    "unknown action": (
        WORKFLOW.format(module="sealer", action="seel", args="{}"),
        ":7:",
        "Did you mean 'seal'",
    ),
    "wrong range": (
        WORKFLOW.format(module="sealer", action="seal", args="{time: 1000000}"),
        ":8:",
        "time",
    ),
    "missing payload key": (
        WORKFLOW.format(module="sealer", action="seal", args="{time: payload.seconds}"),
        ":8:",
        "payload",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_refused_with_its_place(tmp_path: Path, what: str) -> None:
    text, place, words = BAD[what]
    file = tmp_path / "wf.yaml"
    file.write_text(text)
    done = labos("run", str(file), "--simulate", "--home", str(tmp_path / "lab"))
    assert done.returncode == 1
    assert f"{file}{place}" in done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "lab").exists(), "nothing is half-done"


def test_without_a_lab_the_commands_say_so(tmp_path: Path) -> None:
    home = ("--home", str(tmp_path / "lab"))
    for command in (("submit", "pcr", *home), ("nodes", *home), ("resolve", "I1", "done", *home)):
        done = labos(*command)
        assert (done.returncode, "No lab runs in" in done.stderr) == (1, True), done
    assert labos("submit").returncode == 2
    assert labos("nonsense").returncode == 2
    assert labos("run", "nowhere.yaml", "--simulate", *home).returncode == 1
    assert not (tmp_path / "lab").exists()


def test_the_papers_files_run_as_they_are(tmp_path: Path) -> None:
    home = ("--home", str(tmp_path / "lab"), "--simulate")
    cell = ("--workcell", str(PAPER / "rpl_modular_workcell.yaml"))
    pcr = labos("run", str(PAPER / "pcr_demo_wf.yaml"), *cell, *home, "--speed", "4000", "-p", "seal.time=3")
    assert pcr.returncode == 0, pcr.stderr
    assert "completed; 14 of 14 steps" in pcr.stdout
    colors = {f"color_{name}_volumes": [10.0] for name in "ABC"}
    payload = json.dumps({**colors, "destination_wells": ["A1"], "use_existing_resources": False})
    mix = labos(
        *("run", str(PAPER / "cp_wf_mixcolor.yaml"), *cell, *home, "--payload", payload, "--json"),
        *("--place", "camera_module.plate_station=plate96"),
    )
    assert mix.returncode == 0, mix.stderr
    result = json.loads(mix.stdout)
    assert result["status"] == "completed"
    assert [step["state"] for step in result["steps"]] == ["done"] * 4


def test_a_missing_plate_is_waited_for_and_can_be_placed(tmp_path: Path) -> None:
    """Commands from another terminal reach the lab."""
    up = Up(tmp_path / "lab", "--simulate", "--speed", "4000")
    try:
        up.start("rpl")
        home = ("--home", str(up.home))
        file = tmp_path / "picture.yaml"
        file.write_text(WORKFLOW.format(module="camera_module", action="take_picture", args="{}"))
        run = labos("submit", str(file), "--user", "ada", "--request", "once", *home).stdout.strip()
        assert run == "R1"
        again = labos("submit", str(file), "--user", "ada", "--request", "once", *home)
        assert again.stdout.strip() == run
        assert up.types().count("run.submitted") == 1
        with up.client() as client:
            (waiting,) = client.state()["runs"]
            assert "camera_module" in waiting["waits"][0]["why"]
        assert labos("place", "camera_module.plate_station", "plate96", *home).returncode == 0
        with up.client() as client:
            assert client.wait(run, timeout_s=20).succeeded
        assert "holds 0" in labos("unload", "wc.trash", "--all", *home).stderr
        nodes = json.loads(labos("nodes", "--json", *home).stdout)
        assert len(nodes) == 14
        assert all(node["simulated"] for node in nodes)
        refused = labos("resolve", "I9", "done", *home)
        assert (refused.returncode, "I9" in refused.stderr) == (1, True)
        assert up.interrupt() == 0
        assert len(up.bench()["camera_module.plate_station"]) == 1
    finally:
        up.clean_up()


WHAT_THEY_ARE = {
    "pf400": "Four-axis plate arm on a rail.",
    "biometra": "Thermal cycler with a motorised, heated lid.",
    "ot2_pcr_alpha": "Liquid handler with eleven deck slots.",
}
"""A newcomer does not know the names of models."""


@pytest.mark.smoke
def test_the_demonstration(tmp_path: Path) -> None:
    home = tmp_path / "demo"
    done = labos("demo", "--speed", "4000", "--home", str(home), timeout_s=90)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("completed all 14 steps") == 2
    assert "Longest time without human intervention" in done.stdout
    assert "14 simulated modules" in done.stdout
    for module, what in WHAT_THEY_ARE.items():
        assert f"  {module:<16}{what}" in done.stdout.splitlines(), done.stdout
    assert "Ada submits two PCR runs, Bo an application that picks a colour." in done.stdout
    assert "labos verify --home" in done.stdout
    assert find_kernel(home) is None
    up = Up(home)
    assert up.disagreements() == []
    assert up.types().count("run.completed") == 7
    kinds = {
        json.loads(record.payload)["kind"]
        for record in up.records()
        if record.head.type == "experiment.noted"
    }
    assert {"loop_started", "loop_ended", "condition_checked", "decision", "local_compute"} <= kinds
    again = labos("demo", "--home", str(home))
    assert (again.returncode, "labos up --home" in again.stderr) == (1, True)


def test_applications_do_not_load_the_kernel() -> None:
    code = (
        "import sys, labos.client; "
        "bad = [n for n in sys.modules if n.startswith(('labos.runtime', 'labos.store', 'labos.bus', "
        "'labos.planning', 'labos.http', 'labos.bootstrap', 'labos.spec', 'sqlalchemy', 'zenoh', "
        "'starlette'))]; "
        "assert not bad, bad"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_command_starts_without_loading_the_others() -> None:
    code = (
        "import sys\n"
        "from labos.cli.app import main\n"
        "assert main(['--help']) == 0\n"
        "bad = [n for n in sys.modules if n.split('.')[0] in ('sqlalchemy', 'zenoh', 'rich', 'httpx', "
        "'pydantic', 'starlette')]\n"
        "assert bad in ([], ['rich']) or all(n.startswith('rich') for n in bad), bad\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_node_starts_without_loading_workflows() -> None:
    code = "import sys, labos.cli.node; assert 'labos.spec' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
