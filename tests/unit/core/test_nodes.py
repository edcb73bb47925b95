"""Nodes join, leave, and say how they are."""

from __future__ import annotations

import msgspec

from labos.core.decide.nodes import DiscoverAction, JoinNode, LoseNode, PutBack, ReportState, TakeOut
from labos.core.ids import ActionId, ModuleName
from labos.core.modules import Module
from tests.support.bench import Driver, plan, small, small_cell, step

DEV = ModuleName("cell/dev")
JOIN = JoinNode(DEV, "j2", "i2", "driver", "2", "about", "IDLE", simulated=True)


def dev(lab: Driver) -> Module:
    return lab.state.modules.by_name[DEV]


def test_the_first_node_is_kept_and_its_repetition_says_nothing() -> None:
    lab = small()
    assert lab.do(msgspec.structs.replace(JOIN, instance="i1")) == []
    refusal = lab.refused(JOIN)
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
    refusal = lab.refused(msgspec.structs.replace(JOIN, driver="other"))
    assert refusal.code == "wrong_driver"
    assert "'other'" in refusal.message
    assert lab.refused(msgspec.structs.replace(JOIN, module=ModuleName("cell/nix"))).code == "no_module"


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
    assert lab.refused(TakeOut(nix, "x")).code == lab.refused(PutBack(nix)).code == "no_module"


def test_an_action_that_the_log_does_not_know_stops_the_module_and_asks() -> None:
    lab = small()
    found = DiscoverAction(DEV, ActionId("A99"), "spin", "finished")
    lab.do(found)
    assert "does not" in dev(lab).out_of_service
    question = lab.question("discovered_action")
    assert question.module == DEV
    assert lab.do(found) == []
    lab.answer(question, "checked")
    assert dev(lab).out_of_service == ""
    assert (
        lab.refused(msgspec.structs.replace(found, module=ModuleName("cell/nix"), action="A98")).code
        == "no_module"
    )
    run = lab.submit(plan(step("dev")))
    action = lab.start(run)
    assert lab.do(DiscoverAction(DEV, action, "act", "running")) == []
    lab.check_log()
