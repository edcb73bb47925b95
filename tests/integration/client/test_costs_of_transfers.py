"""A running lab takes over what its workcell's file says of transfers, and goes by it."""

from __future__ import annotations

from pathlib import Path

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import parse_workcell

MOVE = """about:
      actions:
        move:
          args: {a: {type: station}, b: {type: station}}
          effects: [{move: {source: "{a}", target: "{b}"}}]
          duration: """
CELL = f"""
labos: 1
name: corner
modules:
  - name: quick
    {MOVE} 1
  - name: slow
    {MOVE} 9
stations: {{wc.here: {{}}, wc.there: {{}}}}
locations: {{quick: {{wc.here: [1], wc.there: [2]}}, slow: {{wc.here: [1], wc.there: [2]}}}}
"""
WAYS = """\
transfers:
  - {module: quick, action: move, source: a, target: b, cost: 5}
  - {module: slow, action: move, source: a, target: b}
"""
FLOW = "labos: 1\nname: f\nsteps: [{name: x, action: transfer, args: {source: wc.here, target: wc.there}}]\n"


def find_carrier(client: LabClient, name: str) -> str:
    client.place("wc.here", "plate96", "ada")
    run = client.wait(client.submit({"name": name, "text": FLOW, "files": {}}, user="ada"))
    assert run.status == "completed"
    return run.steps[0].module


def test_costs_that_are_applied_to_a_running_lab_hold_from_then_on(tmp_path: Path) -> None:
    settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())]) as lab, LabClient(lab.url) as client:
        assert find_carrier(client, "before.yaml").endswith("quick")
        client.unload("wc.there", "ada")
        found = client.apply_workcell(CELL + WAYS, "corner.yaml", "ada", dry_run=True)
        assert found["transfers"]["added"] == ["quick.move", "slow.move"]
        client.apply_workcell(CELL + WAYS, "corner.yaml", "ada")
        assert find_carrier(client, "after.yaml").endswith("slow")
