"""Planned work: asked for with its step, ended by a named person, late without harm."""

from __future__ import annotations

from labos.core.actions import ActionFailed, ActionSucceeded
from labos.core.decide.interventions import ResolveIntervention
from labos.core.ids import InterventionId
from labos.core.interventions import InterventionOverdue, InterventionResolved
from tests.support.bench import Driver, move, plan, small, step, take


def ask_person(*, feeds: tuple[int, ...] = (), **args: object) -> Driver:
    """A person is asked to carry a plate from ``a`` to ``b``."""
    lab = small()
    carry = step("arm", move("a", "b"), by_person=True, duration_s=300, args=args)
    lab.submit(plan(step("arm2", take("stack", "a")), carry, step("arm", move("b", "trash")), feeds=feeds))
    lab.step("R1", 0)
    lab.start("R1", 1)
    return lab


def confirm(lab: Driver, choice: str = "done", **more: object) -> ResolveIntervention:
    return ResolveIntervention(lab.question().id, choice, "ada", **more)  # type: ignore[arg-type]


def test_a_step_by_a_person_stands_in_the_inbox() -> None:
    lab = ask_person()
    entry = lab.question("planned_work")
    assert (entry.text, entry.run) == ("arm, please: carry P1 (plate) from a to b ('s1' of R1).", "R1")
    assert entry.due_at == lab.now + 300 * 10**9


def test_its_confirmation_is_its_end_and_moves_the_plate_in_one_batch() -> None:
    lab = ask_person()
    events = lab.do(confirm(lab))
    assert [type(e) for e in events[:2]] == [InterventionResolved, ActionSucceeded]
    assert lab.where("P1") == "b"
    assert not lab.state.actions.open
    assert lab.reject(ResolveIntervention(InterventionId("I1"), "done", "bo")).code == "no_intervention"
    lab.step("R1", 2)
    assert lab.types()[-1] == "run.completed"
    lab.check_log()


def test_what_the_node_says_of_it_later_changes_nothing() -> None:
    lab = ask_person()
    action = next(iter(lab.state.actions.open))
    lab.do(confirm(lab))
    assert lab.finish(action) == []
    assert lab.fail(action) == []


def test_it_cannot_be_done() -> None:
    lab = ask_person()
    events = lab.do(confirm(lab, "not_done", note="no hands"))
    failed = next(e for e in events if isinstance(e, ActionFailed))
    assert (failed.effects, failed.error) == ("none", "ada reports that it cannot be done: no hands")
    assert lab.where("P1") == "a"
    assert "run.failed" in lab.types()


def test_a_node_that_was_restarted_meanwhile_raises_no_doubt() -> None:
    lab = ask_person()
    action = next(iter(lab.state.actions.open))
    assert lab.doubt(action, "its node was restarted in mid-motion") == []
    lab.do(confirm(lab))
    assert lab.where("P1") == "b"


def test_a_simulated_person_confirms_by_the_node() -> None:
    lab = ask_person()
    events = lab.finish(next(iter(lab.state.actions.open)))
    assert InterventionResolved(InterventionId("I1"), "done", "cell/arm") in events
    assert lab.where("P1") == "b"


def test_what_is_late_is_told_once_and_fails_nothing() -> None:
    lab = ask_person(within=60.0)
    lab.pump()
    assert "intervention.overdue" not in lab.types()
    assert lab.scheduler.find_next_deadline(lab.state) == lab.question().due_at
    lab.wait(61)
    lab.pump()
    lab.pump()
    late = [entry.event for entry in lab.log if isinstance(entry.event, InterventionOverdue)]
    assert late == [InterventionOverdue(InterventionId("I1"), "R1", lab.question().due_at)]
    lab.do(confirm(lab))
    assert lab.where("P1") == "b"


def test_a_result_that_later_steps_read_has_to_be_told() -> None:
    lab = ask_person(feeds=(1,))
    assert lab.reject(confirm(lab)).code == "result_needed"
    lab.do(confirm(lab, result={"colour": "red"}))
    assert lab.results("R1") == {1: {"colour": "red"}}


def test_a_run_that_is_cancelled_waits_for_the_word() -> None:
    from labos.core.decide.cancelling import CancelRun
    from labos.core.ids import RunId

    lab = ask_person()
    lab.do(CancelRun(RunId("R1")))
    lab.do(confirm(lab))
    assert lab.types()[-1] == "run.cancelled"
    assert not lab.questions("planned_work")
