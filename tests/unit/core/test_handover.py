"""Labware changes hands, but not out of anybody's hands."""

from __future__ import annotations

from typing import Any

from labos.core.decide.handover import HandOver
from labos.core.ids import LabwareId, Owner
from tests.support.bench import Driver, plan, route, small, step


def give(to: str, by: str = "ada", **more: Any) -> HandOver:
    return HandOver(LabwareId("P1"), Owner(to), by, **more)


def make_parked(**more: Any) -> Driver:
    """P1 of ada stands at a."""
    lab = small()
    lab.step(lab.submit(route("stack", "a"), "ada", **more))
    return lab


def test_from_user_to_user_to_everybody() -> None:
    lab = make_parked()
    lab.do(give("user:bo"))
    assert lab.owner("P1") == "user:bo"
    assert lab.reject(give("shared")).code == "not_yours"
    lab.do(give("shared", "bo", note="left over"))
    assert lab.owner("P1") == "shared"
    assert lab.do(give("shared", "bo")) == []
    lab.do(give("user:eve", "eve"))
    assert lab.owner("P1") == "user:eve"
    lab.check_log()


def test_the_new_owners_runs_may_use_it_and_the_old_ones_may_not() -> None:
    lab = make_parked()
    his, hers = lab.submit(route("a", "b"), "bo"), lab.submit(route("a", "c"), "ada")
    assert (lab.code(his) == "", lab.code(hers) == "") == (False, True)
    lab.pump()
    assert lab.at("a") == ["P1"] or lab.state.actions.open
    lab = make_parked()
    his = lab.submit(route("a", "b"), "bo")
    assert lab.pump() == []
    lab.do(give("user:bo"))
    assert lab.pump() == [f"{his}#0"], "he was woken"
    assert not lab.find_missed()


def test_an_operator_may_by_force_and_says_why() -> None:
    lab = make_parked()
    assert lab.reject(give("user:bo", "eve")).code == "not_yours"
    assert lab.reject(give("user:bo", "eve", force=True)).code == "no_note"
    lab.do(give("user:bo", "eve", force=True, note="ada has left"))
    event = lab.log[-1].event
    assert (event.by, event.note) == ("eve", "ada has left")  # type: ignore[attr-defined]


def test_what_is_in_use_or_moving_is_given_by_nobody() -> None:
    lab = small()
    run = lab.submit(plan(*route("stack", "a").steps, step("dev")))
    lab.step(run)
    for force in (False, True):
        refusal = lab.reject(give("user:bo", force=force, note="x"))
        assert (refusal.code, run in refusal.message) == ("in_use", True)
    lab = make_parked()
    lab.start(lab.submit(route("a", "b"), "ada"))
    assert lab.reject(give("user:bo", force=True, note="x")).code == "in_use"


def test_into_an_open_experiment_and_out_of_it_by_its_user() -> None:
    lab = make_parked()
    experiment = lab.experiment("app", "bo")
    lab.do(give(f"experiment:{experiment}"))
    assert lab.reject(give("user:ada")).code == "not_yours"
    lab.do(give("user:ada", "bo"))
    lab.end(experiment)
    assert lab.reject(give(f"experiment:{experiment}")).code == "no_experiment"
    for to in ("", "run:R1", "user:", "nobody"):
        assert lab.reject(give(to)).code == "no_owner"


def test_what_a_closing_workflow_clears_away_stays_with_it() -> None:
    lab = small()
    experiment = lab.experiment(closing=route("a", "trash"))
    lab.step(lab.submit(route("stack", "a"), experiment=experiment))
    lab.end(experiment)
    assert lab.reject(give("user:ada")).code == "in_use"
    lab.step("R2")
    assert lab.state.bench.labware == {}
    lab.check_log()
