"""An arm that a person guides by hand, in a lab of real processes: whoever wants to move it waits."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import PATIENCE_S, labos, until
from tests.system.test_quarantine import CARRY, CELL


@pytest.mark.full
def test_nothing_moves_an_arm_that_is_guided_by_hand(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    (tmp_path / "carry.yaml").write_text(CARRY)
    home = tmp_path / "lab"
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())

    def say(*words: str) -> str:
        done = labos(*words, "--home", str(home))
        assert done.returncode == 0, done.stderr
        return done.stdout

    with (
        LabThread(Settings.make(home, speed=1000.0, simulate=True), [cell]) as lab,
        LabClient(lab.url) as client,
    ):
        say("do", "pf400", "free_mode", "--quiet")
        run = client.submit(tmp_path / "carry.yaml", user="ada")
        pose = "400.0, 1.4, 177.101, 537.107, 90.0, 0.0"
        assert f"result [{pose}]" in say("do", "pf400", "read_pose")
        why = until(lambda: say("explain", run), "it waits")
        assert "pf400 needs free = False" in why
        # Its node is started again with the new pose, and the arm is as free as it was.
        assert "with version 1" in say("teach", "pf400", "wc.a", "--pose", pose.replace(" ", ""))
        (module,) = client.state(waits=False)["modules"]
        assert module["variables"]["free"] is True
        assert client.state(waits=False)["runs"][0]["status"] == "queued"
        say("do", "pf400", "end_free_mode", "--quiet")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        world = lab.runtime.world("corner")
        moved = [m.verb for m in world.motions() if m.verb in ("yield", "hold", "grip", "release")]
        assert moved == ["yield", "hold", "grip", "release"]
        assert world.crashes() == []
