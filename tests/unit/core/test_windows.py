"""Windows: when their clocks start, whose clocks they are, and what a breach leads to."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.actions import FinishAction
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import BreachWindow, PauseRun, ResumeRun, SubmitRun
from labos.core.ids import ActionId, ExperimentId
from labos.core.model import Plan, Window
from labos.core.registry import decode
from labos.core.runs import PAST_KEPT, RunSubmitted
from tests.support.bench import SECOND, Driver, plan, route, small, step, take

HOUR = 3600.0


# -- device times ----------------------------------------------------------------------------------


def finish_at(lab: Driver, action: str, ended_ns: int) -> None:
    lab.do(FinishAction(ActionId(action), 1, True, "all", ended_ns=ended_ns))


def test_a_clock_starts_when_the_device_was_done_not_when_it_was_heard_of() -> None:
    lab = small()
    run = lab.submit(plan(step("dev"), step("cam", windows=(Window(0, wait_s=60.0),))))
    action = lab.start(run)
    lab.wait(100.0)
    finish_at(lab, action, lab.now - 50 * SECOND)
    assert lab.run(run).steps[0].ended_at == lab.now - 50 * SECOND
    assert lab.check_start(run, 1).until == lab.now + 10 * SECOND  # type: ignore[union-attr]
    lab.check_log()


@pytest.mark.parametrize("skew_s", [-200.0, 0.001, 3 * HOUR])
def test_a_time_that_cannot_be_is_not_believed(skew_s: float) -> None:
    """Before the request, or later than the log's own time."""
    lab = small()
    run = lab.submit(plan(step("dev"), step("cam")))
    action = lab.start(run)
    lab.wait(100.0)
    finish_at(lab, action, lab.now + int(skew_s * SECOND))
    assert lab.run(run).steps[0].ended_at == lab.now


def test_a_result_recorded_without_a_time_can_still_be_read() -> None:
    old = b'{"action":"A1","run":"R1","step":0,"module":"c/m","attempt":1,"result":null}'
    assert decode("action.succeeded", 1, old).ended_ns == 0  # type: ignore[attr-defined]


# -- clocks of other runs --------------------------------------------------------------------------


def incubate(name: str = "incubate") -> Plan:
    return plan(step("arm", take("stack", "a"), key="bring"), step("dev", key="put in"), name=name)


def read(of: str = "incubate", at: str = "put in", **window: object) -> Plan:
    limits = {"wait_s": 60.0, "within_s": 100.0, **window}
    return plan(step("cam", key="read", windows=(Window(None, of=of, of_step=at, **limits),)), name="read")  # type: ignore[arg-type]


def with_incubated() -> tuple[Driver, ExperimentId]:
    lab = small()
    experiment = lab.experiment()
    run = lab.submit(incubate(), experiment=experiment)
    lab.step(run, 0)
    lab.step(run, 1)
    return lab, experiment


def test_a_run_may_be_timed_from_a_step_of_a_run_before_it() -> None:
    lab, experiment = with_incubated()
    ended = lab.now
    lab.wait(30.0)
    run = lab.submit(read(), experiment=experiment)
    (anchor,) = lab.run(run).anchors
    assert (anchor.of, anchor.step, anchor.run, anchor.ended_at) == ("incubate", "put in", "R1", ended)
    wait = lab.check_start(run)
    assert (wait.code, wait.until) == ("too_early", ended + 60 * SECOND)  # type: ignore[union-attr]
    assert lab.pump() == []
    lab.wait(30.0)
    assert lab.pump() == [f"{run}#0"]
    lab.check_log()


def test_of_several_runs_the_last_one_of_the_workflow_is_meant_or_the_one_that_is_named() -> None:
    lab, experiment = with_incubated()
    for name in ("incubate", "other"):
        lab.wait(10.0)
        run = lab.submit(plan(step("dev", key="put in"), name=name), experiment=experiment)
        lab.step(run)
    last = lab.submit(read(), experiment=experiment)
    named = lab.submit(read("R1"), experiment=experiment)
    assert [lab.run(run).anchors[0].run for run in (last, named)] == ["R2", "R1"]
    assert lab.run(last).anchors[0].ended_at == lab.run(named).anchors[0].ended_at + 10 * SECOND
    assert len(lab.state.runs.queue) == 2, "their clocks differ, so they may not start alike"


def test_an_anchor_that_is_not_there_is_refused() -> None:
    lab, experiment = with_incubated()
    other = lab.experiment("another")

    def why(what: Plan, experiment: str) -> str:
        answer = lab.reject(SubmitRun(what, "ada", experiment=ExperimentId(experiment)))
        assert answer.code == "no_anchor"
        return answer.message + " " + answer.remedy

    assert "belongs to no experiment" in why(read(), "")
    assert "but no run of it has been completed in E2" in why(read(), other)
    assert "but no run of it has been completed in E1" in why(read("seal"), experiment)
    missing = why(read(at="take out"), experiment)
    assert "'take out', which is not a step of R1 (incubate)" in missing
    assert "'bring', 'put in'" in missing


def test_a_run_that_has_not_been_completed_is_no_anchor() -> None:
    lab = small()
    experiment = lab.experiment()
    run = lab.submit(incubate(), experiment=experiment)
    lab.step(run, 0)
    assert lab.reject(SubmitRun(read(), "ada", experiment=experiment)).code == "no_anchor"
    lab.fail(lab.start(run, 1), "none")
    assert lab.reject(SubmitRun(read(), "ada", experiment=experiment)).code == "no_anchor"


def test_a_closing_workflow_has_no_clock_of_another_run() -> None:
    answer = small().reject(StartExperiment("app", "ada", read()))
    assert (answer.code, "closing workflow 'read'" in answer.message) == ("no_anchor", True)


def test_what_is_past_is_kept_while_its_experiment_goes_on_but_not_without_end() -> None:
    lab, experiment = with_incubated()
    lab.careful = False
    for _ in range(PAST_KEPT + 20):
        lab.step(lab.submit(plan(step("dev"), name="loop"), experiment=experiment))
    past = lab.state.runs.past[experiment]
    assert len(past) == PAST_KEPT
    assert "R1" in past, "the last run of each workflow is kept"
    lab.check_log()
    lab.end(experiment)
    assert lab.state.runs.past == {}


def test_a_clock_runs_while_its_run_still_waits_outside() -> None:
    """The breach is written down though the run has not started; then it goes on as it says."""
    lab, experiment = with_incubated()
    run = lab.submit(read(on_breach="fail"), experiment=experiment)
    assert lab.do(BreachWindow(lab.run(run).id, 0, 0, lab.now))[0].TYPE == "window.breached"
    breach, end = (entry.event for entry in lab.log[-2:])
    assert (breach.of, breach.anchor) == ("R1", None)  # type: ignore[attr-defined]
    assert end.TYPE == "run.failed"
    assert end.why == "step 'read' did not start within 100 s of the end of 'put in' of run R1"  # type: ignore[attr-defined]
    assert not lab.state.runs.windowed
    lab.check_log()


def test_a_breach_outside_is_noticed_in_time() -> None:
    lab, experiment = with_incubated()
    lab.start(lab.submit(plan(step("cam", duration_s=1.0)), experiment=experiment))
    run = lab.submit(read(wait_s=0.0), experiment=experiment)
    lab.pump()
    assert lab.scheduler.find_next_deadline(lab.state) == lab.now + 100 * SECOND + 1
    lab.wait(100.1)
    lab.pump()
    assert lab.run(run).is_breached(0)
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{run}#0"]


def test_who_waits_outside_with_a_clock_running_goes_before_who_is_inside() -> None:
    lab, experiment = with_incubated()
    blocker = lab.start(lab.submit(plan(step("cam", duration_s=1.0))))
    lab.submit(plan(step("arm2", exclusive=False), step("cam", duration_s=1.0)))
    lab.step("R3")
    run = lab.submit(read(wait_s=0.0), experiment=experiment)
    lab.pump()
    lab.finish(blocker)
    assert lab.pump() == [f"{run}#0"]


def test_a_submission_of_before_there_were_such_clocks_can_still_be_read() -> None:
    old = (
        b'{"run":"R1","plan":"p","workflow":"f","user":"ada","experiment":"","priority":0,'
        b'"payload":{},"pins":{},"closing":false,"request":""}'
    )
    event = decode("run.submitted", 1, old)
    assert isinstance(event, RunSubmitted)
    assert event.anchors == ()


# -- breaches that ask -----------------------------------------------------------------------------


def late(on_breach: str = "ask") -> tuple[Driver, str]:
    """A run with a plate on the bench, one of whose steps is late."""
    lab = small()
    window = Window(1, within_s=5.0, on_breach=on_breach)  # type: ignore[arg-type]
    run = lab.submit(
        plan(
            step("arm", take("stack", "a")),
            step("dev", key="dose"),
            step("cam", key="read", windows=(window,)),
        )
    )
    lab.step(run, 0)
    lab.step(run, 1)
    lab.wait(6.0)
    lab.do(BreachWindow(lab.run(run).id, 2, 0, lab.now))
    return lab, run


def test_a_breach_may_ask_and_the_run_stands_still() -> None:
    lab, run = late()
    question = lab.question("late_step")
    assert question.text == (
        "Run R1 (flow): step 'read' did not start within 5 s of the end of 'dose'. The run has stopped."
    )
    assert [choice.name for choice in question.choices] == ["go_on", "fail"]
    assert all(choice.consequence.endswith(".") for choice in question.choices)
    assert lab.code(run, 2) == "paused"
    lab.wait(1000.0)
    assert lab.pump() == []
    assert lab.types().count("window.breached") == 1
    lab.check_log()


def test_go_on_lets_the_step_start_late() -> None:
    lab, run = late()
    lab.answer(lab.question(), "go_on")
    assert lab.pump() == [f"{run}#2"]
    lab.finish(lab.list_flying()[0])
    assert lab.types()[-1] == "run.completed"
    lab.check_log()


def test_fail_ends_the_run_and_asks_for_its_labware() -> None:
    lab, _ = late()
    lab.answer(lab.question(), "fail")
    assert [e.event.TYPE for e in lab.log[-4:]] == [
        "intervention.resolved",
        "labware.handed_over",
        "intervention.requested",
        "run.failed",
    ]
    assert lab.log[-1].event.why == "step 'read' was too late and was given up"  # type: ignore[attr-defined]
    assert lab.log[-1].event.kind == "experiment"  # type: ignore[attr-defined]
    assert lab.question().kind == "failed_run"
    lab.check_log()


@pytest.mark.parametrize("how", ["resume", "cancel"])
def test_a_question_about_a_late_step_answers_itself(how: str) -> None:
    lab, run = late()
    name = lab.run(run).id
    lab.do(ResumeRun(name) if how == "resume" else CancelRun(name))
    assert lab.questions("late_step") == []
    resolved = [e.event for e in lab.log if e.event.TYPE == "intervention.resolved"]
    assert [r.choice for r in resolved] == ["withdrawn"]  # type: ignore[attr-defined]
    if how == "resume":
        assert lab.pump() == [f"{run}#2"]
    lab.check_log()


def branches(on_breach: str) -> tuple[Driver, str, ActionId]:
    """Two steps with windows side by side, and one that is in flight."""
    lab = small()
    window = Window(0, within_s=5.0, on_breach=on_breach)  # type: ignore[arg-type]
    run = lab.submit(
        plan(
            step("dev", key="dose"),
            step("cam", key="one", after=(0,), windows=(window,)),
            step("cam", key="two", after=(0,), windows=(window,)),
            step("arm", take("stack", "a"), key="beside"),
            parallel=True,
        )
    )
    lab.step(run, 0)
    action = lab.start(run, 3)
    lab.wait(6.0)
    for index in (1, 2):
        lab.do(BreachWindow(lab.run(run).id, index, 0, lab.now))
    return lab, run, action


def test_a_run_goes_on_when_all_its_late_steps_are_answered_for() -> None:
    lab, run, _ = branches("ask")
    first, second = lab.questions("late_step")
    lab.answer(first, "go_on")
    assert lab.run(run).paused
    lab.answer(second, "go_on")
    assert not lab.run(run).paused
    assert lab.types().count("run.paused") == 1
    lab.check_log()


def test_giving_up_waits_for_what_is_in_flight() -> None:
    lab, run, action = branches("ask")
    first, second = lab.questions("late_step")
    lab.answer(first, "fail")
    assert lab.run(run).status == "cancelling"
    assert lab.answer(second, "go_on")[0].TYPE == "intervention.resolved"
    assert lab.run(run).paused
    lab.finish(action)
    assert lab.types()[-1] == "run.failed"
    lab.check_log()


def test_giving_up_withdraws_the_other_question() -> None:
    lab, run, action = branches("ask")
    lab.finish(action)
    first, _ = lab.questions("late_step")
    lab.answer(first, "fail")
    assert lab.questions("late_step") == []
    assert lab.state.runs.get(run) is None
    lab.check_log()


def test_a_run_that_was_paused_by_hand_is_asked_about_too() -> None:
    lab = small()
    window = Window(0, within_s=5.0, on_breach="ask")
    run = lab.submit(plan(step("dev"), step("cam", windows=(window,))))
    lab.step(run)
    lab.do(PauseRun(lab.run(run).id))
    lab.wait(6.0)
    lab.do(BreachWindow(lab.run(run).id, 1, 0, lab.now))
    assert lab.types().count("run.paused") == 1
    lab.answer(lab.question(), "go_on")
    assert not lab.run(run).paused


@pytest.mark.parametrize("on_breach", ["continue", "fail", "ask"])
def test_a_run_that_is_being_cancelled_ends_as_cancelled(on_breach: str) -> None:
    lab = small()
    window = Window(0, within_s=5.0, on_breach=on_breach)  # type: ignore[arg-type]
    beside = step("arm", take("stack", "a"), key="beside")
    timed = step("cam", after=(0,), windows=(window,))
    run = lab.submit(plan(step("dev"), timed, beside, parallel=True))
    lab.step(run)
    action = lab.start(run, 2)
    lab.do(CancelRun(lab.run(run).id))
    lab.wait(6.0)
    lab.pump()
    assert lab.types()[-1] == "window.breached"
    lab.finish(action)
    assert lab.types()[-1] == "run.cancelled"
    lab.check_log()


def test_a_window_of_a_step_that_has_started_is_not_breached() -> None:
    lab = small()
    window = Window(0, within_s=5.0, on_breach="fail")
    run = lab.submit(plan(step("dev"), step("cam", windows=(window,))))
    lab.step(run)
    lab.start(run, 1)
    lab.wait(6.0)
    assert lab.do(BreachWindow(lab.run(run).id, 1, 0, lab.now)) == []


def test_plans_of_before_there_was_ask_mean_the_same() -> None:
    old = b'{"anchor":0,"wait_s":0.0,"within_s":5.0,"on_breach":"continue"}'
    assert msgspec.json.decode(old, type=Window) == Window(0, 0.0, 5.0)


def test_what_is_asked_while_everybody_waits_blocks_nobody_else() -> None:
    """A run that stands still is an obstacle: others go round it."""
    lab, _ = late()
    other = lab.submit(route("stack", "b", "trash"))
    assert lab.pump() == [f"{other}#0"]
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{other}#1"]
