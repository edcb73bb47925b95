"""A step failed for good: the run fails, goes on without it, asks, or recovers."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.effects import AnyEffect
from labos.core.model import OnError, Plan, Retry
from labos.core.runs import DONE, FAILED, IN_FLIGHT, PENDING, SKIPPED, RunFailed
from tests.support.bench import Driver, module, move, plan, small, station, step, take, workcell


def lab_with(policy: OnError, *effects: AnyEffect, **more: object) -> tuple[Driver, str]:
    lab = small()
    return lab, lab.submit(plan(step("cam", *effects, on_error=policy, **more), step("dev")))  # type: ignore[arg-type]


def with_rescue(then: str = "fail", *, rescuers: int = 2) -> Plan:
    """Two steps; if the first fails, others are done on another module."""
    main = plan(step("cam", on_error=OnError("run", then)), step("dev"))  # type: ignore[arg-type]
    rescue = [
        msgspec.structs.replace(step("dev"), key=f"r{n}", part=0, after=(n + 1,) if n else ())
        for n in range(rescuers)
    ]
    return msgspec.structs.replace(main, steps=(*main.steps, *rescue))


def end(lab: Driver) -> RunFailed:
    event = lab.log[-1].event
    assert isinstance(event, RunFailed)
    return event


def test_a_skipped_step_keeps_nobody_waiting() -> None:
    lab, run = lab_with(OnError("skip", may_skip=True))
    lab.pump()
    lab.fail("A1", "none")
    assert lab.run(run).statuses == [SKIPPED, PENDING]
    assert lab.pump() == [f"{run}#1"]
    lab.finish("A2")
    assert lab.types()[-1] == "run.completed"
    lab.check_log()


def test_a_run_whose_last_step_is_skipped_is_complete() -> None:
    lab = small()
    lab.submit(plan(step("cam", on_error=OnError("skip", may_skip=True))))
    lab.pump()
    lab.fail("A1", "none")
    assert lab.types()[-2:] == ["step.skipped", "run.completed"]


@pytest.mark.parametrize("effects", ["partial", "unknown"])
@pytest.mark.parametrize("do", ["skip", "ask", "run"])
def test_where_it_is_not_known_what_was_done_the_run_fails(do: str, effects: str) -> None:
    lab, _ = lab_with(OnError(do, may_skip=True), take("stack", "a"))  # type: ignore[arg-type]
    lab.stock("stack", 1)
    lab.pump()
    lab.fail("A1", effects)
    assert lab.types()[-1] == "run.failed"
    assert lab.question("lost_labware")


def test_retries_come_first() -> None:
    lab, run = lab_with(OnError("skip", may_skip=True), retry=Retry(1))
    lab.pump()
    lab.fail("A1", "none")
    assert lab.run(run).steps[0].status == PENDING
    lab.pump()
    lab.fail("A2", "none")
    assert lab.run(run).steps[0].status == SKIPPED


def test_a_refusal_for_good_is_a_failure_too() -> None:
    lab, run = lab_with(OnError("skip", may_skip=True))
    lab.pump()
    lab.refuse("A1")
    assert lab.run(run).steps[0].status == SKIPPED


def test_a_person_is_asked_and_everything_after_it_waits() -> None:
    lab, run = lab_with(OnError("ask", may_skip=True))
    lab.pump()
    lab.fail("A1", "none")
    question = lab.question("failed_step")
    assert [choice.name for choice in question.choices] == ["retry", "skip", "fail"]
    assert "step 's0'" in question.text and "jam" in question.text  # noqa: PT018
    assert lab.pump() == []
    ((index, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    assert (index, wait.code, wait.blocked) == (0, "asked", True)
    lab.answer(question, "retry")
    assert lab.pump() == [f"{run}#0"]
    lab.fail("A2", "none")
    lab.answer(lab.question("failed_step"), "skip")
    assert lab.pump() == [f"{run}#1"]
    lab.finish("A3")
    assert lab.types()[-1] == "run.completed"
    lab.check_log()


def test_a_person_gives_it_up() -> None:
    lab, _ = lab_with(OnError("ask"))
    lab.pump()
    lab.fail("A1", "none")
    question = lab.question()
    assert [choice.name for choice in question.choices] == ["retry", "fail"], "it cannot be skipped"
    lab.answer(question, "fail")
    assert end(lab).why == "step 's0' failed and was given up by person-1"
    assert not lab.questions()


def test_what_was_done_all_the_same_is_not_done_again() -> None:
    lab, run = lab_with(OnError("ask"), take("stack", "a"))
    lab.stock("stack", 1)
    lab.pump()
    lab.fail("A1", "all")
    assert [choice.name for choice in lab.question().choices] == ["skip", "fail"]
    assert lab.at("a") == ["P1"]
    lab.answer(lab.question(), "skip")
    assert lab.pump() == [f"{run}#1"]


def test_a_cancelled_run_asks_nothing() -> None:
    lab, run = lab_with(OnError("ask"))
    lab.pump()
    lab.fail("A1", "none")
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    assert lab.types()[-2:] == ["run.cancelled", "intervention.resolved"]
    assert not lab.questions()
    lab, run = lab_with(OnError("ask"))
    lab.pump()
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.fail("A1", "none")
    assert not lab.questions("failed_step")
    assert run not in lab.state.runs.active


@pytest.mark.parametrize(("then", "last"), [("fail", "run.failed"), ("go_on", "run.completed")])
def test_recovery_steps_are_done_one_after_the_other(then: str, last: str) -> None:
    lab = small()
    run = lab.submit(with_rescue(then))
    assert lab.pump() == [f"{run}#0"]
    assert lab.run(run).statuses == [IN_FLIGHT, PENDING, SKIPPED, SKIPPED]
    lab.fail("A1", "none")
    assert lab.run(run).statuses == [FAILED, PENDING, PENDING, PENDING]
    assert lab.pump() == [f"{run}#2"]
    lab.finish("A2")
    assert lab.pump() == [f"{run}#3"]
    lab.finish("A3")
    if then == "go_on":
        assert lab.run(run).statuses == [SKIPPED, PENDING, DONE, DONE]
        assert lab.pump() == [f"{run}#1"]
        lab.finish("A4")
    else:
        assert "could not 'act': jam" in end(lab).why
    assert lab.types()[-1] == last
    lab.check_log()


def test_a_run_that_does_not_fail_needs_no_recovery() -> None:
    lab = small()
    lab.submit(with_rescue())
    lab.pump()
    lab.finish("A1")
    lab.pump()
    lab.finish("A2")
    assert lab.types()[-1] == "run.completed"


def test_a_recovery_that_fails_fails_the_run() -> None:
    lab = small()
    lab.submit(with_rescue("go_on"))
    lab.pump()
    lab.fail("A1", "none")
    lab.pump()
    lab.fail("A2", "none", error="worse")
    assert "worse" in end(lab).why


def test_two_runs_whose_recoveries_cross_are_not_let_in_together() -> None:
    lab = Driver(
        workcell(
            [module("arm"), module("one"), module("two")],
            [station("stack", "stack", 9), station("bin", "waste", 9), station("one.n"), station("two.n")],
        )
    )
    lab.stock("stack", 4)

    def make_crossing(here: str, there: str) -> Plan:
        main = plan(
            step("arm", take("stack", here)),
            step(here.partition(".")[0], on_error=OnError("run")),
            step("arm", move(here, "bin")),
        )
        over = msgspec.structs.replace(step("arm", move(here, there)), key="over", part=1)
        away = msgspec.structs.replace(step("arm", move(there, "bin")), key="away", part=1, after=(3,))
        return msgspec.structs.replace(main, steps=(*main.steps, over, away))

    first, second = lab.submit(make_crossing("one.n", "two.n")), lab.submit(make_crossing("two.n", "one.n"))
    assert lab.pump() == [f"{first}#0"]
    lab.finish("A1")
    assert lab.pump() == [f"{first}#1"], "the second would stand where the first may have to go"
    assert [wait.code for _, wait in lab.scheduler.list_waits(lab.state, lab.run(second), lab.now)] == [
        "unsafe"
    ]
    lab.finish("A2")
    assert lab.pump() == [f"{first}#2"], "its way is straight now, but the arm is busy"
    lab.finish("A3")
    assert lab.pump() == [f"{second}#0"]
