"""An action that recovers: it may start in an error, and its success ends the error."""

from __future__ import annotations

import pytest

from labos.core.decide.nodes import LoseNode, ReportState, TakeOut
from labos.core.ids import ModuleName
from labos.core.model import Plan
from labos.core.modules import Module
from labos.core.plans import PlanStepsRecorded
from labos.core.registry import decode
from tests.support.bench import Driver, move, needs, plan, small, step, take

DEV = ModuleName("cell/dev")


def reset(on: str = "dev") -> Plan:
    return plan(step(on, action="reset", recovers=True), name=f"do {on}.reset")


def dev(lab: Driver) -> Module:
    return lab.state.modules.by_name[DEV]


@pytest.fixture
def lab() -> Driver:
    """A lab whose ``dev`` is in error."""
    lab = small()
    lab.do(ReportState(DEV, "ERROR", "jam"))
    return lab


def test_it_starts_in_an_error_and_ends_it(lab: Driver) -> None:
    other = lab.submit(plan(step("dev")))
    assert lab.code(other) == "module_down"
    run = lab.submit(reset())
    assert lab.pump() == [f"{run}#0"]
    lab.finish(next(iter(lab.state.actions.open)))
    assert (dev(lab).status, dev(lab).error) == ("IDLE", "")
    assert lab.pump() == [f"{other}#0"]
    lab.check_log()


def test_one_that_fails_leaves_the_error_and_fails_its_run(lab: Driver) -> None:
    run = lab.submit(reset())
    lab.pump()
    lab.fail(next(iter(lab.state.actions.open)), "none")
    assert dev(lab).status == "ERROR"
    assert lab.state.runs.get(run) is None
    assert lab.questions() == []


@pytest.mark.parametrize("final", [True, False])
def test_one_that_is_refused_is_not_tried_again(lab: Driver, final: bool) -> None:
    """It waits for no change of the module's status, so it would be tried for ever."""
    run = lab.submit(reset())
    lab.pump()
    lab.refuse(next(iter(lab.state.actions.open)), final=final)
    assert lab.state.runs.get(run) is None
    assert lab.pump() == []
    assert dev(lab).status == "ERROR"


def test_a_module_that_does_not_come_to_rest_may_be_recovered() -> None:
    lab = small()
    lab.do(ReportState(DEV, "BUSY"))
    assert lab.code(lab.submit(plan(step("dev")))) == "module_busy"
    assert lab.code(lab.submit(reset())) == ""


def test_it_waits_for_a_node_for_service_and_for_what_runs(lab: Driver) -> None:
    run = lab.submit(reset())
    lab.do(TakeOut(DEV, "smoke"))
    assert lab.code(run) == "out_of_service"
    lab.do(LoseNode(DEV, "i1", "silent"))
    arm = lab.submit(plan(step("arm")))
    lab.doubt(lab.start(arm))
    again = lab.submit(reset("arm"))
    lab.do(ReportState(ModuleName("cell/arm"), "ERROR", "jam"))
    assert lab.code(again) == "module_busy", "nobody knows yet what became of its action"
    lab.answer(lab.question(), "not_done")
    assert lab.code(again) == ""


def test_whoever_holds_the_module_does_not_keep_it_from_recovering() -> None:
    lab = small()
    holder = lab.submit(
        plan(
            step("arm", take("stack", "dev.n1")),
            step("dev", needs("dev.n1")),
            step("arm", move("dev.n1", "a")),
        )
    )
    lab.step(holder)
    lab.do(ReportState(DEV, "ERROR", "jam"))
    assert lab.pump() == []
    run = lab.submit(reset(), user="bob")
    assert lab.pump() == [f"{run}#0"]
    lab.finish(next(iter(lab.state.actions.open)))
    assert lab.pump() == [f"{holder}#1"]


def test_a_run_that_recovers_its_module_first_has_a_way_to_its_end(lab: Driver) -> None:
    run = lab.submit(
        plan(
            step("dev", action="reset", recovers=True),
            step("arm", take("stack", "dev.n1")),
            step("dev", needs("dev.n1")),
            step("arm", move("dev.n1", "a")),
        )
    )
    assert lab.pump() == [f"{run}#0"]


def test_it_does_not_reach_into_a_module_at_which_an_arm_is_at_work(lab: Driver) -> None:
    lab.do(ReportState(DEV, "IDLE"))
    carrier = lab.submit(plan(step("arm", take("stack", "dev.n1")), step("arm", move("dev.n1", "a"))))
    lab.start(carrier)
    lab.do(ReportState(DEV, "ERROR", "jam"))
    assert lab.code(lab.submit(reset())) == "reached_into"


def test_a_plan_of_before_there_were_recoveries_can_be_read() -> None:
    old = b'{"by":"R1","plan":"p","first":0,"steps":[{"key":"k","module":"c/m","action":"do"}]}'
    event = decode("plan.steps_recorded", 1, old)
    assert isinstance(event, PlanStepsRecorded)
    assert not event.steps[0].recovers
    taken = decode("module.taken_out", 1, b'{"module":"c/m","why":"smoke"}')
    assert getattr(taken, "until") == 0  # noqa: B009
