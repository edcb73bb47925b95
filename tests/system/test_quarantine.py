"""A node that dies again and again is quarantined, on real processes; a person lets it work again. One that
is told to end has not failed."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path
from typing import Any

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import PATIENCE_S, labos, until

CELL = """\
labos: 1
name: corner
modules:
  - {name: pf400, model: pf400}
stations:
  wc.a: {kind: nest}
  wc.b: {kind: nest}
stock:
  wc.a: {plate96: 1}
"""

CARRY = """\
labos: 1
name: carry
workcell: corner
steps:
  - {name: Carry, module: pf400, action: transfer, args: {source: wc.a, target: wc.b}}
"""

TIMES = 3


def is_idle(client: LabClient) -> bool:
    return bool(client.state(waits=False)["modules"][0]["status"] == "IDLE")


def test_a_lab_that_is_closed_and_started_again_and_again(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True, quarantine="2/1000000")
    for life in range(4):
        with LabThread(settings, [] if life else [cell]) as lab, LabClient(lab.url) as client:
            until(partial(is_idle, client), "the arm is there")
            assert not client.state(waits=False)["modules"][0]["out_of_service"]
    told = labos("log", "--type", "node.left", "--home", str(settings.home)).stdout
    assert told.count("node gone: LabOS has requested its end") == 4


def test_a_node_that_dies_again_and_again(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    (tmp_path / "carry.yaml").write_text(CARRY)
    home = tmp_path / "lab"
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    settings = Settings.make(home, speed=1000.0, simulate=True, quarantine=f"{TIMES}/1000000")
    with LabThread(settings, [cell]) as lab, LabClient(lab.url) as client:

        def arm() -> dict[str, Any]:
            (module,) = client.state(waits=False)["modules"]
            return dict(module)

        for _ in range(TIMES):
            pid = until(lambda: arm()["status"] == "IDLE" and arm()["process"]["pid"], "the arm is there")
            os.kill(pid, signal.SIGKILL)
            until(lambda p=pid: arm()["process"]["pid"] not in (0, p), "it is started again")  # type: ignore[misc]
        until(lambda: arm()["out_of_service"], "it is quarantined")
        told = labos("nodes", "--home", str(home)).stdout
        assert f"quarantined: it has failed {TIMES} times in 1e+06 s" in told
        assert "it does not answer (gone or frozen)" in told
        run = client.submit(tmp_path / "carry.yaml", user="ada")
        why = until(lambda: labos("explain", run, "--home", str(home)).stdout, "it waits")
        assert "pf400 is out of service (quarantined: it has failed" in why
        assert "labos in-service pf400" in why
        assert labos("in-service", "pf400", "--home", str(home)).returncode == 0
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
