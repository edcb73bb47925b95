"""A person answers."""

from __future__ import annotations

import pytest

from labos.core.decide.access import EndAccess, GrantAccess, ReportedChange, RequestAccess
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.observation import ObserveStation
from labos.core.decide.stock import UnloadStation
from labos.core.ids import SHARED, InterventionId, LabwareId, StationName
from labos.core.labware import LabwarePlaced
from tests.support.bench import Driver, move, plan, route, small, small_cell, station, step


def test_only_open_questions_and_offered_choices() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(route("a", "b"))
    lab.doubt(lab.start(run))
    question = lab.question()
    assert lab.reject(ResolveIntervention(InterventionId("I9"), "done", "x")).code == "no_intervention"
    refusal = lab.reject(ResolveIntervention(question.id, "maybe", "x"))
    assert (refusal.code, refusal.remedy) == ("no_choice", "Choose one of: done, not_done, gone.")
    lab.answer(question, "done")
    assert lab.reject(ResolveIntervention(question.id, "done", "x")).code == "no_intervention"


def test_ids_count_up_over_all_questions() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("c", 1)
    for source, target in [("a", "b"), ("c", "hotel")]:
        lab.doubt(lab.start(lab.submit(route(source, target, arm="arm" if source == "a" else "arm2"))))
    assert [q.id for q in lab.questions()] == ["I1", "I2"]
    assert lab.state.interventions.find_about(lab.question_of("I2").subject) is lab.question_of("I2")


def test_what_a_failed_run_left_is_carried_away_or_stays() -> None:
    for choice, count in [("removed", 0), ("leave", 1)]:
        lab = small()
        run = lab.submit(plan(*route("stack", "a").steps, step("dev")))
        lab.step(run)
        lab.refuse(lab.start(run, 1))
        lab.answer(lab.question("failed_run"), choice)
        assert len(lab.state.bench.labware) == count
        assert len(lab.at("a")) == count
        lab.check_log()


def test_labware_that_is_in_motion_again_or_gone_is_not_carried_away() -> None:
    lab = small()
    run = lab.submit(plan(*route("stack", "a").steps, step("dev")))
    lab.step(run)
    lab.refuse(lab.start(run, 1))
    question = lab.question("failed_run")
    again = lab.submit(route("a", "b"))
    action = lab.start(again)
    lab.answer(question, "removed")
    lab.finish(action)
    assert lab.where("P1") == "b"
    lab.check_log()


def test_two_motions_of_one_action_are_found_together() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    run = lab.submit(plan(step("arm", move("a", "c"), move("b", "hotel"))))
    lab.fail(lab.start(run))
    question = lab.question("lost_labware")
    assert "Where is P1, P2 now?" in question.text
    lab.answer(question, "target")
    assert (lab.where("P1"), lab.where("P2")) == ("c", "hotel")
    lab.check_log()


def test_an_answer_that_cannot_be_true_is_refused() -> None:
    """A plate is put where another might stand only by somebody who does not ask the log."""
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(route("a", "b"))
    lab.fail(lab.start(run))
    question = lab.question("lost_labware")
    lab.write(LabwarePlaced(LabwareId("P7"), "", "plate", StationName("cell/b"), SHARED))
    refusal = lab.reject(ResolveIntervention(question.id, "target", "x"))
    assert (refusal.code, refusal.message) == (
        "occupied",
        "cell/b is full (P7): the labware cannot stand there.",
    )
    lab.answer(question, "source")
    assert lab.where("P1") == "a"


def in_the_hand() -> Driver:
    """A motion failed half-way, and the arm says that it holds the plate."""
    hand = station("arm.gripper", "gripper")
    lab = Driver(small_cell(stations=[*small_cell().stations, hand]))
    lab.stock("a", 1)
    lab.fail(lab.start(lab.submit(route("a", "b"))))
    lab.do(ObserveStation(hand.name, "arm", 1))
    assert lab.question("lost_labware")
    return lab


def test_what_was_unloaded_out_of_a_hand_meanwhile_is_no_riddle() -> None:
    lab = in_the_hand()
    lab.do(UnloadStation(StationName("cell/arm.gripper"), "ada"))
    assert lab.questions("lost_labware") == []
    assert (lab.at("a"), lab.at("b"), lab.at("arm.gripper")) == ([], [], [])
    lab.check_log()


@pytest.mark.parametrize(("station", "what"), [("b", "P1"), ("arm.gripper", "empty"), ("b", "plate")])
def test_what_somebody_who_reached_in_put_elsewhere_is_no_riddle(station: str, what: str) -> None:
    lab = in_the_hand()
    lab.do(RequestAccess("cell", "ada"))
    lab.do(GrantAccess("cell"))
    lab.do(EndAccess("cell", "ada", "", (ReportedChange(StationName(f"cell/{station}"), what),)))
    assert len(lab.questions("lost_labware")) == (what == "plate"), "that is another one"
    lab.check_log()


def test_a_question_about_two_plates_waits_for_the_second() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    run = lab.submit(plan(step("arm", move("a", "c")), step("arm", move("b", "a")), step("dev")))
    lab.finish(lab.start(run))
    lab.finish(lab.start(run, 1))
    lab.fail(lab.start(run, 2), "none")
    assert set(lab.question("failed_run").labware) == {"P1", "P2"}
    lab.do(UnloadStation(StationName("cell/c"), "ada"))
    assert lab.question("failed_run")
    lab.do(UnloadStation(StationName("cell/a"), "ada"))
    assert lab.questions("failed_run") == []
    lab.check_log()


@pytest.mark.parametrize("how", ["answered", "the node says so", "refused"])
def test_what_was_in_doubt_and_not_moved_is_shown_when_its_run_ends(how: str) -> None:
    """It stands in the way as it does after a failure that nobody doubted."""
    lab = small()
    run = lab.submit(route("stack", "a", "b"))
    lab.step(run)
    action = lab.start(run, 1)
    lab.doubt(action)
    lab.do(CancelRun(run))
    if how == "answered":
        lab.answer(lab.question("unknown_action"), "not_done")
    elif how == "refused":
        lab.refuse(action)
    else:
        lab.fail(action, "none")
    assert lab.at("a") == ["P1"]
    assert lab.question().labware == ("P1",)
    lab.answer(lab.question("failed_run"), "removed")
    assert lab.at("a") == []
