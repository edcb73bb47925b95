"""``labos do``, ``reset``, ``home``, ``estop`` and service, on real processes."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.client import LabClient
from labos.settings import find_kernel
from tests.support.cells import rpl_with
from tests.support.lab_process import Up, labos, until


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "100")
    yield up
    up.clean_up()


pytestmark = pytest.mark.timeout(180)


def module(client: LabClient, name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(
        m for m in client.state(waits=False)["modules"] if m["name"] == f"rpl/{name}"
    )
    return found


def is_idle(client: LabClient, name: str) -> bool:
    return bool(module(client, name)["status"] == "IDLE")


def payloads(lab: Up, kind: str, **holds: Any) -> list[dict[str, Any]]:
    """The events of a type whose fields are these."""
    found = [json.loads(r.payload) for r in lab.records() if r.head.type == kind]
    return [payload for payload in found if holds.items() <= payload.items()]


def test_one_action_in_a_lab_of_its_own(tmp_path: Path) -> None:
    up = Up(tmp_path / "lab")
    home = ("--home", str(up.home))
    cell = rpl_with(("sciclops", "pf400", "sealer", "hidex"), tmp_path / "rpl.yaml")
    new = ("--simulate", "--workcell", str(cell), *home)
    refused = labos("do", "sealer", "seal", "time=1000", *new)
    assert (refused.returncode, "do sealer.seal" in refused.stderr) == (1, True), refused.stderr
    assert not up.home.exists(), "nothing is half-done"
    done = labos("do", "sciclops", "get_plate", "loc=tower1", "--speed", "2000", "--user", "ada", *new)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "R1 (do sciclops.get_plate) completed; 1 of 1 steps" in done.stdout
    # What it left is the user's: the next one may carry it on, as any run of the user may.
    place = ("source=sciclops.exchange", "target=hidex.default")
    moved = labos("do", "rpl/pf400", "transfer", *place, "--json", *home, "--user", "ada")
    assert moved.returncode == 0, moved.stdout + moved.stderr
    assert [step["state"] for step in json.loads(moved.stdout)["steps"]] == ["done"]
    assert len(up.bench()["hidex.default"]) == 1
    assert up.disagreements() == []
    assert labos("home", "sciclops", *home).returncode == 0
    homeless = labos("home", "sealer", *home)
    assert homeless.returncode == 1
    assert "sealer has no action 'home'" in homeless.stderr
    assert "Traceback" not in homeless.stderr
    assert labos("do", "sealer", "seal", "time", *home).returncode == 1
    assert labos("do", "sealer", *home).returncode == 2
    unheard = labos("do", "sealer", "seal", "--no-wait", *home)
    assert (unheard.returncode, "No lab runs in" in unheard.stderr) == (1, True)


def test_an_emergency_stop_is_recorded_and_ended_by_a_reset(lab: Up) -> None:
    lab.options = ("--simulate", "--speed", "1")
    lab.start_with("sciclops", "pf400", "sealer")
    home = ("--home", str(lab.home), "--user", "ada")
    with lab.client() as client:
        until(lambda: is_idle(client, "sciclops"), "the crane is there")
        moving = client.do("sciclops", "home", user="ada")
        until(lambda: payloads(lab, "action.accepted", run=moving), "it moves")
        stopped = labos("estop", "sciclops", *home)
        assert (stopped.returncode, stopped.stdout) == (0, "rpl/sciclops is stopped.\n"), stopped.stderr
        assert client.wait(moving, timeout_s=20).status == "failed"
        shown = module(client, "sciclops")
        assert shown["status"] == "ERROR"
        assert "Stopped in an emergency by ada" in shown["problem"]
        waiting = client.do("sciclops", "home", user="ada")
        reset = labos("reset", "sciclops", *home)
        assert reset.returncode == 0, reset.stdout + reset.stderr
        assert "(do sciclops.reset) completed" in reset.stdout
        until(lambda: payloads(lab, "action.requested", run=waiting), "what waited goes on")
        assert client.emergency_stop("sciclops", "bo")["silent"] == {}
        assert client.wait(waiting, timeout_s=20).status == "failed"
    stop = payloads(lab, "module.emergency_stopped")[0]
    assert (stop["module"], stop["by"]) == ("rpl/sciclops", "ada")
    assert stop["stopped_at"] > 0
    (requested,) = payloads(lab, "action.requested", name="reset")
    assert payloads(lab, "action.succeeded", action=requested["action"])
    record = next(r for r in lab.records() if r.head.type == "module.emergency_stopped")
    assert record.head.actor == "rpl/sciclops", "the module has told it"
    assert lab.interrupt() == 0
    assert "stopped in an emergency by ada" in labos("log", "--home", str(lab.home)).stdout


def test_an_emergency_stop_past_the_kernel_is_recorded_too(lab: Up) -> None:
    lab.start_with("sciclops", "pf400", "sealer")
    info = find_kernel(lab.home)
    assert info is not None
    with lab.client() as client:
        until(lambda: is_idle(client, "pf400"), "the arm is there")
        done = labos(
            "estop", "pf400", "--connect", info.bus, "--home", str(lab.home / "elsewhere"), "--user", "bo"
        )
        assert (done.returncode, done.stdout) == (0, "rpl/pf400 is stopped.\n"), done.stderr
        until(lambda: payloads(lab, "module.emergency_stopped", by="bo"), "the node has told it")
        until(lambda: not is_idle(client, "pf400"), "it is in error")
        everything = labos("estop", "--all", "--json", "--home", str(lab.home), "--user", "bo")
        assert everything.returncode == 0, everything.stderr
        assert len(json.loads(everything.stdout)["stopped"]) == 3
    assert labos("estop", "nobody", "--home", str(lab.home)).returncode == 1
    assert labos("estop", "--home", str(lab.home)).returncode == 2
    assert lab.interrupt() == 0
    late = labos("estop", "--all", "--home", str(lab.home))
    assert (late.returncode, "Nothing was stopped" in late.stderr) == (1, True), late.stderr


def test_out_of_service_and_back(lab: Up) -> None:
    lab.start_with("sciclops", "pf400", "sealer")
    home = ("--home", str(lab.home), "--user", "ada")
    with lab.client() as client:
        until(lambda: is_idle(client, "sciclops"), "the crane is there")
        out = labos("out-of-service", "sciclops", "--why", "new belt", "--until", "1d", *home)
        assert (out.returncode, "out of service until" in out.stdout) == (0, True), out.stderr
        waiting = client.do("sciclops", "home", user="ada")
        (shown,) = client.state()["runs"]
        assert shown["waits"][0]["why"] == "sciclops is out of service (new belt)"
        assert labos("in-service", "sciclops", *home).stdout == "sciclops is in service.\n"
        assert client.wait(waiting, timeout_s=30).status == "completed"
        past = labos("out-of-service", "sciclops", "--why", "x", "--until", "2020-01-01", *home)
        assert (past.returncode, "in the past" in past.stderr) == (1, True)
    (taken,) = payloads(lab, "module.taken_out")
    assert taken["until"] > 0
    assert len(payloads(lab, "module.put_back")) == 1
    assert lab.interrupt() == 0


def test_a_reset_whose_node_is_killed_is_asked_about_and_not_repeated(lab: Up) -> None:
    """The arm's driver needs a while for its reset here: nobody can say how far it came."""
    slow = Path(__file__).parents[1] / "support" / "slow_reset"
    lab.environment = {"PYTHONPATH": str(slow)}
    lab.start_with("sciclops", "pf400", "sealer")
    home = ("--home", str(lab.home), "--user", "ada")
    with lab.client() as client:
        until(lambda: is_idle(client, "pf400"), "the arm is there")
        run = labos("reset", "pf400", "--no-wait", *home).stdout.strip()
        until(lambda: payloads(lab, "action.accepted", run=run), "it is being reset")
        os.kill(module(client, "pf400")["process"]["pid"], signal.SIGKILL)
        question = until(lambda: client.state(waits=False)["interventions"], "a person is asked")[0]
        assert (question["kind"], question["run"]) == ("unknown_action", run)
        assert labos("resolve", question["id"], "done", *home).returncode == 0
        assert client.wait(run, timeout_s=20).status == "completed"
    (requested,) = payloads(lab, "action.requested", name="reset")
    assert requested["attempt"] == 1
    assert lab.interrupt() == 0
