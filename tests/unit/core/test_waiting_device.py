"""A device that waits for somebody in the midst of an action is somebody's business."""

from __future__ import annotations

import pytest

from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.nodes import LoseNode, ReportState
from labos.core.ids import ActionId, ModuleName
from labos.core.interventions import InterventionRequested
from labos.core.rules import WAITS_S
from labos.planning.deadlines import Deadlines
from tests.support.bench import CELL, Driver, needs, plan, small, step

DEV = ModuleName(f"{CELL}/dev")
KIND = "device_waits"


def make_waiting_lab() -> tuple[Driver, ActionId]:
    """A device that pauses in the midst of a step, and says so."""
    lab = small()
    action = lab.start(lab.submit(plan(step("dev"), step("dev"))))
    lab.accept(action)
    lab.do(ReportState(DEV, "ERROR", "The run is paused."))
    return lab, action


def look_in(lab: Driver, seconds: float) -> list[object]:
    """What the kernel does about it after a while."""
    lab.wait(seconds)
    deadlines = Deadlines()
    return [event for command in deadlines.iterate_due(lab.state, lab.now) for event in lab.do(command)]


def test_somebody_is_told_once_and_the_step_goes_on() -> None:
    lab, action = make_waiting_lab()
    assert look_in(lab, WAITS_S - 1) == []
    (asked,) = look_in(lab, 2)
    assert isinstance(asked, InterventionRequested)
    assert (asked.kind, asked.run, asked.module) == (KIND, "R1", DEV)
    assert asked.text.startswith("dev has stopped during 'act' of R1: The run is paused.")
    assert look_in(lab, 1000) == []
    assert lab.state.modules.by_name[DEV].failures == []
    lab.do(ReportState(DEV, "BUSY"))
    assert lab.questions() == []
    lab.finish(action)
    lab.do(ReportState(DEV, "IDLE"))
    lab.step("R1", 1)
    lab.check_log()


def test_whoever_has_noted_it_is_not_asked_again_but_of_the_next_one() -> None:
    lab, action = make_waiting_lab()
    look_in(lab, WAITS_S + 1)
    lab.answer(lab.question(KIND), "noted")
    lab.do(ReportState(DEV, "ERROR", "The door is open."))
    assert look_in(lab, 1000) == []
    lab.do(ReportState(DEV, "BUSY"))
    lab.do(ReportState(DEV, "ERROR", "The run is paused."))
    assert len(look_in(lab, WAITS_S + 1)) == 1
    assert lab.reject(ResolveIntervention(lab.question(KIND).id, "done", "x")).code == "no_choice"
    lab.finish(action)
    assert lab.questions() == []
    lab.check_log()


@pytest.mark.parametrize("how", ["finished", "failed", "refused", "unknown", "gone"])
def test_the_question_ends_with_what_it_is_about(how: str) -> None:
    lab, action = make_waiting_lab()
    look_in(lab, WAITS_S + 1)
    assert lab.questions(KIND)
    match how:
        case "finished":
            lab.finish(action)
        case "failed":
            lab.fail(action)
        case "refused":
            lab.refuse(action)
        case "unknown":
            lab.doubt(action)
        case "gone":
            lab.do(LoseNode(DEV, "i1", "its power is off"))
    assert lab.questions(KIND) == []
    lab.check_log()


def test_an_error_without_an_action_in_its_midst_asks_nothing() -> None:
    lab = small()
    lab.do(ReportState(DEV, "ERROR", "jam"))
    assert look_in(lab, 1000) == []
    lab.stock("dev.n1", 1)
    run = lab.submit(plan(step("dev", needs("dev.n1"))))
    assert lab.code(run) == "module_down"


def test_an_action_that_was_never_taken_up_is_no_standstill() -> None:
    lab = small()
    lab.start(lab.submit(plan(step("dev"))))
    lab.do(ReportState(DEV, "ERROR", "jam"))
    assert look_in(lab, 1000) == []
