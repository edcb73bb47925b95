"""A kernel that is started before its bus, as after a power cut, waits for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from labos.settings import free_port
from tests.support.lab_process import Up, statuses, until

CELL = """\
labos: 1
name: corner
modules: [{name: pf400, model: pf400}]
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


def test_the_bus_may_start_after_its_kernel(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    workflow = tmp_path / "carry.yaml"
    workflow.write_text(CARRY)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "300", "--quiet", "--bus", endpoint)
    bus: subprocess.Popen[bytes] | None = None
    try:
        lab.launch(str(tmp_path / "corner.yaml"))
        until(lambda: "waiting_for_the_bus" in lab.read_log(), "the kernel waits")
        bus = subprocess.Popen([sys.executable, "-m", "labos", "bus", "--listen", endpoint])
        until(lambda: lab.is_there() or lab.process.poll() is not None, "the lab answers")  # type: ignore[union-attr]
        with lab.client() as client:
            assert statuses(client, [client.submit(workflow, user="ada")]) == ["completed"]
        assert lab.interrupt() == 0, lab.read_log()
    finally:
        lab.clean_up()
        if bus is not None:
            bus.kill()
            bus.wait()
