"""What ``labos new`` writes works as it is: the workflow runs, and the application on a lab."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.support.lab_process import Up, labos

TIMEOUT_S = 90


def test_a_new_workflow_runs_on_a_new_workcell(tmp_path: Path) -> None:
    cell, flow = str(tmp_path / "bench.yaml"), str(tmp_path / "seal.yaml")
    assert labos("new", "workcell", cell).returncode == 0
    assert labos("new", "workflow", flow).returncode == 0
    checked = labos("validate", flow, "--workcell", cell)
    assert checked.returncode == 0, checked.stdout
    home = ("--home", str(tmp_path / "lab"), "--speed", "600")
    done = labos("run", flow, "--workcell", cell, "--simulate", *home, timeout_s=TIMEOUT_S)
    assert done.returncode == 0, done.stderr
    assert "completed; 4 of 4 steps" in done.stdout


def test_a_new_application_runs_against_a_lab(tmp_path: Path) -> None:
    cell, app = tmp_path / "bench.yaml", tmp_path / "screening.py"
    assert labos("new", "workcell", str(cell)).returncode == 0
    assert labos("new", "app", str(app)).returncode == 0
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "600").start(str(cell))
    try:
        done = subprocess.run(
            [sys.executable, str(app), "--home", str(lab.home), "--user", "ada"],
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert [line.partition(":")[0] for line in done.stdout.splitlines()] == [
            "pressed 2 s",
            "pressed 3 s",
            "pressed 4 s",
        ]
        lab.interrupt()
        ends = [kind for kind in lab.types() if kind in ("run.completed", "experiment.ended")]
        assert ends == ["run.completed"] * 3 + ["experiment.ended"]
    finally:
        lab.clean_up()


def test_an_application_without_a_lab_says_so(tmp_path: Path) -> None:
    app = tmp_path / "screening.py"
    assert labos("new", "app", str(app)).returncode == 0
    done = subprocess.run(
        [sys.executable, str(app), "--home", str(tmp_path / "lab")],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("screening: ")
