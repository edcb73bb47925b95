"""Nodes join, leave, and say how they are."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.access import list_in_motion
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.nodes import (
    EndOutage,
    JoinNode,
    LoseNode,
    PutBack,
    RecordStops,
    ReportState,
    TakeOut,
)
from labos.core.decide.observation import ObserveStation
from labos.core.ids import ActionId, LabwareId, ModuleName, StationName
from labos.core.modules import Module
from labos.core.rules import NODE_AWAY_S
from labos.core.runs import DONE, IN_FLIGHT, PENDING, UNKNOWN
from tests.support.bench import SECOND, Driver, move, plan, small, small_cell, step, take

ARM, DEV = ModuleName("cell/arm"), ModuleName("cell/dev")
JOIN = JoinNode(DEV, "j2", "i2", "driver", "2", "about", "IDLE", simulated=True)


def dev(lab: Driver) -> Module:
    return lab.state.modules.by_name[DEV]


def test_the_first_node_is_kept_and_its_repetition_says_nothing() -> None:
    lab = small()
    assert lab.do(msgspec.structs.replace(JOIN, instance="i1")) == []
    refusal = lab.reject(JOIN)
    assert (refusal.code, refusal.message) == ("name_taken", "Two nodes claim the module dev.")
    assert "Stop one" in refusal.remedy


def test_after_a_loss_another_instance_may_join() -> None:
    lab = small()
    assert lab.do(LoseNode(DEV, "old instance", "silent")) == []
    lab.do(LoseNode(DEV, "i1", "silent"))
    assert (dev(lab).status, dev(lab).error) == ("GONE", "silent")
    assert lab.do(LoseNode(DEV, "i1", "silent")) == []
    assert lab.do(ReportState(DEV, "IDLE")) == []
    lab.do(JOIN)
    assert (dev(lab).status, dev(lab).error, dev(lab).journal, dev(lab).simulated) == ("IDLE", "", "j2", True)
    assert lab.do(LoseNode(ModuleName("cell/nix"), "i1", "silent")) == []


def test_a_node_needs_a_module_and_its_driver() -> None:
    lab = Driver(small_cell())
    lab.do(LoseNode(DEV, "i1", "silent"))
    refusal = lab.reject(msgspec.structs.replace(JOIN, driver="other"))
    assert refusal.code == "wrong_driver"
    assert "'other'" in refusal.message
    assert lab.reject(msgspec.structs.replace(JOIN, module=ModuleName("cell/nix"))).code == "no_module"


def test_only_transitions_that_no_action_explains_are_events() -> None:
    lab = small()
    assert lab.do(ReportState(DEV, "IDLE")) == []
    assert len(lab.do(ReportState(DEV, "BUSY"))) == 1
    assert lab.do(ReportState(DEV, "BUSY")) == []
    assert len(lab.do(ReportState(DEV, "ERROR", "jam"))) == 1
    assert dev(lab).error == "jam"
    assert len(lab.do(ReportState(DEV, "ERROR", "hot"))) == 1
    assert len(lab.do(ReportState(DEV, "IDLE"))) == 1
    run = lab.submit(plan(step("dev")))
    lab.start(run)
    assert lab.do(ReportState(DEV, "BUSY")) == []
    assert len(lab.do(ReportState(DEV, "ERROR", "jam"))) == 1
    assert lab.do(ReportState(ModuleName("cell/nix"), "BUSY")) == []


def test_a_module_is_taken_out_and_put_back() -> None:
    lab = small()
    assert lab.do(PutBack(DEV)) == []
    lab.do(TakeOut(DEV, ""))
    assert dev(lab).out_of_service == "no reason given"
    run = lab.submit(plan(step("dev")))
    assert lab.code(run) == "out_of_service"
    lab.do(PutBack(DEV))
    assert lab.code(run) == ""
    nix = ModuleName("cell/nix")
    assert lab.reject(TakeOut(nix, "x")).code == lab.reject(PutBack(nix)).code == "no_module"


# -- out of service until a time, stopped in an emergency --------------------------------------------


def test_a_module_comes_back_by_itself_when_its_time_has_come() -> None:
    lab = small()
    assert lab.reject(TakeOut(DEV, "service", lab.now, lab.now)).code == "past"
    until = lab.now + 60 * SECOND
    lab.do(TakeOut(DEV, "service", until, lab.now))
    run = lab.submit(plan(step("dev")))
    assert lab.pump() == []
    assert lab.scheduler.find_next_deadline(lab.state) == until
    lab.wait(59)
    assert lab.do(EndOutage(DEV, lab.now)) == []
    assert lab.pump() == []
    lab.wait(1)
    assert lab.pump() == [f"{run}#0"]
    assert dev(lab).out_of_service == ""
    assert lab.state.modules.back_at == {}
    assert lab.scheduler.find_next_deadline(lab.state) is None
    assert lab.do(EndOutage(DEV, lab.now)) == []
    lab.check_log()


def test_the_last_word_on_when_it_comes_back_counts() -> None:
    lab = small()
    lab.do(TakeOut(DEV, "service", lab.now + SECOND, lab.now))
    lab.do(TakeOut(DEV, "smoke"))
    lab.wait(2)
    lab.pump()
    assert dev(lab).out_of_service == "smoke"
    lab.do(TakeOut(DEV, "service", lab.now + SECOND, lab.now))
    lab.do(PutBack(DEV))
    assert lab.state.modules.back_at == {}


def test_an_emergency_stop_is_recorded_once_and_leaves_an_error() -> None:
    lab = small()
    stop = RecordStops("ada", {DEV: lab.now})
    lab.do(stop)
    assert (dev(lab).status, dev(lab).stopped_at) == ("ERROR", lab.now)
    assert dev(lab).error == "Stopped in an emergency by ada; reset the module to go on."
    assert lab.do(stop) == []
    assert lab.do(ReportState(DEV, "ERROR", dev(lab).error)) == []
    assert lab.do(ReportState(DEV, "IDLE")) != []
    assert lab.do(stop) == [], "told late, after its reset"
    lab.do(LoseNode(DEV, "i1", "silent"))
    lab.do(RecordStops("", {DEV: lab.now + 1}))
    assert dev(lab).status == "GONE"
    assert lab.do(RecordStops("ada", {ModuleName("cell/nix"): 1})) == []
    lab.check_log()


def test_an_action_whose_node_stays_away_is_asked_about() -> None:
    """A minute is enough for a node that somebody restarts; its journal's answer counts later, too."""
    lab = small()
    run = lab.submit(plan(step("dev"), step("dev")))
    lab.pump()
    (action,) = lab.state.actions.open
    lab.accept(action)
    lab.do(LoseNode(DEV, "i1", "silent"))
    lab.pump()
    assert lab.scheduler.find_next_deadline(lab.state) == lab.now + int(NODE_AWAY_S * SECOND) + 1
    lab.wait(NODE_AWAY_S)
    lab.pump()
    assert lab.questions() == []
    lab.wait(0.001)
    lab.pump()
    assert "its node has been gone for 60 s" in lab.question("unknown_action").text
    assert lab.scheduler.find_next_deadline(lab.state) is None
    lab.do(JOIN)
    lab.finish(action)
    assert lab.questions() == [], "the node has answered"
    assert lab.run(run).steps[0].status == DONE
    lab.check_log()


def give_up(timeout_s: float | None = None) -> tuple[Driver, str, ActionId]:
    """A plate is in motion, and its arm's node has been gone for a minute."""
    lab = small()
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"), timeout_s=timeout_s)))
    lab.step(run)
    action = lab.start(run, 1)
    lab.accept(action)
    arm = lab.state.modules.by_name[ARM]
    lab.do(LoseNode(ARM, arm.instance, "silent"))
    lab.wait(NODE_AWAY_S + 1)
    lab.pump()
    assert lab.question("unknown_action")
    lab.do(msgspec.structs.replace(JOIN, module=ARM))
    return lab, run, action


def test_a_node_that_comes_back_at_its_work_ends_the_question() -> None:
    """Who answered without looking would be believed, while the arm is still moving."""
    lab, run, action = give_up()
    assert [event.TYPE for event in lab.accept(action)] == ["action.accepted", "intervention.resolved"]
    assert lab.questions() == []
    assert lab.run(run).steps[1].status == IN_FLIGHT
    assert lab.state.bench.labware["P1"].maybe, "nobody has seen it"  # type: ignore[index]
    assert list_in_motion(lab.state, "cell") == ["arm"], "nobody is let in"
    assert "moving" in lab.reject(ObserveStation(StationName("cell/a"), "olga", count=1)).message
    assert lab.accept(action) == []
    lab.finish(action)
    assert lab.where("P1") == "b"
    lab.check_log()


def test_gone_again_it_is_asked_about_again() -> None:
    lab, run, action = give_up()
    lab.accept(action)
    lab.do(LoseNode(ARM, "i2", "silent"))
    lab.wait(NODE_AWAY_S + 1)
    lab.pump()
    lab.do(TakeOut(ARM, "switched off"))
    lab.answer(lab.question("unknown_action"), "not_done")
    assert (lab.where("P1"), lab.run(run).steps[1].status) == ("a", PENDING)
    lab.check_log()


def test_nobody_settles_what_a_node_that_is_away_may_still_do() -> None:
    """A request may be on its way to it, or it stands still in mid-action: it would be done after all."""
    lab, _, action = give_up()
    lab.do(LoseNode(ARM, "i2", "silent"))
    question = lab.question("unknown_action")
    for choice in ("done", "not_done", "gone"):
        refusal = lab.reject(ResolveIntervention(question.id, choice, "olga"))
        assert refusal.code == "node_gone"
        assert "labos out-of-service arm" in refusal.remedy
    lab.do(ObserveStation(StationName("cell/a"), "olga", labware=LabwareId("P1")))
    assert (lab.where("P1"), lab.question("unknown_action").id) == ("a", question.id)
    lab.do(msgspec.structs.replace(JOIN, module=ARM))
    lab.finish(action)
    assert (lab.questions(), lab.where("P1")) == ([], "b")
    lab.check_log()


@pytest.mark.parametrize(("place", "state"), [("a", PENDING), ("b", DONE), ("hotel", UNKNOWN)])
def test_what_was_seen_while_its_node_was_away_counts_when_that_knows_no_more(place: str, state: int) -> None:
    lab, run, action = give_up()
    lab.do(LoseNode(ARM, "i2", "silent"))
    lab.do(ObserveStation(StationName(f"cell/{place}"), "olga", labware=LabwareId("P1")))
    assert lab.question("unknown_action")
    assert lab.doubt(action) == [], "it is not back yet"
    lab.do(msgspec.structs.replace(JOIN, module=ARM))
    lab.doubt(action, "its node was restarted in mid-motion")
    assert (lab.where("P1"), lab.questions() == []) == (place, state != UNKNOWN)
    if state != DONE:
        assert lab.run(run).steps[1].status == state
    lab.check_log()


def test_what_was_seen_elsewhere_meanwhile_stays_there() -> None:
    lab, _, action = give_up()
    lab.do(ObserveStation(StationName("cell/c"), "olga", labware=LabwareId("P1")))
    lab.accept(action)
    lab.do(LoseNode(ARM, "i2", "silent"))
    lab.wait(NODE_AWAY_S + 1)
    lab.pump()
    assert "may be at" not in lab.question("unknown_action").text
    assert lab.where("P1") == "c"
    lab.check_log()


def test_what_takes_too_long_is_still_asked_about_when_its_node_comes_back() -> None:
    """It may well never end: only a person sees that."""
    lab, _, action = give_up(timeout_s=5.0)
    assert lab.accept(action) == []
    assert lab.question("unknown_action")
    lab.finish(action)
    assert (lab.questions(), lab.where("P1")) == ([], "b")
    lab.check_log()


def test_a_node_that_is_back_within_a_minute_goes_on() -> None:
    lab = small()
    lab.submit(plan(step("dev")))
    lab.pump()
    lab.do(LoseNode(DEV, "i1", "silent"))
    lab.wait(NODE_AWAY_S)
    lab.do(JOIN)
    lab.wait(NODE_AWAY_S)
    lab.pump()
    assert "action.unknown" not in lab.types()


def test_taken_out_of_service_a_module_without_a_node_is_not_waited_for() -> None:
    lab = small()
    run = lab.submit(plan(step("dev")))
    lab.pump()
    lab.do(LoseNode(DEV, "i1", "silent"))
    lab.do(TakeOut(DEV, "burnt", 0, lab.now))
    assert "the module was taken out of service" in lab.question("unknown_action").text
    lab.answer(lab.question("unknown_action"), "done")
    assert lab.state.runs.get(run) is None, "it has come to its end"
    lab.check_log()


def test_an_attempt_of_unknown_outcome_that_never_began_is_made_again() -> None:
    lab = small()
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b"))))
    lab.step(run)
    action = lab.start(run, 1)
    arm = ModuleName("cell/arm")
    lab.do(LoseNode(arm, lab.state.modules.by_name[arm].instance, "silent"))
    lab.wait(NODE_AWAY_S + 1)
    lab.pump()
    assert lab.state.bench.labware["P1"].maybe  # type: ignore[index]
    lab.refuse(action, final=False)
    assert lab.questions() == []
    assert lab.where("P1") == "a"
    assert lab.run(run).steps[1].status == PENDING
    lab.check_log()


def test_nobody_reaches_into_a_device_whose_node_died_in_mid_action() -> None:
    """Where it has stopped nobody knows, even when a person has said how its action ended."""
    lab = small()
    seal = lab.submit(plan(step("dev")))
    lab.pump()
    lab.do(LoseNode(DEV, "i1", "silent"))
    lab.do(TakeOut(DEV, "burnt", 0, lab.now))
    lab.answer(lab.question("unknown_action"), "done")
    assert lab.state.runs.get(seal) is None
    lab.do(PutBack(DEV))
    lab.stock("stack", 1)
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "dev.n1"))))
    lab.step(run)
    assert lab.code(run, 1) == "module_down"
    lab.do(JOIN)
    assert lab.code(run, 1) == ""
