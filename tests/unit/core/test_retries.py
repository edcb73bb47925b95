"""A step that failed is done again: when, how often, and when not. Actions that do not end."""

from __future__ import annotations

import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.model import Retry
from labos.core.runs import DONE, PENDING
from tests.support.bench import SECOND, Driver, move, plan, requires, sets, small, step, take


def lab_with(*effects: object, times: int = 2, delay_s: float = 30.0, **more: object) -> tuple[Driver, str]:
    lab = small()
    retry = Retry(times, delay_s)
    return lab, lab.submit(plan(step("cam", *effects, retry=retry, **more), step("dev")))  # type: ignore[arg-type]


def test_a_step_that_did_nothing_is_done_again_after_its_delay() -> None:
    lab, run = lab_with()
    assert lab.pump() == [f"{run}#0"]
    lab.fail("A1", "none")
    assert lab.run(run).steps[0].status == PENDING
    assert lab.run(run).steps[0].retries == 1
    assert lab.pump() == []
    wait = lab.check_start(run)
    assert (wait.code, wait.until) == ("retry_later", lab.now + 30 * SECOND)  # type: ignore[union-attr]
    assert lab.scheduler.find_next_deadline(lab.state) == lab.now + 30 * SECOND
    lab.wait(30.0)
    assert lab.find_missed() == [f"{run}#0"]
    assert lab.pump() == [f"{run}#0"], "the clock alone wakes it"
    lab.finish("A2")
    assert lab.run(run).steps[0].status == DONE
    lab.check_log()


def test_after_the_last_try_the_run_fails() -> None:
    lab, run = lab_with(delay_s=0.0)
    for number in (1, 2, 3):
        assert lab.pump() == [f"{run}#0"]
        lab.fail(f"A{number}", "none")
    assert lab.types().count("step.retried") == 2
    assert lab.types()[-1] == "run.failed"
    lab.check_log()


@pytest.mark.parametrize(
    ("effects", "safe", "done", "again"),
    [
        ((), False, "none", True),
        ((), False, "unknown", False),
        ((), True, "unknown", True),
        ((), True, "partial", True),
        ((sets("lid", "shut"),), True, "partial", True),
        ((requires("lid", False), sets("lid", "shut")), True, "partial", False),
        ((take("stack", "a"),), True, "partial", False),
        ((take("stack", "a"),), False, "none", True),
    ],
)
def test_only_what_did_nothing_or_may_be_repeated_is_done_again(
    effects: tuple[object, ...], safe: bool, done: str, again: bool
) -> None:
    lab, run = lab_with(*effects, safe_to_repeat=safe)
    action = lab.start(run)
    lab.fail(action, done)
    assert ("step.retried" in lab.types()) == again
    assert ("run.failed" in lab.types()) != again
    lab.check_log()


def test_a_motion_that_did_not_begin_is_done_again_with_the_same_labware() -> None:
    lab = small()
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"), retry=Retry(1))))
    lab.step(run)
    lab.fail(lab.start(run, 1), "none")
    assert lab.where("P1") == "a"
    assert lab.pump() == [f"{run}#1"]
    lab.finish("A2" if "A2" in lab.state.actions.open else "A3")
    assert lab.types()[-1] == "run.completed"
    lab.check_log()


def test_a_run_that_is_being_cancelled_tries_nothing_again() -> None:
    lab, run = lab_with()
    action = lab.start(run)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.fail(action, "none")
    assert "step.retried" not in lab.types()
    assert lab.types()[-1] == "run.failed"


def test_plans_that_differ_in_their_retries_differ_in_shape() -> None:
    lab, _ = lab_with(times=1)
    lab.submit(plan(step("cam", retry=Retry(2, 30.0)), step("dev")))
    assert len(lab.state.runs.queue) == 2


def test_an_action_that_does_not_end_in_its_time_is_unknown_and_not_failed() -> None:
    lab = small()
    run = lab.submit(plan(step("cam", timeout_s=600.0), step("dev")))
    lab.pump()
    (action,) = lab.state.actions.open
    due = lab.now + 600 * SECOND
    assert lab.scheduler.find_next_deadline(lab.state) == due + 1
    lab.wait(600.0)
    lab.pump()
    assert "action.unknown" not in lab.types()
    lab.wait(1.0)
    lab.pump()
    question = lab.question("unknown_action")
    assert "it did not end within 600 s" in question.text
    assert lab.scheduler.find_next_deadline(lab.state) is None
    lab.finish(action)
    assert lab.questions() == [], "the node has answered"
    assert lab.run(run).steps[0].status == DONE
    lab.check_log()


def test_a_person_who_is_late_is_not_asked_a_second_time() -> None:
    """The inbox entry is the question; another one about the same work could be answered otherwise."""
    lab = small()
    lab.submit(plan(step("cam", timeout_s=600.0, by_person=True), step("dev")))
    lab.pump()
    lab.wait(601.0)
    lab.pump()
    assert "action.unknown" not in lab.types()
    assert [question.kind for question in lab.questions()] == ["planned_work"]
    deadline = lab.scheduler.find_next_deadline(lab.state)
    assert deadline is None or deadline > lab.now


def test_a_motion_that_does_not_end_makes_its_labware_uncertain() -> None:
    lab = small()
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"), timeout_s=5.0)))
    lab.step(run)
    lab.start(run, 1)
    lab.wait(6.0)
    lab.pump()
    assert lab.state.bench.labware["P1"].maybe  # type: ignore[index]
    lab.answer(lab.question("unknown_action"), "not_done")
    assert lab.pump() == [f"{run}#1"], "it is done again"
    lab.check_log()
