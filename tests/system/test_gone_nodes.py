"""A node that dies in the midst of an action and stays away: said at once, asked about, and settled by
whoever knows first."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.lab_process import labos, until
from tests.system.test_freezes import Corner

SEAL = """\
labos: 1
name: seal
workcell: corner
steps:
  - {name: there, module: pf400, action: transfer, args: {source: wc.a, target: sealer.default}}
  - {name: seal, module: sealer, action: seal, args: {time: 10.0}}
  - {name: back, module: pf400, action: transfer, args: {source: sealer.default, target: wc.a}}
"""


@pytest.fixture
def corner(tmp_path: Path) -> Iterator[Corner]:
    lab = Corner(tmp_path, speed=4.0)
    lab.workflow.write_text(SEAL)
    try:
        lab.begin()
        yield lab
    finally:
        lab.clean_up()


def kill_in_mid_seal(lab: Corner) -> str:
    """The run whose seal is under way when its node is killed."""
    with lab.client() as client:
        run = client.submit(lab.workflow, user="ada")
    until(lambda: lab.types().count("action.accepted") == 2, "the seal is under way")
    node = lab.nodes.pop("sealer")
    node.kill()
    node.wait()
    until(lambda: "node.left" in lab.types(), "the node is missed")
    return run


def test_a_node_that_stays_away_is_told_and_given_up(corner: Corner) -> None:
    lab = corner
    run = kill_in_mid_seal(lab)
    home = ("--home", str(lab.home))
    told = labos("explain", run, *home).stdout
    assert "'seal' waits: sealer is GONE" in told, told
    assert "labos node start --name sealer --workcell corner" in told, told
    assert "sealer is GONE" in labos("runs", *home).stdout
    assert "unknown" not in told
    assert labos("out-of-service", "sealer", "--why", "burnt", *home).returncode == 0
    until(lambda: "action.unknown" in lab.types(), "nobody waits for it any more")
    assert "the module was taken out of service" in labos("resolve", *home).stdout
    assert labos("resolve", "I1", "gone", "--why", "the film is half on", *home).returncode == 0
    with lab.client() as client:
        assert client.wait(run, timeout_s=60).status == "failed"
    assert [fault for fault in lab.faults() if "grips" not in fault] == []


@pytest.mark.full
@pytest.mark.timeout(300)
def test_a_node_that_comes_back_at_its_work_ends_the_question(corner: Corner) -> None:
    """It was frozen, or cut off, and its device went on: who is let in meanwhile is warned, and nobody has
    to answer once it is back."""
    lab = corner
    home = ("--home", str(lab.home))
    lab.workflow.write_text(SEAL.replace("time: 10.0", "time: 160.0"))
    with lab.client() as client:
        run = client.submit(lab.workflow, user="ada")
    until(lambda: lab.types().count("action.accepted") == 2, "the seal is under way")
    lab.nodes["sealer"].send_signal(signal.SIGSTOP)
    until(lambda: "node.left" in lab.types(), "the node is missed")
    assert labos("out-of-service", "sealer", "--why", "silent", *home).returncode == 0
    until(lambda: "action.unknown" in lab.types(), "a person is asked")
    entered = labos("access", "corner", "--no-park", *home)
    assert "WARNING: it is unknown whether everything has stopped: sealer." in entered.stdout, entered
    assert labos("access", "corner", "--done", "--unchanged", *home).returncode == 0
    lab.nodes["sealer"].send_signal(signal.SIGCONT)
    until(lambda: "intervention.resolved" in lab.types(), "the question is withdrawn")
    assert labos("in-service", "sealer", *home).returncode == 0
    with lab.client() as client:
        assert client.wait(run, timeout_s=120).status == "completed"
    assert lab.types().count("action.accepted") == 4, "once more when the sealer was back at it"
    assert [fault for fault in lab.faults() if "grips" not in fault] == []


@pytest.mark.full
@pytest.mark.timeout(300)
def test_without_a_word_a_person_is_asked_after_a_minute(corner: Corner) -> None:
    lab = corner
    kill_in_mid_seal(lab)
    until(lambda: "action.unknown" in lab.types(), "a person is asked", 90.0)
    assert "its node has been gone for 60 s" in labos("resolve", "--home", str(lab.home)).stdout
