"""A device says that it is done, and an observer looks: what is believed, and what follows."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.actions import ActionFailed, ActionReported
from labos.core.decide.actions import DoubtAction, FinishAction
from labos.core.decide.nodes import LoseNode, TakeOut
from labos.core.decide.observation import ObserveStation
from labos.core.decide.verification import VerifyAction
from labos.core.ids import ActionId, LabwareId, ModuleName, StationName
from labos.core.labware import StationObserved
from labos.core.model import OnError, Plan, Retry, Verify
from labos.core.registry import Event
from labos.core.runs import RunFailed
from tests.support.bench import Driver, full, module, move, plan, route, small_cell, station, step, workcell


def make_watched(verify: Verify = "always", *, places: tuple[str, ...] = ("a", "b", "shelf")) -> Driver:
    """Two arms with hands, nests and a shelf; ``cam`` looks at some of them."""
    more = {"observer": ModuleName(full("cam")), "verify": verify}
    stations = [
        station("stack", "stack", 9, **(more if "stack" in places else {})),
        *(station(name, **(more if name in places else {})) for name in ("a", "b", "c")),
        station("shelf", "hotel", 3, **(more if "shelf" in places else {})),
        station("trash", "waste", 4),
        station("arm.gripper", "gripper"),
        station("arm2.gripper", "gripper"),
    ]
    return Driver(workcell([module("arm"), module("arm2"), module("cam")], stations))


def see(lab: Driver, action: str, unseen: str = "", **counts: Any) -> list[Event]:
    seen = tuple(
        StationObserved(StationName(full(place)), "cam", labware=LabwareId(what))
        if isinstance(what, str)
        else StationObserved(StationName(full(place)), "cam", what)
        for place, what in counts.items()
    )
    return lab.do(VerifyAction(ActionId(action), seen, unseen))


def maybe(lab: Driver, name: str = "P1") -> list[str]:
    return [p.removeprefix("cell/") for p in lab.state.bench.labware[LabwareId(name)].maybe]


def find_failure(lab: Driver, run: str) -> RunFailed | None:
    found = [e.event for e in lab.log if isinstance(e.event, RunFailed) and e.event.run == run]
    return found[0] if found else None


def carry_plate(lab: Driver, what: Plan | None = None) -> tuple[str, ActionId]:
    """An arm that says that P1 has gone from a to b."""
    lab.stock("a", 1)
    run = lab.submit(what or route("a", "b", "c"))
    action = lab.start(run)
    (reported,) = lab.finish(action)
    assert isinstance(reported, ActionReported)
    assert lab.where("P1") == "a", "it is not believed yet"
    return run, action


def test_what_is_seen_to_be_done_is_believed() -> None:
    lab = make_watched()
    run, action = carry_plate(lab)
    assert {p.removeprefix("cell/") for p in lab.state.actions.open[action].looks} == {"a", "b"}
    see(lab, action, a=0, b=1)
    assert lab.where("P1") == "b"
    assert lab.questions() == []
    lab.step(run, 1)  # from b, which is watched, to c
    see(lab, "A2", b=0)
    assert lab.where("P1") == "c"
    assert "run.completed" in lab.types()
    lab.check_log()


def test_what_arrived_is_believed_whatever_else_stands_at_its_source() -> None:
    lab = make_watched()
    _, action = carry_plate(lab)
    see(lab, action, a=1, b=1)
    assert lab.where("P1") == "b"
    lab.do(ObserveStation(StationName(full("a")), "cam", 1))
    assert "where nothing should stand" in lab.question("contradiction").text
    lab.check_log()


def test_a_plate_that_did_not_arrive_is_lost_and_only_it() -> None:
    lab = make_watched()
    run, action = carry_plate(lab)
    lab.stock("c", 1)
    other = lab.submit(route("c", "shelf", arm="arm2"))
    events = see(lab, action, a=0, b=0)
    failed = next(e for e in events if isinstance(e, ActionFailed))
    assert (failed.kind, failed.effects) == ("operational", "unknown")
    assert "cam saw nothing at b" in failed.error
    assert maybe(lab) == ["arm.gripper", ""], "it may have fallen down"
    over = find_failure(lab, run)
    assert over is not None
    assert over.kind == "operational"
    assert [c.name for c in lab.question("lost_labware").choices] == ["gone", "source", "target"]
    assert lab.code(other) == "", "others go on"
    mine = lab.submit(route("c", "b"))
    assert lab.code(mine) == "uncertain", "its hand may be full"
    lab.do(ObserveStation(StationName(full("arm.gripper")), "arm", 0))
    assert maybe(lab) == [""], "what fell down stands nowhere"
    lab.answer(lab.question("lost_labware"), "gone")
    assert "P1" not in lab.state.bench.labware
    assert lab.code(mine) == ""
    lab.check_log()


def test_a_plate_that_never_left_is_carried_again_where_the_workflow_says_so() -> None:
    lab = make_watched()
    again = step("arm", move("a", "b"), retry=Retry(2))
    run, action = carry_plate(lab, plan(again))
    see(lab, action, a=1, b=0)
    assert lab.where("P1") == "a"
    assert "step.retried" in lab.types()
    action = lab.start(run)
    lab.finish(action)
    see(lab, action, a=0, b=1)
    assert "run.completed" in lab.types()
    lab.check_log()


def test_without_a_retry_a_plate_that_never_left_ends_its_run() -> None:
    lab = make_watched()
    run, action = carry_plate(lab)
    see(lab, action, a=1, b=0)
    over = find_failure(lab, run)
    assert over is not None
    assert over.kind == "operational"
    assert lab.where("P1") == "a"
    assert [q.kind for q in lab.questions()] == ["failed_run"]
    lab.check_log()


@pytest.mark.parametrize(("choice", "place"), [("done", "b"), ("not_done", "a"), ("gone", None)])
def test_who_wants_to_be_asked_is_asked(choice: str, place: str | None) -> None:
    lab = make_watched()
    steps = (step("arm", move("a", "b"), on_error=OnError("ask")), step("arm", move("b", "c")))
    run, action = carry_plate(lab, plan(*steps))
    see(lab, action, a=0, b=0)
    assert find_failure(lab, run) is None
    question = lab.question("unknown_action")
    assert "P1 may be at: arm.gripper, nowhere on the bench" in question.text
    lab.answer(question, choice)
    if place is None:
        assert "P1" not in lab.state.bench.labware
        assert find_failure(lab, run) is not None
    else:
        assert lab.where("P1") == place
        assert lab.code(run, 1 if choice == "done" else 0) == ""
    lab.check_log()


def test_what_nobody_can_see_nobody_knows() -> None:
    lab = make_watched()
    _, action = carry_plate(lab)
    see(lab, action, "cam is dark", a=0)
    assert maybe(lab) == ["arm.gripper", "b", ""]
    assert "cam is dark" in lab.question("unknown_action").text
    # Where all else is seen empty it stands at b only if it was seen there.
    lab.do(ObserveStation(StationName(full("arm.gripper")), "arm", 0))
    assert maybe(lab) == ["b", ""]
    lab.do(ObserveStation(StationName(full("b")), "cam", 1))
    assert (lab.where("P1"), lab.questions()) == ("b", [])
    lab.check_log()


def test_a_watched_place_is_not_concluded_by_elimination() -> None:
    lab = make_watched()
    lab.stock("a", 1)
    action = lab.start(lab.submit(route("a", "b", "c")))
    lab.doubt(action)
    lab.do(ObserveStation(StationName(full("arm.gripper")), "arm", 0))
    lab.do(ObserveStation(StationName(full("a")), "cam", 0))
    assert maybe(lab) == ["b"], "it may have fallen down"
    lab.do(ObserveStation(StationName(full("b")), "cam", 0))
    assert maybe(lab) == [""]
    lab.check_log()


def test_results_told_before_the_doubt_are_kept() -> None:
    lab = make_watched()
    what = plan(
        step("arm", move("a", "b")), step("cam", args={"x": {"$result": [0]}}), name="measured", feeds=(0,)
    )
    lab.stock("a", 1)
    run = lab.submit(what)
    action = lab.start(run)
    lab.finish(action, 42)
    see(lab, action, "cam is dark")
    lab.answer(lab.question("unknown_action"), "done")
    assert lab.results(run) == {0: 42}
    lab.check_log()


def test_a_crowd_is_counted() -> None:
    lab = make_watched()
    lab.stock("shelf", 1)
    lab.stock("a", 1)
    action = lab.start(lab.submit(route("a", "shelf")))
    lab.finish(action)
    see(lab, action, a=0, shelf=1)
    assert maybe(lab, "P2") == ["arm.gripper", ""]
    lab.check_log()


def test_two_that_say_that_they_have_put_something_down_are_both_believed_or_both_in_doubt() -> None:
    for count, doubts in [(2, 0), (1, 2)]:
        lab = make_watched()
        lab.stock("a", 1)
        lab.stock("c", 1)
        actions = [
            lab.start(lab.submit(route(place, "shelf", arm=arm)))
            for place, arm in [("a", "arm"), ("c", "arm2")]
        ]
        lab.finish(actions[0])
        assert see(lab, actions[0], a=0, shelf=1) == [], "somebody else is still at it"
        lab.finish(actions[1])
        see(lab, actions[0], a=0, shelf=count)
        see(lab, actions[1], shelf=count)
        assert len(lab.questions("unknown_action")) == doubts
        lab.check_log()


def test_recognised_by_its_label() -> None:
    for what, place in [("P1", "b"), ("P2", None)]:
        lab = make_watched()
        lab.stock("c", 1)
        lab.stock("a", 1)
        name = lab.at("a")[0]
        action = lab.start(lab.submit(route("a", "b")))
        lab.finish(action)
        label = name if what == "P1" else lab.at("c")[0]
        see(lab, action, a=0, b=label)
        item = lab.state.bench.labware[LabwareId(name)]
        assert item.station == (full(place) if place else "")
        lab.check_log()


def test_an_item_of_a_stack_that_did_not_arrive() -> None:
    for left, kind in [(4, "lost_labware"), (5, "")]:
        lab = make_watched(places=("stack", "b"))
        lab.stock("stack", 5)
        action = lab.start(lab.submit(route("stack", "b")))
        lab.finish(action)
        see(lab, action, stack=left, b=0)
        assert [q.kind for q in lab.questions()] == ([kind] if kind else [])
        assert "run.failed" in lab.types()
        lab.check_log()


def test_a_run_that_is_being_cancelled_ends_when_it_is_known() -> None:
    from labos.core.decide.cancelling import CancelRun

    lab = make_watched()
    run, action = carry_plate(lab)
    lab.do(CancelRun(run))
    see(lab, action, a=0, b=0)
    assert run not in lab.state.runs.active
    assert lab.question("lost_labware")
    lab.check_log()


def test_what_was_reported_is_neither_doubted_nor_told_twice() -> None:
    lab = make_watched()
    _, action = carry_plate(lab)
    assert lab.do(DoubtAction(action, "silence")) == []
    assert lab.finish(action) == []
    assert lab.do(FinishAction(action, 1, False, "none", error="late")) == []
    refused = lab.reject(ObserveStation(StationName(full("b")), "ada", 1))
    assert refused.code == "in_motion"


def test_a_late_word_of_success_is_looked_at_too() -> None:
    lab = make_watched()
    lab.stock("a", 1)
    action = lab.start(lab.submit(route("a", "b")))
    lab.doubt(action)
    lab.finish(action)
    assert lab.questions() == []
    see(lab, action, a=0, b=1)
    assert lab.where("P1") == "b"
    lab.check_log()


def test_on_doubt_nobody_looks_while_all_goes_well() -> None:
    lab = make_watched("on_doubt")
    lab.stock("a", 1)
    run = lab.submit(route("a", "b", "a", "b", "a"))
    lab.step(run)
    assert lab.where("P1") == "b"
    action = lab.start(run, 1)
    lab.doubt(action)
    lab.answer(lab.question("unknown_action"), "done")
    action = lab.start(run, 2)
    assert [e.TYPE for e in lab.finish(action)] == ["action.reported"], "the first after a doubt"
    see(lab, action, a=0, b=1)
    lab.step(run, 3)
    assert lab.where("P1") == "a", "and not the second"
    lab.check_log()


def test_never_is_never() -> None:
    lab = make_watched("never")
    lab.stock("a", 1)
    lab.doubt(lab.start(lab.submit(route("a", "b"))))
    lab.answer(lab.question("unknown_action"), "not_done")
    lab.step("R1")
    assert lab.where("P1") == "b"


@pytest.mark.parametrize("how", ["gone", "out"])
def test_nothing_is_carried_where_nobody_can_look(how: str) -> None:
    lab = make_watched()
    lab.stock("a", 1)
    lab.stock("c", 1)
    mine, other = lab.submit(route("a", "b")), lab.submit(route("c", "trash", arm="arm2"))
    cam = ModuleName(full("cam"))
    lab.do(LoseNode(cam, "i1", "crash") if how == "gone" else TakeOut(cam, "cleaning"))
    assert lab.code(mine) == "unwatched"
    assert lab.code(other) == ""
    assert lab.pump() == [f"{other}#0"]
    if how == "gone":
        lab.join("cam")
        assert lab.pump() == [f"{mine}#0"]


def test_a_cell_without_observers_is_as_before() -> None:
    lab = Driver(small_cell())
    lab.stock("a", 1)
    lab.step(lab.submit(route("a", "b")))
    assert "action.reported" not in lab.types()
