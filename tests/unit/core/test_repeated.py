"""What is asked for once more while it is so already changes nothing, and its reason is kept."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from labos.core.decide import Command
from labos.core.decide.access import RequestAccess
from labos.core.decide.campaigns import CancelCampaign, PauseCampaign, SubmitCampaign, SubmitRow
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.control import CancelExperiment, CancelRuns, PauseStarts
from labos.core.decide.runs import PauseRun
from labos.core.ids import CampaignId, ExperimentId, RunId
from labos.core.repeated import RequestRepeated
from tests.support.bench import CELL, Driver, plan, route, small, step

R1, E1, C1 = RunId("R1"), ExperimentId("E1"), CampaignId("C1")

REQUESTS: dict[str, tuple[Callable[[str], Command], str, str]] = {
    "cancel a run": (lambda why: CancelRun(R1, why=why), R1, "cancel"),
    "cancel a workcell": (lambda why: CancelRuns(CELL, why=why), R1, "cancel"),
    "cancel an experiment": (lambda why: CancelExperiment(E1, "ada", why=why), E1, "cancel"),
    "cancel a campaign": (lambda why: CancelCampaign(C1, why=why), C1, "cancel"),
    "pause a run": (lambda why: PauseRun(R1, why), R1, "pause"),
    "pause a module": (lambda why: PauseStarts(f"{CELL}/dev", "ada", why), f"{CELL}/dev", "pause"),
    "pause a campaign": (lambda why: PauseCampaign(C1, why), C1, "pause"),
    "ask for access": (lambda why: RequestAccess(CELL, "ada", why), CELL, "access"),
}
"""How it is asked for, what the word that is kept is about, and what it says was asked for."""


def lab_at_work() -> Driver:
    """A run in flight, one that waits, an experiment with labware to clear away, and a campaign."""
    lab = small()
    lab.submit(plan(step("cam"), step("dev")))
    lab.submit(plan(step("cam")))
    lab.experiment(closing=route("a", "trash"))
    lab.submit(route("stack", "a", "b"), experiment=E1)
    lab.do(SubmitCampaign("screen", "ada", "flow", CELL, 3, "t", "d"))
    lab.do(SubmitRow(C1, 0, plan(step("arm2"))))
    lab.pump()
    return lab


@pytest.mark.parametrize("name", REQUESTS)
def test_its_reason_is_kept_and_nothing_changes(name: str) -> None:
    ask, subject, what = REQUESTS[name]
    lab = lab_at_work()
    assert lab.do(ask("spilled"))
    before = lab.state.bench, lab.run(R1).status, lab.state.lab.paused, lab.list_flying()
    again = lab.do(ask("wrong plate"))
    assert RequestRepeated(subject, what, "wrong plate") in again
    assert {type(event) for event in again} == {RequestRepeated}
    assert (lab.state.bench, lab.run(R1).status, lab.state.lab.paused, lab.list_flying()) == before
    lab.check_log()


@pytest.mark.parametrize("name", REQUESTS)
def test_without_a_reason_there_is_nothing_to_keep(name: str) -> None:
    ask, _, _ = REQUESTS[name]
    lab = lab_at_work()
    lab.do(ask("spilled"))
    assert lab.do(ask("")) == []


def test_a_run_on_its_way_out_goes_on_with_it() -> None:
    """Another reason to cancel is no reason to begin the way out anew."""
    lab = lab_at_work()
    lab.do(CancelRun(R1))
    lab.do(CancelRun(R1, why="spilled"))
    assert lab.run(R1).status == "cancelling"
    stay = lab.do(CancelRun(R1, stay=True, why="leave it"))
    assert [event.TYPE for event in stay] == ["run.cancelling"]
