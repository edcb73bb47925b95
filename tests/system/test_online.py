"""``labos validate --online`` asks the nodes themselves, and tells silent, frozen and off apart."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from labos.settings import free_port
from labos.version import VERSION
from tests.support.cells import rpl_with
from tests.support.lab_process import Up, labos, until

pytestmark = pytest.mark.timeout(180)

WORKFLOW = """\
labos: 1
name: carry
steps:
  - {name: place, module: pf400, action: transfer, args: {source: sealer.default, target: peeler.default,
      source_plate_rotation: narrow, target_plate_rotation: narrow}}
  - {name: peel, module: peeler, action: peel}
  - {name: home, module: sciclops, action: home}
"""


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "1000")
    yield up
    up.clean_up()


def test_the_node_itself_is_asked(lab: Up, tmp_path: Path) -> None:
    cell = rpl_with(["sealer", "pf400", "peeler", "sciclops"], tmp_path / "cell.yaml")
    file = tmp_path / "wf.yaml"
    file.write_text(WORKFLOW)
    asked = ("validate", str(file), "--workcell", str(cell), "--online", "--home", str(lab.home))
    lab.start(str(cell))
    with lab.client() as client:

        def answers() -> dict[str, str]:
            return {found["name"]: found["answer"] for found in client.ask_nodes()}

        until(lambda: set(answers().values()) == {"IDLE"}, "all are there")
        ready = labos(*asked)
        assert ready.returncode == 0, ready.stdout + ready.stderr
        assert "Not ready" not in ready.stdout
        processes = {m["name"]: m["process"]["pid"] for m in client.state()["modules"]}
        frozen = processes["rpl/peeler"]
        os.kill(frozen, signal.SIGSTOP)
        try:
            # The kernel has not missed it yet: its last word was IDLE.
            told = labos(*asked)
            assert told.returncode == 1
            assert f"frozen: its process {frozen} is running but does not answer" in told.stdout
            assert "Not ready: peeler." in told.stdout
        finally:
            os.kill(frozen, signal.SIGCONT)
        until(lambda: answers()["rpl/peeler"] == "IDLE", "it goes on")
        check = labos("nodes", "--check", "--home", str(lab.home))
        assert check.returncode == 0, check.stdout + check.stderr
        (arm,) = [line for line in check.stdout.splitlines() if line.startswith("rpl/pf400")]
        assert arm.split() == ["rpl/pf400", "IDLE", "pf400", "1", "(simulated)", VERSION, "gripper", "empty"]
        client.take_out("sciclops", "being cleaned", "ada")
        assert "out: being cleaned" in labos(*asked).stdout
        check = labos("nodes", "--check", "sciclops", "--home", str(lab.home))
        assert check.returncode == 1
        assert check.stdout.splitlines()[-1] == (
            "sciclops: being cleaned. When it works again: labos in-service sciclops"
        )
        (unknown,) = client.ask_nodes(["seeler"])
        assert (unknown["answer"], "Did you mean 'sealer'" in unknown["why"]) == ("absent", True)
    assert lab.interrupt() == 0


def test_a_device_that_is_off_and_a_node_that_is_not_there(tmp_path: Path) -> None:
    path = rpl_with(["sealer", "pf400", "peeler", "sciclops"], tmp_path / "cell.yaml")
    cell = yaml.safe_load(path.read_text())
    next(m for m in cell["modules"] if m["name"] == "pf400")["config"] = {"host": f"127.0.0.1:{free_port()}"}
    path.write_text(yaml.safe_dump(cell))
    file = tmp_path / "wf.yaml"
    file.write_text(WORKFLOW)
    up = Up(tmp_path / "lab", "--real", "--no-nodes").start(str(path))
    argv = ["node", "start", "--name", "pf400", "--workcell", "rpl", "--home", str(up.home)]
    node = subprocess.Popen([sys.executable, "-m", "labos", *argv], stdin=subprocess.DEVNULL)
    try:
        with up.client() as client:

            def ask_nodes() -> dict[str, str]:
                return {found["name"]: f"{found['answer']}: {found['why']}" for found in client.ask_nodes()}

            off = "ERROR: The device is not connected"
            until(lambda: ask_nodes()["rpl/pf400"].startswith(off), "it has found no device")
        told = labos("validate", str(file), "--workcell", str(path), "--online", "--home", str(up.home))
        assert told.returncode == 1
        assert off in told.stdout
        assert "peeler    silent: no node answers for it" in told.stdout
        assert "Not ready: pf400, peeler, sciclops." in told.stdout
    finally:
        node.kill()
        node.wait()
        up.clean_up()
