"""Experiments: what they leave parked is cleared away or handed over, never forgotten."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.control import CancelExperiment
from labos.core.decide.experiments import (
    EndExperiment,
    LoseExperiment,
    NoteExperiment,
    ResumeExperiment,
    StartExperiment,
)
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import StartKernel
from labos.core.decide.runs import SubmitRun
from labos.core.experiments import ExperimentCancelled, ExperimentEnded
from labos.core.fold import evolve
from labos.core.ids import ExperimentId, StationName
from labos.core.runs import REQUESTS_KEPT
from tests.support.bench import Driver, move, plan, route, small, step, take, unlid

CLOSING = route("a", "trash", name="clear")


def make_parked(**more: object) -> tuple[Driver, ExperimentId]:
    """An experiment whose plate P1 is parked at a."""
    lab = small()
    name = lab.experiment(**more)
    lab.step(lab.submit(route("stack", "a"), experiment=name))
    assert lab.owner("P1") == "experiment:E1"
    return lab, name


def test_one_key_is_one_experiment() -> None:
    lab = small()
    command = StartExperiment("app", "ada", CLOSING, request="k")
    lab.do(command)
    assert lab.do(command) == []
    assert lab.state.experiments.requests == {"k": "E1"}
    lab.do(StartExperiment("app", "ada", CLOSING))
    assert list(lab.state.experiments.open) == ["E1", "E2"]
    assert lab.types().count("plan.recorded") == 1


def test_one_that_is_cancelled_takes_no_more_runs_and_says_so() -> None:
    lab, name = make_parked(closing=CLOSING)
    run = lab.submit(route("stack", "b"), experiment=name)
    lab.start(run)
    lab.do(CancelExperiment(name, "ada"))
    refused = lab.reject(SubmitRun(route("stack", "c"), "ada", experiment=name))
    assert refused.message == "The experiment E1 is cancelled: it takes no more runs."


def test_the_last_thousand_keys_are_remembered() -> None:
    lab = small(stock=0)
    (event,) = lab.do(StartExperiment("app", "ada", request="k0"))
    for number in range(1, REQUESTS_KEPT + 1):
        again = msgspec.structs.replace(event, experiment=f"E{number + 1}", request=f"k{number}")
        evolve(lab.state, again, lab.state.position + 1, lab.now)
    assert len(lab.state.experiments.requests) == REQUESTS_KEPT
    assert "k0" not in lab.state.experiments.requests


def test_a_closing_workflow_that_could_never_run_is_refused() -> None:
    refusal = small().reject(StartExperiment("app", "ada", route("nowhere", "trash")))
    assert refusal.code == "no_station"


def test_notes_are_of_the_kinds_of_the_paper() -> None:
    lab = small()
    name = lab.experiment()
    lab.do(NoteExperiment(name, "decision", "stop", {"score": 0.5}))
    assert lab.log[-1].stream == name
    refusal = lab.reject(NoteExperiment(name, "gossip", "x"))
    assert refusal.code == "no_kind"
    assert "condition_checked" in refusal.remedy
    assert lab.reject(NoteExperiment(name, "decision", "x", {"nan": float("nan")})).code == "unfit"
    assert lab.reject(NoteExperiment(ExperimentId("E9"), "decision", "x")).code == "no_experiment"


def test_an_experiment_without_labware_ends_at_once() -> None:
    lab = small()
    name = lab.experiment(closing=CLOSING)
    assert [e.TYPE for e in lab.end(name)] == ["experiment.ended"]
    assert lab.state.runs.plans == {}
    assert lab.reject(EndExperiment(name)).code == "no_experiment"
    lab.check_log()


def test_without_a_closing_workflow_its_labware_goes_to_its_user() -> None:
    lab, name = make_parked()
    lab.end(name)
    assert lab.owner("P1") == "user:ada"
    assert lab.state.experiments.open == {}


def test_its_closing_workflow_clears_away_and_then_it_ends() -> None:
    lab, name = make_parked(closing=CLOSING, priority=3)
    lab.end(name)
    assert lab.state.experiments.open[name].status == "closing"
    assert lab.end(name) == []
    closing = lab.run("R2")
    assert (closing.closing, closing.workflow, closing.priority) == (True, "clear", 3)
    assert lab.reject(SubmitRun(CLOSING, "ada", experiment=name)).code == "no_experiment"
    lab.step("R2")
    assert lab.state.bench.labware == {}
    assert lab.log[-1].event.TYPE == "experiment.ended"
    lab.check_log()


def test_an_experiment_does_not_end_before_its_runs() -> None:
    lab, name = make_parked(closing=CLOSING)
    lab.submit(route("a", "b"), experiment=name)
    refusal = lab.reject(EndExperiment(name))
    assert (refusal.code, refusal.remedy) == ("runs_alive", "Wait for them or cancel them first.")
    lab.do(CancelRun(lab.run("R2").id))
    lab.end(name)
    assert lab.run("R3").closing


@pytest.mark.parametrize(
    "how", ["cancelled", "cancelled on its way", "cancelled with all", "failed", "completed"]
)
def test_what_a_closing_run_did_not_clear_away_goes_to_the_user(how: str) -> None:
    """Labware of an experiment that has ended could never be used by anybody."""
    lab = small()
    name = lab.experiment(closing=plan(step("arm", move("a", "b")), step("arm", move("b", "trash"))))
    for place in ("a", "c"):
        lab.step(lab.submit(route("stack", place), experiment=name))
    lab.end(name)
    closing = lab.run("R3").id
    if how != "cancelled":
        lab.step(closing)
    if how == "completed":
        lab.step(closing, 1)
    elif how == "failed":
        lab.fail(lab.start(closing, 1), "none")
    elif how == "cancelled with all":
        assert lab.do(CancelExperiment(name, "ada")) == []
        lab.do(CancelExperiment(name, "ada", stay=True))
    else:
        lab.do(CancelRun(closing))
    assert {item.owner for item in lab.state.bench.labware.values()} == {"user:ada"}
    assert lab.where("P2") == "c"
    assert lab.state.experiments.open == {}
    assert lab.state.runs.plans == {}
    lab.check_log()


# -- an application that is silent ----------------------------------------------------------------


def test_a_silent_application_is_asked_about_once() -> None:
    lab, name = make_parked(closing=CLOSING)
    lab.do(LoseExperiment(name, "no heartbeat"))
    assert lab.do(LoseExperiment(name, "no heartbeat")) == []
    question = lab.question("lost_experiment")
    assert "app (E1, ada) is silent: no heartbeat" in question.text
    lab.answer(question, "wait")
    assert lab.state.experiments.open[name].status == "open"
    lab.do(LoseExperiment(name, "no heartbeat"))
    lab.answer(lab.question(), "close")
    assert lab.run("R2").closing
    assert lab.do(LoseExperiment(name, "no heartbeat")) == []
    assert lab.do(LoseExperiment(ExperimentId("E9"), "x")) == []
    lab.step("R2")
    lab.check_log()


def test_it_is_not_closed_over_the_heads_of_its_runs() -> None:
    lab, name = make_parked(closing=CLOSING)
    run = lab.submit(route("a", "b", "a"), experiment=name)
    lab.step(run)
    action = lab.start(run, 1)
    lab.do(LoseExperiment(name, "no heartbeat"))
    refusal = lab.reject(ResolveIntervention(lab.question().id, "close", "person-1"))
    assert (refusal.code, refusal.message) == ("runs_alive", "The experiment E1 still has runs: R2.")
    lab.finish(action)
    lab.answer(lab.question(), "close")
    assert lab.run("R3").closing
    lab.check_log()


def test_an_application_that_comes_back_and_ends_takes_the_question_with_it() -> None:
    lab = small()
    name = lab.experiment()
    lab.do(LoseExperiment(name, "no heartbeat"))
    lab.end(name)
    assert lab.questions() == []
    lab.check_log()


def test_a_plate_whose_lid_is_taken_away_stays_where_it_is() -> None:
    lab = small()
    name = lab.experiment(closing=CLOSING, parking=(StationName("cell/a"),))
    what = plan(step("arm", take("stack", "b"), key="to b"), step("arm", unlid("b", "a")))
    refusal = lab.reject(SubmitRun(what, "ada", experiment=name))
    assert (refusal.code, "at b (step 'to b')" in refusal.message) == ("no_parking", True)


def test_runs_park_only_where_their_experiment_does() -> None:
    lab = small()
    assert lab.reject(StartExperiment("app", "ada", parking=(StationName("cell/x"),))).code == "no_station"
    name = lab.experiment(closing=CLOSING, parking=(StationName("cell/a"),))
    refusal = lab.reject(SubmitRun(route("stack", "a", "b"), "ada", experiment=name))
    assert (refusal.code, "at b (step 'to b')" in refusal.message) == ("no_parking", True)
    for way in (["stack", "a"], ["a", "b", "hotel"], ["stack", "b", "trash"], ["stack", "b", "a"]):
        lab.do(SubmitRun(route(*way), "ada", experiment=name))
    lab.submit(route("stack", "b"))  # of no experiment
    anywhere = lab.experiment("other")
    lab.submit(route("stack", "b"), experiment=anywhere)
    lab.check_log()


def test_one_that_an_earlier_version_left_open_closes_when_a_kernel_starts() -> None:
    lab = small()
    name = lab.experiment()
    lab.write(ExperimentCancelled(name, "it was cancelled"))
    assert name in lab.state.experiments.open
    lab.do(StartKernel(2, "0"))
    assert name not in lab.state.experiments.open
    lab.check_log()


# -- an application that is started again ---------------------------------------------------------


def test_one_that_is_started_again_takes_the_question_with_it() -> None:
    lab, name = make_parked(closing=CLOSING)
    lab.do(LoseExperiment(name, "no heartbeat"))
    assert [event.TYPE for event in lab.do(ResumeExperiment(name, "app"))] == [
        "experiment.resumed",
        "intervention.resolved",
    ]
    assert lab.questions() == []
    assert lab.owner("P1") == "experiment:E1"
    lab.check_log()


def test_only_an_experiment_that_is_open_is_resumed_and_only_by_its_name() -> None:
    lab, name = make_parked(closing=CLOSING)
    refusal = lab.reject(ResumeExperiment(name, "other"))
    assert (refusal.code, "is 'app', not 'other'" in refusal.message) == ("other_experiment", True)
    lab.end(name)
    assert "it is closing" in lab.reject(ResumeExperiment(name, "app")).message
    lab.step("R2")
    assert "it has ended" in lab.reject(ResumeExperiment(name, "app")).message


def test_what_is_noted_under_one_key_is_noted_once() -> None:
    lab = small()
    name = lab.experiment()
    note = NoteExperiment(name, "decision", "next", {"volumes": [1.0, 2.0]}, "decision next#1")
    lab.do(note)
    assert lab.do(note) == []
    other = msgspec.structs.replace(note, facts={"volumes": [1.0, 3.0]})
    assert lab.reject(other).code == "key_reused"
    lab.do(msgspec.structs.replace(other, key="decision next#2"))
    lab.do(msgspec.structs.replace(note, key=""))
    lab.do(msgspec.structs.replace(note, key=""))
    assert lab.types().count("experiment.noted") == 4
    lab.check_log()


def test_the_reason_of_one_that_has_nothing_to_clear_away_stands_in_its_end() -> None:
    lab = small()
    name = lab.experiment()
    lab.do(EndExperiment(name, "failed: KeyError: 'A1'"))
    assert lab.log[-1].event == ExperimentEnded(name, "", "failed: KeyError: 'A1'")
    name = lab.experiment()
    lab.do(LoseExperiment(name, "no heartbeat"))
    lab.answer(lab.question(), "close")
    ended = next(
        each.event
        for each in lab.log
        if isinstance(each.event, ExperimentEnded) and each.event.experiment == name
    )
    assert ended.why == "its application was lost"
