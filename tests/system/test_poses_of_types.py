"""Two types of plates that lie differently in the same nests, and an arm behind its wire that is told which
of them it carries: on real processes, against what the simulated device knows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import BadInput, NotFound
from labos.node import World
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import labos, until
from tests.system.test_wire import end, start_node

CELL = """\
labos: 1
name: corner
modules:
  - {name: arm, model: pf400}
  - {name: crane, model: platecrane}
stations:
  wc.left: {}
  wc.right: {}
locations:
  arm:
    wc.left:
      any: [205.128, -2.814, 264.373, 365.863, 79.144, 411.553]
      pcr96: [217.128, -2.814, 264.373, 365.863, 79.144, 418.553]
    wc.right: [163.230, -59.032, 270.965, 415.013, 79.982, -951.510]
stock: {}
"""
OTHER = [175.230, -59.032, 270.965, 415.013, 79.982, -944.510]
"""Where a pcr96 is met at wc.right."""

CARRY = """\
labos: 1
name: carry
steps:
  - {name: There, module: arm, action: transfer, args: {source: wc.left, target: wc.right}}
  - {name: Back, module: arm, action: transfer, args: {source: wc.right, target: wc.left}}
"""


@pytest.mark.timeout(180)
def test_an_arm_finds_each_type_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    (tmp_path / "carry.yaml").write_text(CARRY)
    home = tmp_path / "lab"
    settings = Settings.make(home, speed=200.0, simulate=True, wire=True)
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    at = ("--home", str(home))
    with LabThread(settings, [cell], nodes="none") as lab, LabClient(lab.url) as client:

        def idle() -> bool:
            told = {m["name"]: m["status"] for m in client.state(waits=False)["modules"]}
            return told["corner/arm"] == "IDLE"

        def carry(kind: str) -> list[tuple[str, bool]]:
            node = start_node("arm", home, tmp_path)
            try:
                until(idle, "an idle node")
                plate = client.place("wc.left", kind, "ada")
                run = client.submit(tmp_path / "carry.yaml", user="ada")
                assert client.wait(run, timeout_s=60).status == "completed"
                assert labos("unload", "wc.left", "--all", *at).returncode == 0
                asked = labos("log", "--type", "action.requested", "--run", run, "--json", *at).stdout
                events = [json.loads(line)["payload"] for line in asked.splitlines()]
                moved = {f["labware"] for e in events for f in e["effects"] if f["effect"] == "move"}
                assert moved == {plate}
                by_action = {e["action"]: e["args"] for e in events}  # one may have been sent again
                return [(args["labware_type"], args["slow"]) for args in by_action.values()]
            finally:
                assert end(node) == 0

        assert carry("plate96") == [("plate96", False)] * 2
        assert carry("pcr96") == [("pcr96", False)] * 2
        with pytest.raises(NotFound, match="'pcr69'"):
            client.teach("arm", "wc.right", OTHER, "ada", labware_type="pcr69")
        with pytest.raises(BadInput, match="crane has one pose for all labware"):
            client.teach("crane", "wc.right", OTHER, "ada", labware_type="pcr96")
        pose = ",".join(map(str, OTHER))
        taught = labos("teach", "arm", "wc.right", "--type", "pcr96", "--pose", pose, *at)
        assert taught.stdout == "arm now reaches wc.right with a pcr96 with version 1 of the pose.\n", (
            taught.stderr
        )
        assert carry("plate96") == [("plate96", False)] * 2
        assert carry("pcr96") == [("pcr96", True), ("pcr96", False)]
        known = client.locations("arm")
        assert known["wc.right"]["types"] == {"pcr96": {"pose": OTHER, "version": 1, "proven": True}}
        assert known["wc.left"]["types"]["pcr96"]["version"] == 0
        table = labos("locations", "arm", *at).stdout
        assert [line.split()[:3] for line in table.splitlines() if "pcr96" in line] == [
            ["wc.left", "pcr96", "0"],
            ["wc.right", "pcr96", "1"],
        ]
    world = World(str(settings.world("corner")))
    assert world.crashes() == []
    assert [m.place for m in world.motions("release")] == ["wc.right", "wc.left"] * 4
    world.close()
