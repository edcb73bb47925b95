"""Results decide: a step is left out, or its result is not as expected."""

from __future__ import annotations

import msgspec
import pytest

from labos.core import conditions
from labos.core.conditions import fill_in, find_decision, holds
from labos.core.expressions import ExpressionError, parse_expression
from labos.core.model import Condition, OnError, Plan
from labos.core.runs import DONE, FAILED, PENDING, SKIPPED, RunFailed
from tests.support.bench import Driver, move, plan, small, step, take


def condition(text: str) -> Condition:
    return conditions.make_condition(text, parse_expression(text))


def make_choice(*texts: str, feeds: tuple[int, ...] = (0,)) -> Plan:
    """A step that measures, and one for each condition."""
    later = [msgspec.structs.replace(step("dev"), when=condition(text)) for text in texts]
    return msgspec.structs.replace(plan(step("cam"), *later), feeds=feeds)


@pytest.mark.parametrize(("value", "done"), [(2, [DONE, PENDING, SKIPPED]), (0, [DONE, SKIPPED, PENDING])])
def test_a_result_decides_which_steps_are_done(value: float, done: list[int]) -> None:
    lab = small()
    run = lab.submit(make_choice("steps.s0.x > 1", "not steps.s0.x > 1"))
    lab.pump()
    lab.finish("A1", {"x": value})
    if value == 0:
        assert lab.run(run).statuses == done
    lab.pump()
    lab.finish("A2")
    assert lab.types()[-1] == "run.completed"
    assert lab.types().count("step.skipped") == 1
    lab.check_log()


def test_a_run_of_which_nothing_is_left_to_do_is_complete() -> None:
    lab = small()
    lab.submit(make_choice("steps.s0.x > 1", "steps.s0.x > 2"))
    lab.pump()
    lab.finish("A1", {"x": 0})
    assert lab.types()[-3:] == ["step.skipped", "step.skipped", "run.completed"]


def test_what_cannot_be_decided_fails_the_run_and_says_why() -> None:
    lab = small()
    lab.submit(make_choice("steps.s0.x > 1"))
    lab.pump()
    lab.finish("A1", {"y": 0})
    event = lab.log[-1].event
    assert isinstance(event, RunFailed)
    assert event.kind == "experiment"
    assert event.why == "the condition of step 's1' cannot be evaluated: There is no 'x' in steps.s0."


def test_a_condition_is_true_or_false_and_nothing_else() -> None:
    assert holds(condition("1 < 2"), {})
    with pytest.raises(ExpressionError, match="neither true nor false"):
        holds(condition("1 + 2"), {})


def make_expecting(policy: OnError | None = None) -> tuple[Driver, str]:
    lab = small()
    first = step("cam", expect=condition("0 < result.x <= 1"), on_error=policy)
    run = lab.submit(plan(first, step("dev"), feeds=(0,)))
    lab.pump()
    return lab, run


def test_a_result_as_expected_goes_on() -> None:
    lab, run = make_expecting()
    lab.finish("A1", {"x": 0.5})
    assert lab.pump() == [f"{run}#1"]


@pytest.mark.parametrize("result", [{"x": 2}, {"y": 0.5}, None])
def test_a_result_out_of_range_is_an_experiment_error(result: object) -> None:
    lab, _ = make_expecting()
    lab.finish("A1", result)
    event = lab.log[-1].event
    assert isinstance(event, RunFailed)
    assert event.kind == "experiment"
    assert "expected 0 < result.x <= 1" in event.why
    assert lab.types().count("step.unexpected") == 1
    lab.check_log()


def test_a_result_out_of_range_follows_on_error() -> None:
    lab, run = make_expecting(OnError("ask", may_skip=True))
    lab.finish("A1", {"x": 2})
    assert lab.run(run).statuses == [FAILED, PENDING]
    assert lab.pump() == []
    lab.answer(lab.question("failed_step"), "retry")
    assert lab.pump() == [f"{run}#0"]
    lab.finish("A2", {"x": 1})
    assert lab.results(run) == {0: {"x": 1}}
    lab, run = make_expecting(OnError("skip", may_skip=True))
    lab.finish("A1", {"x": 2})
    assert lab.run(run).statuses == [SKIPPED, PENDING]
    assert not lab.results(run), "nobody reads what was not as it should be"


def test_what_was_carried_there_is_not_carried_again() -> None:
    lab = small()
    lab.stock("stack", 1)
    first = step("arm", take("stack", "a"), expect=condition("result.ok"), on_error=OnError("ask"))
    lab.submit(plan(first, step("arm", move("a", "b"))))
    lab.pump()
    lab.finish("A1", {"ok": False})
    assert [choice.name for choice in lab.question().choices] == ["skip", "fail"]


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("steps.s.x > 1", "not (steps.s.x > 1)", False),
        ("steps.s.x > 1", "steps.s.x <= 1", False),
        ("steps.s.x > 1", "not steps.s.x <= 1", True),
        ('steps.s.x in ["a"]', 'steps.s.x not in ["a"]', False),
    ],
)
def test_opposite_conditions_decide_the_same(first: str, second: str, same: bool) -> None:
    one, other = find_decision(condition(first)), find_decision(condition(second))
    assert one[0] == other[0]
    assert (one[1] == other[1]) == same


def test_names_are_filled_in_wherever_they_stand() -> None:
    tree = parse_expression("not (len([payload.x, 2]) + -payload.x * 2 > payload.x) and payload.x in [1]")
    filled = fill_in(tree, {("payload", "x"): ("value", 1)})
    assert holds(conditions.make_condition("", filled), {}) is True
