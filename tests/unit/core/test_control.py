"""Pausing and cancelling experiments, modules, workcells and the lab."""

from __future__ import annotations

import pytest

from labos.core.decide.control import CancelExperiment, CancelRuns, PauseStarts, ResumeStarts
from labos.core.decide.runs import SubmitRun
from labos.core.experiments import ExperimentCancelled
from labos.core.ids import RunId
from labos.core.runs import RunCancelled, RunCancelling
from tests.support.bench import CELL, Driver, needs, plan, route, small, step


def two_runs() -> tuple[Driver, str, str]:
    """One run on the camera, one that waits for it."""
    lab = small()
    flow = plan(step("cam"), step("dev"))
    first, second = lab.submit(flow), lab.submit(flow)
    lab.pump()
    return lab, first, second


@pytest.mark.parametrize("target", [CELL, "*", f"{CELL}/dev"])
def test_nothing_starts_where_it_is_paused(target: str) -> None:
    lab, first, _ = two_runs()
    lab.do(PauseStarts(target, "ada", "lunch"))
    lab.finish("A1")
    assert f"{first}#1" not in lab.pump()
    assert lab.code(first, 1) == "halted"
    assert lab.do(PauseStarts(target, "bo")) == []
    lab.do(ResumeStarts(target, "ada"))
    assert f"{first}#1" in lab.pump()
    assert lab.do(ResumeStarts(target, "ada")) == []
    lab.check_log()


def test_what_brings_a_module_back_may_start_all_the_same() -> None:
    lab = small()
    lab.do(PauseStarts("*", "ada"))
    run = lab.submit(plan(step("cam", recovers=True)))
    assert lab.pump() == [f"{run}#0"]


def test_of_a_paused_experiment_nothing_starts_but_others_go_on() -> None:
    lab = small()
    experiment = lab.experiment()
    mine, other = lab.submit(plan(step("cam")), experiment=experiment), lab.submit(plan(step("dev")))
    lab.do(PauseStarts(experiment, "ada"))
    assert lab.pump() == [f"{other}#0"]
    assert lab.code(mine) == "halted"
    lab.do(ResumeStarts(experiment, "ada"))
    assert lab.pump() == [f"{mine}#0"]
    lab.do(PauseStarts(experiment, "ada"))
    lab.finish(lab.list_flying()[-1])
    lab.end(experiment)
    assert lab.state.lab.paused == {}


def test_a_run_that_needs_a_paused_module_later_is_no_reason_to_wait() -> None:
    """It counts as an obstacle, as one does that needs a dead module."""
    lab = small()
    lab.do(PauseStarts(f"{CELL}/dev", "ada"))
    run = lab.submit(plan(step("cam"), step("dev", needs())))
    assert lab.pump() == []
    assert lab.code(run) == ""
    other = lab.submit(route("stack", "a", "trash"))
    assert lab.pump() == [f"{other}#0"]


def test_cancelling_a_module_means_the_runs_under_way_that_still_need_it() -> None:
    lab, first, second = two_runs()
    lab.do(CancelRuns(f"{CELL}/dev"))
    assert lab.run(first).status == "cancelling"
    assert lab.run(second).status == "queued"


def test_cancelling_a_workcell_means_those_too_that_wait() -> None:
    lab, first, second = two_runs()
    lab.do(CancelRuns(CELL))
    assert lab.state.runs.get(second) is None
    lab.finish("A1")
    assert lab.state.runs.get(first) is None


def test_the_reason_is_recorded_with_each_run_that_is_cancelled() -> None:
    lab, first, second = two_runs()
    lab.do(CancelRuns(CELL, why="spilled"))
    events = {entry.event.TYPE: entry.event for entry in lab.log}
    assert events["run.cancelling"] == RunCancelling(RunId(first), reason="spilled")
    assert events["run.cancelled"] == RunCancelled(RunId(second), "spilled")
    lab.finish("A1")
    assert lab.types()[-1] == "run.cancelled", "a reason to cancel is no reason to fail"


def test_the_reason_is_recorded_with_a_cancelled_experiment() -> None:
    lab = small()
    experiment = lab.experiment()
    lab.do(CancelExperiment(experiment, "ada", why="spilled"))
    (event,) = [entry.event for entry in lab.log if isinstance(entry.event, ExperimentCancelled)]
    assert event.why == "cancelled by ada: spilled"


def test_a_cancelled_experiment_closes_when_its_runs_have_ended() -> None:
    lab = small()
    experiment = lab.experiment(closing=route("a", "trash"))
    run = lab.submit(route("stack", "a", "b"), experiment=experiment)
    lab.pump()
    lab.do(CancelExperiment(experiment, "ada"))
    refused = lab.reject(SubmitRun(plan(step("cam")), "ada", experiment=experiment))
    assert refused.code == "no_experiment"
    assert lab.do(CancelExperiment(experiment, "ada")) == []
    lab.finish(lab.list_flying()[0])
    assert lab.state.runs.get(run) is None
    lab.pump()
    assert "experiment.closing" in lab.types()
    lab.finish(lab.list_flying()[0])
    assert lab.types()[-1] == "experiment.ended"
    lab.check_log()


@pytest.mark.parametrize("command", [PauseStarts("x", "ada"), ResumeStarts("x", "ada"), CancelRuns("x")])
def test_a_name_that_means_nothing_is_refused(command: PauseStarts | ResumeStarts | CancelRuns) -> None:
    assert small().reject(command).code == "no_target"


def test_an_experiment_that_is_not_there_is_refused() -> None:
    assert small().reject(CancelExperiment("E9", "ada")).code == "no_experiment"  # type: ignore[arg-type]
