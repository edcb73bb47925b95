"""Runs from submission to their end; plans that are kept as long as somebody needs them."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.inputs import fill_inputs
from labos.core.decide.runs import (
    BreachWindow,
    PauseRun,
    ResumeRun,
    SubmitRun,
    plan_digest,
)
from labos.core.fold import evolve
from labos.core.ids import RunId
from labos.core.model import Plan, Window
from labos.core.runs import DONE, PENDING, REQUESTS_KEPT, queue_key
from tests.support.bench import (
    Driver,
    Refused,
    move,
    needs,
    plan,
    route,
    small,
    step,
    take,
)

QUERY = plan(step("dev"))


# -- submitting ------------------------------------------------------------------------------------


def test_a_run_waits_in_the_queue_of_its_class() -> None:
    lab = small()
    first, second = lab.submit(QUERY), lab.submit(QUERY)
    other = lab.submit(QUERY, user="bob")
    assert (first, second, other) == ("R1", "R2", "R3")
    shape = lab.state.runs.plans[plan_digest(QUERY)].shape
    assert [list(waiting) for waiting in lab.state.runs.queue.values()] == [["R1", "R2"], ["R3"]]
    assert queue_key(shape, lab.run(first)) == queue_key(shape, lab.run(second))
    assert lab.run(other).position == lab.state.position


def test_one_key_is_one_run() -> None:
    lab = small()
    command = SubmitRun(QUERY, "ada", request="k1")
    assert len(lab.do(command)) == 3
    assert lab.do(command) == []
    assert lab.state.runs.requests == {"k1": "R1"}
    assert len(lab.do(msgspec.structs.replace(command, request="k2"))) == 1


def test_the_last_thousand_keys_are_remembered() -> None:
    lab = small(stock=0)
    runs = lab.state.runs
    lab.do(SubmitRun(QUERY, "ada", request="k0"))
    event = lab.log[-1].event
    for number in range(1, REQUESTS_KEPT + 1):
        again = msgspec.structs.replace(event, run=f"R{number + 1}", request=f"k{number}")
        evolve(lab.state, again, lab.state.position + 1, lab.now)
    assert len(runs.requests) == REQUESTS_KEPT
    assert "k0" not in runs.requests
    assert f"k{REQUESTS_KEPT}" in runs.requests


@pytest.mark.parametrize(
    ("what", "code"),
    [
        (Plan("w", "cell", ()), "empty"),
        (msgspec.structs.replace(QUERY, workcell="moon"), "no_workcell"),
        (plan(step("laser")), "no_module"),
        (route("stack", "nowhere"), "no_station"),
        (plan(step("arm", move("a", "b", via="nowhere"))), "no_station"),
        (plan(step("dev", needs("nowhere"))), "no_station"),
        (plan(step("dev", after=(1,)), step("dev", after=(0,))), "cycle"),
        (plan(step("dev"), step("dev", after=(1,))), "cycle"),
        (plan(step("dev"), step("dev", after=(7,))), "cycle"),
        (plan(step("dev", windows=(Window(3, within_s=1.0),))), "no_anchor"),
        (plan(step("dev", args={"x": float("nan")})), "unfit"),
        (plan(step("dev", args={"x": "y" * 70_000})), "unfit"),
    ],
)
def test_plans_that_could_never_be_carried_out_are_refused(what: Plan, code: str) -> None:
    """Each of these would come back to the planner with every event there is."""
    lab = small()
    refusal = lab.reject(SubmitRun(what, "ada"))
    assert refusal.code == code
    assert lab.state.runs.plans == {}


@pytest.mark.parametrize("payload", [{"x": "y" * 70_000}, {"x": [float("inf")]}])
def test_a_payload_that_cannot_be_recorded_is_refused(payload: dict[str, Any]) -> None:
    refusal = small().reject(SubmitRun(QUERY, "ada", payload))
    assert refusal.code == "unfit"
    assert "file" in refusal.remedy


def test_steps_may_be_written_in_any_order() -> None:
    lab = small()
    backwards = plan(step("dev", key="last", after=(1,)), step("dev", key="first"), parallel=True)
    run = lab.submit(backwards)
    assert lab.state.runs.plans[plan_digest(backwards)].starts == (1,)
    assert lab.code(run, 0) == "after"
    lab.step(run, 1)
    lab.step(run, 0)
    assert not lab.state.runs.active


def test_a_run_of_an_experiment_belongs_to_its_user() -> None:
    lab = small()
    name = lab.experiment(user="ada")
    lab.submit(QUERY, user="eve", experiment=name)
    assert lab.run("R1").user == "ada"
    assert lab.reject(SubmitRun(QUERY, "ada", experiment="E9")).code == "no_experiment"  # type: ignore[arg-type]
    lab.do(CancelRun(RunId("R1")))
    lab.end(name)
    assert lab.reject(SubmitRun(QUERY, "ada", experiment=name)).code == "no_experiment"


# -- plans -----------------------------------------------------------------------------------------


def test_a_plan_lives_as_long_as_its_last_run_and_is_recorded_again_later() -> None:
    lab = small()
    name = plan_digest(QUERY)
    first, second = lab.submit(QUERY), lab.submit(QUERY)
    assert lab.types().count("plan.recorded") == 1
    assert lab.state.runs.plans[name].uses == 2
    lab.step(first)
    assert lab.state.runs.plans[name].uses == 1
    lab.do(CancelRun(second))
    assert lab.state.runs.plans == {}
    third = lab.submit(QUERY)
    assert lab.types().count("plan.recorded") == 2
    lab.step(third)
    assert lab.state.runs.plans == {}
    assert lab.state.runs.queue == {}
    lab.check_log()


def test_a_closing_plan_survives_its_runs_until_the_experiment_ends() -> None:
    lab = small()
    closing = route("a", "trash")
    name = lab.experiment(closing=closing)
    assert lab.state.runs.plans[plan_digest(closing)].uses == 1
    lab.stock("a", 1)
    lab.step(lab.submit(closing, experiment=name))
    assert lab.state.runs.plans[plan_digest(closing)].uses == 1
    lab.step(lab.submit(route("stack", "a"), experiment=name))
    lab.end(name)
    assert lab.state.runs.plans[plan_digest(closing)].uses == 2
    lab.step("R3")
    assert lab.state.runs.plans == {}
    assert lab.state.experiments.open == {}
    lab.check_log()


def test_a_long_plan_takes_several_events() -> None:
    lab = small()
    long = plan(*[step("dev", windows=(Window(0, wait_s=0.0),) if i == 20 else ()) for i in range(40)])
    run = lab.submit(long)
    assert lab.types().count("plan.steps_recorded") == 3
    known = lab.state.runs.plans[plan_digest(long)]
    assert known.complete
    assert (known.starts, known.windowed) == ((0,), (20,))
    assert known.plan == long
    for index in range(40):
        lab.step(run, index)
    assert lab.log[-1].event.steps == 40  # type: ignore[attr-defined]


# -- pausing, cancelling ---------------------------------------------------------------------------


def test_a_queued_run_changes_its_class_while_it_is_paused() -> None:
    lab = small()
    lab.submit(QUERY)
    run = lab.submit(QUERY)
    assert len(lab.state.runs.queue) == 1
    lab.do(PauseRun(run))
    assert lab.do(PauseRun(run)) == []
    assert len(lab.state.runs.queue) == 2
    assert lab.code(run) == "paused"
    lab.do(ResumeRun(run))
    assert lab.do(ResumeRun(run)) == []
    assert len(lab.state.runs.queue) == 1
    lab.do(PauseRun(run))
    lab.do(CancelRun(run))
    assert [list(waiting) for waiting in lab.state.runs.queue.values()] == [["R1"]]
    lab.check_log()


def test_an_active_run_is_paused_between_its_steps() -> None:
    lab = small()
    run = lab.submit(plan(step("dev"), step("dev")))
    action = lab.start(run)
    lab.do(PauseRun(run))
    lab.finish(action)
    assert lab.code(run, 1) == "paused"
    lab.do(ResumeRun(run))
    lab.step(run, 1)
    assert lab.log[-1].event.TYPE == "run.completed"


@pytest.mark.parametrize("command", [PauseRun, ResumeRun, CancelRun])
def test_runs_that_are_not_there(command: Any) -> None:
    refusal = small().reject(command("R9"))
    assert (refusal.code, refusal.message) == ("no_run", "There is no run R9 that has not ended.")


def test_a_run_between_steps_is_cancelled_at_once_and_its_labware_shown() -> None:
    lab = small()
    run = lab.submit(route("stack", "a", "b"))
    lab.step(run)
    lab.do(CancelRun(run))
    assert lab.owner("P1") == "user:ada"
    question = lab.question("failed_run")
    assert "It left P1 at a." in question.text
    assert question.labware == ("P1",)
    assert lab.log[-1].event.TYPE == "run.cancelled"


def test_labware_left_in_a_store_is_in_nobodys_way() -> None:
    lab = small()
    run = lab.submit(plan(step("arm", take("stack", "hotel")), step("dev")))
    lab.step(run)
    lab.do(CancelRun(run))
    assert lab.questions() == []
    assert lab.owner("P1") == "user:ada"


def test_a_completion_wins_the_race_with_a_cancellation() -> None:
    lab = small()
    run = lab.submit(route("stack", "a"))
    action = lab.start(run)
    lab.do(CancelRun(run))
    assert lab.do(CancelRun(run)) == []
    assert lab.run(run).status == "cancelling"
    lab.finish(action)
    assert lab.log[-1].event.TYPE == "run.completed"
    assert lab.at("a") == ["P1"]


def test_a_cancelled_run_ends_when_what_is_in_flight_has_ended() -> None:
    lab = small()
    run = lab.submit(route("stack", "a", "b"))
    action = lab.start(run)
    lab.do(CancelRun(run))
    assert lab.code(run, 1) == "cancelling"
    lab.finish(action)
    assert lab.log[-1].event.TYPE == "run.cancelled"
    assert lab.owner("P1") == "user:ada"
    lab.check_log()


def test_a_cancelled_run_waits_for_what_is_unknown_too() -> None:
    lab = small()
    run = lab.submit(plan(step("dev"), step("dev")))
    action = lab.start(run)
    lab.doubt(action)
    lab.do(CancelRun(run))
    assert lab.run(run).status == "cancelling"
    lab.answer(lab.question(), "not_done")
    assert lab.log[-1].event.TYPE == "run.cancelled"


# -- handing over ----------------------------------------------------------------------------------


def test_a_completed_run_hands_its_labware_to_its_user_without_a_question() -> None:
    lab = small()
    lab.step(lab.submit(route("stack", "a")))
    assert lab.owner("P1") == "user:ada"
    assert lab.questions() == []
    assert lab.log[-2].event.TYPE == "labware.handed_over"


def test_a_run_of_an_experiment_hands_its_labware_to_the_experiment() -> None:
    lab = small()
    name = lab.experiment()
    lab.step(lab.submit(route("stack", "a"), experiment=name))
    assert lab.owner("P1") == "experiment:E1"
    again = lab.submit(route("a", "b"), experiment=name)
    lab.start(again)
    assert lab.owner("P1") == f"run:{again}"


# -- windows ---------------------------------------------------------------------------------------


def make_windowed(on_breach: str, wait: float = 0.0) -> Plan:
    window = Window(0, wait_s=wait, within_s=5.0, on_breach=on_breach)  # type: ignore[arg-type]
    return plan(
        step("dev", key="first"),
        step("arm", take("stack", "a"), key="beside"),
        step("dev", key="timed", after=(0,), windows=(window,)),
        parallel=True,
    )


def test_a_step_waits_its_time_in_lab_seconds() -> None:
    lab = small()
    lab.state.lab.pace = 2.0
    run = lab.submit(make_windowed("continue", wait=4.0))
    assert lab.code(run, 2) == "after"
    lab.step(run)
    wait = lab.check_start(run, 2)
    assert wait.code == "too_early"  # type: ignore[union-attr]
    assert wait.until == lab.now + 2_000_000_000  # type: ignore[union-attr]
    lab.wait(2.0)
    assert lab.code(run, 2) == ""


def test_a_breach_is_an_event_and_the_run_goes_on() -> None:
    lab = small()
    run = lab.submit(make_windowed("continue"))
    assert lab.do(BreachWindow(run, 2, 0, lab.now)) == []
    lab.step(run)
    lab.wait(6.0)
    lab.do(BreachWindow(run, 2, 0, lab.now))
    event = lab.log[-1].event
    assert (event.TYPE, event.step, event.anchor, event.within_s) == ("window.breached", 2, 0, 5.0)  # type: ignore[attr-defined]
    assert lab.do(BreachWindow(run, 2, 0, lab.now)) == []
    lab.step(run, 2)
    lab.step(run, 1)
    assert lab.log[-1].event.TYPE == "run.completed"


def test_a_breach_may_fail_the_run() -> None:
    lab = small()
    run = lab.submit(make_windowed("fail"))
    lab.step(run)
    lab.wait(6.0)
    lab.do(BreachWindow(run, 2, 0, lab.now))
    end = lab.log[-1].event
    assert (end.TYPE, end.kind) == ("run.failed", "experiment")  # type: ignore[attr-defined]
    assert "'timed' did not start within 5 s" in end.why  # type: ignore[attr-defined]


def test_a_breach_waits_for_what_is_in_flight_before_the_run_fails() -> None:
    """Else the action's later events would open the run's stream anew."""
    lab = small()
    run = lab.submit(make_windowed("fail"))
    lab.step(run)
    action = lab.start(run, 1)
    lab.wait(6.0)
    lab.do(BreachWindow(run, 2, 0, lab.now))
    assert lab.run(run).status == "cancelling"
    lab.finish(action)
    end = lab.log[-1].event
    assert end.TYPE == "run.failed"
    assert "did not start within" in end.why  # type: ignore[attr-defined]
    assert lab.owner("P1") == "user:ada"
    lab.check_log()


# -- arguments from results ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reference", "found"),
    [
        ([0], {"x": [1, 2], "y": {"z": 3}}),
        ([0, "x"], [1, 2]),
        ([0, "x", 1], 2),
        ([0, "x", "1"], 2),
        ([0, "y", "z"], 3),
    ],
)
def test_results_of_earlier_steps_feed_later_arguments(reference: list[Any], found: Any) -> None:
    results = {0: {"x": [1, 2], "y": {"z": 3}}}
    args = {"given": {"a": 1}, "v": {"$result": reference}}
    assert fill_inputs(QUERY, results, args) == {"given": {"a": 1}, "v": found}


@pytest.mark.parametrize(
    "reference", [[0, "q"], [0, "x", 9], [0, "x", "q"], [0, "y", "z", "deep"], [0, "n", "m"]]
)
def test_a_reference_that_leads_nowhere_is_named(reference: list[Any]) -> None:
    results = {0: {"x": [1, 2], "y": {"z": 3}, "n": None}}
    answer = fill_inputs(QUERY, results, {"v": {"$result": reference}})
    assert isinstance(answer, str)
    assert answer.startswith("v: the result of step 's0' has no ")


def make_plan_with_use(beside: bool = False) -> Plan:
    steps = [
        step("dev", key="measure"),
        step("dev", key="use", after=(0,), args={"v": {"$result": [0, "od"]}}),
    ]
    if beside:
        steps.append(step("arm", take("stack", "a"), key="beside"))
    return plan(*steps, parallel=True, feeds=(0,))


def test_only_results_that_are_needed_are_kept() -> None:
    lab = small()
    run = lab.submit(make_plan_with_use(beside=True))
    lab.step(run, 0, {"od": 0.7})
    lab.step(run, 2, {"not": "needed"})
    assert lab.results(run) == {0: {"od": 0.7}}
    lab.start(run, 1)
    assert lab.log[-1].event.args == {"v": 0.7}  # type: ignore[attr-defined]


def test_a_step_that_cannot_be_filled_in_fails_its_run() -> None:
    lab = small()
    run = lab.submit(make_plan_with_use())
    lab.step(run, 0, {"other": 1})
    lab.start(run, 1)
    end = lab.log[-1].event
    assert end.TYPE == "run.failed"
    assert end.why == "step 'use' cannot be filled in: v: the result of step 'measure' has no 'od'"  # type: ignore[attr-defined]


def test_it_fails_only_after_what_is_in_flight() -> None:
    lab = small()
    run = lab.submit(make_plan_with_use(beside=True))
    lab.step(run, 0, {"other": 1})
    action = lab.start(run, 2)
    lab.start(run, 1)
    assert lab.run(run).status == "cancelling"
    lab.finish(action)
    assert "cannot be filled in" in lab.log[-1].event.why  # type: ignore[attr-defined]
    lab.check_log()


def test_files_are_pinned_to_the_action_that_names_them() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", args={"p": "a.py"}), step("dev"), files={"a.py": "d1", "b.py": "d2"}))
    lab.start(run)
    assert lab.log[-1].event.files == {"a.py": "d1"}  # type: ignore[attr-defined]


# -- keeping count ---------------------------------------------------------------------------------


def test_lab_time_used_counts_half_after_a_day() -> None:
    lab = small()
    run = lab.submit(QUERY)
    action = lab.start(run)
    lab.wait(10)
    lab.finish(action)
    usage = lab.state.shares.usage["ada"]
    assert usage.used_ns == 10e9
    assert usage.compute_level(lab.now) == 10e9
    assert usage.compute_level(lab.now + 24 * 3600 * 10**9) == pytest.approx(5e9)


def test_a_run_counts_its_steps_and_when_they_ended() -> None:
    lab = small()
    run = lab.submit(plan(step("dev"), step("dev")))
    assert lab.state.runs.get("R1") is lab.run(run)
    lab.step(run)
    assert lab.run(run).statuses == [DONE, PENDING]
    assert lab.run(run).steps[0].ended_at == lab.now
    assert lab.run(run).started_at == lab.now
    with pytest.raises(Refused, match="not_pending"):
        lab.start(run, 0)


def test_a_run_that_is_not_there_cannot_start() -> None:
    lab: Driver = small()
    assert lab.reject(lab.start_command("R9", 0)).code == "no_run"
