"""A planner process beside a running lab: it follows the log, and what it suggests counts."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from labos.bootstrap import LabThread, descriptions
from labos.cli.planner import command as planner
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import parse_workcell
from tests.support.lab_process import until
from tests.support.processes import run_process

CELL = """
labos: 1
name: shop
modules:
  - name: saw
    about: {actions: {cut: {duration: 600}}}
  - name: drill
    about: {actions: {bore: {duration: 600}}}
"""


def flow(name: str, *steps: str, within: str = "") -> dict[str, object]:
    """A workflow of actions on `saw` and `drill`, one after the other, each ``within`` such a time."""
    lines = [f"labos: 1\nname: {name}\nsteps:"]
    for number, what in enumerate(steps):
        module = "saw" if what == "cut" else "drill"
        window = f", within: {{after: step {number - 1}, at_most: {within}}}" if within and number else ""
        lines.append(f"  - {{name: step {number}, module: {module}, action: {what}{window}}}")
    return {"name": f"{name}.yaml", "text": "\n".join(lines) + "\n", "files": {}}


def use_lab_time(client: LabClient) -> str:
    """A run of bob's: then ada's runs go first, and the lab's own look ahead does not compare them."""
    run = client.submit(flow("earlier", "bore"), user="bob")
    assert client.wait(run).succeeded
    return run


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[LabThread]:
    settings = Settings.make(tmp_path / "lab", speed=100.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())]) as running:
        yield running


@pytest.mark.slow
def test_a_planner_suggests_the_shorter_order_and_the_lab_follows(lab: LabThread, tmp_path: Path) -> None:
    pytest.importorskip("ortools")
    with LabClient(lab.url) as client:
        deadline = time.monotonic() + 30
        while {module["status"] for module in client.state()["modules"]} != {"IDLE"}:
            assert time.monotonic() < deadline
        earlier = use_lab_time(client)
        client.control("pause", "lab", "ada")
        # In the order of the shares the drill waits for the saw twice: 2,400 s; the other way round 1,800 s.
        first = client.submit(flow("cutting", "cut", "cut"), user="ada")
        second = client.submit(flow("both", "cut", "bore"), user="bob")
        home = str(tmp_path / "lab")
        said = CliRunner().invoke(planner, ["--home", home, "--once", "--seconds", "5", "--user", "ada"])
        assert said.exit_code == 0, said.output
        assert "shop: an order for 4 steps of 2 runs." in said.output
        order = client.suggested_order("shop")
        assert order["steps"][0]["run"] == second
        assert order["by"] == "ada"
        client.control("resume", "lab", "ada")
        assert client.wait(first).succeeded
        assert client.wait(second).succeeded
        begun = [e["payload"]["run"] for e in client.events() if e["type"] == "action.requested"]
        assert next(run for run in begun if run != earlier) == second
        assert client.suggested_order("shop")["steps"] == [], "nothing of it is still to come"


@pytest.mark.slow
def test_for_runs_with_windows_the_lab_begins_with_the_planner_s_line(lab: LabThread, tmp_path: Path) -> None:
    pytest.importorskip("ortools")
    with LabClient(lab.url) as client:
        until(lambda: {each["status"] for each in client.state()["modules"]} == {"IDLE"}, "all are idle")
        client.control("pause", "lab", "ada")
        runs = [
            client.submit(flow(f"way {number}", *steps, within="20 min"), user="ada")
            for number, steps in enumerate([("cut", "bore"), ("bore", "cut"), ("cut", "cut", "bore")])
        ]
        home = str(tmp_path / "lab")
        said = CliRunner().invoke(planner, ["--home", home, "--once", "--user", "ada"])
        assert said.exit_code == 0, said.output
        assert "shop: an order of 3 runs. The lab's own search begins with it." in said.output
        order = client.suggested_order("shop")
        assert (order["steps"], sorted(order["line"])) == ([], sorted(runs))
        client.control("resume", "lab", "ada")
        for run in runs:
            assert client.wait(run).succeeded
        assert client.suggested_order("shop")["line"] == []


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_planner_that_is_killed_leaves_a_lab_that_goes_on(lab: LabThread, tmp_path: Path) -> None:
    """Killed when runs wait by its advice; they and what comes later are done as without it."""
    pytest.importorskip("ortools")
    argv = [sys.executable, "-m", "labos", "planner", "--home", str(tmp_path / "lab"), "--seconds", "2"]
    with LabClient(lab.url) as client, run_process([*argv, "--user", "ada"]) as process:
        use_lab_time(client)
        client.control("pause", "lab", "ada")
        runs = [
            client.submit(flow("cutting", "cut", "cut"), user="ada"),
            client.submit(flow("both", "cut", "bore"), user="bob"),
        ]
        until(lambda: client.suggested_order("shop")["steps"], "an order is suggested", 240.0)
        process.kill()  # as kill -9 does
        assert process.wait() == -signal.SIGKILL
        client.control("resume", "lab", "ada")
        runs.append(client.submit(flow("late", "bore", "cut"), user="ada"))
        for run in runs:
            assert client.wait(run).succeeded
