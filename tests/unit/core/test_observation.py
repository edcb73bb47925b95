"""What was seen narrows what is uncertain; what contradicts the log is asked."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.observation import ObserveStation
from labos.core.effects import Move
from labos.core.ids import ActionId, LabwareId, StationName
from labos.core.labware import LabwareUncertain
from labos.core.registry import Event
from tests.support.bench import (
    Driver,
    full,
    hold,
    move,
    plan,
    route,
    sets,
    small,
    small_cell,
    station,
    step,
)


def see(lab: Driver, place: str, **what: Any) -> list[Event]:
    return lab.do(ObserveStation(StationName(full(place)), "ada", **what))


def maybe(lab: Driver, name: str = "P1") -> list[str]:
    return [p.removeprefix("cell/") for p in lab.state.bench.labware[LabwareId(name)].maybe]


def doubtful(**more: Any) -> tuple[Driver, str]:
    """An arm that fell silent with P1 on its way from a to b."""
    cell = small_cell()
    hands = [station("arm.gripper", "gripper"), station("arm2.gripper", "gripper")]
    lab = Driver(small_cell(stations=[*cell.stations, *hands]))
    lab.stock("a", 1)
    run = lab.submit(route("a", "b", "c"))
    lab.doubt(lab.start(run))
    assert maybe(lab) == ["a", "arm.gripper", "b"]
    return lab, run


def test_every_empty_place_narrows_until_one_is_left() -> None:
    lab, run = doubtful()
    see(lab, "arm.gripper", count=0)
    assert maybe(lab) == ["a", "b"]
    assert lab.questions("unknown_action")
    see(lab, "a", count=0)
    assert (lab.where("P1"), lab.questions()) == ("b", [])
    assert "action.reconciled" in lab.types()
    lab.step(run, 1)
    assert lab.where("P1") == "c"
    lab.check_log()


def test_seen_at_its_source_the_step_is_done_again() -> None:
    lab, run = doubtful()
    see(lab, "a", count=1)
    assert (lab.where("P1"), lab.questions()) == ("a", [])
    lab.step(run, 0)
    assert lab.where("P1") == "b"
    lab.check_log()


def test_in_the_hand_it_is_known_but_somebody_has_to_put_it_down() -> None:
    for choice, place in [("done", "b"), ("not_done", "a")]:
        lab, _ = doubtful()
        see(lab, "arm.gripper", count=1)
        assert lab.where("P1") == "arm.gripper"
        lab.answer(lab.question("unknown_action"), choice)
        assert lab.where("P1") == place
        lab.check_log()


def test_recognised_anywhere_it_stands_there() -> None:
    lab, _ = doubtful()
    see(lab, "c", labware=LabwareId("P1"))
    assert lab.where("P1") == "c"
    assert lab.questions("unknown_action"), "nobody knows yet what the arm did"
    lab.check_log()


def test_lost_labware_that_is_seen_answers_its_question() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.fail(lab.start(lab.submit(route("a", "b"))))
    assert lab.question("lost_labware")
    see(lab, "b", count=1)
    assert (lab.where("P1"), lab.questions("lost_labware")) == ("b", [])
    left = lab.question("failed_run")
    assert "P1 at b" in left.text
    lab.answer(left, "removed")
    assert lab.at("b") == []
    lab.check_log()


def test_two_that_may_be_at_one_place_are_not_told_apart_by_a_sensor() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    for source, arm in [("a", "arm"), ("b", "arm2")]:
        lab.fail(lab.start(lab.submit(route(source, "c", arm=arm))))
        if source == "a":
            lab.answer(lab.question("lost_labware"), "source")
    both = (StationName("cell/b"), StationName("cell/c"))
    lab.write(LabwareUncertain(LabwareId("P1"), "", both, "swapped"))
    see(lab, "c", count=1)
    assert (maybe(lab, "P1"), maybe(lab, "P2")) == (["b", "c"], ["b", "arm2.gripper", "c"])
    # One recognised fills its place: the other cannot be there.
    see(lab, "c", labware=LabwareId("P1"))
    assert (lab.where("P1"), maybe(lab, "P2")) == ("c", ["b", "arm2.gripper"])
    see(lab, "b", count=1)
    assert lab.where("P2") == "b"
    lab.check_log()


def test_what_agrees_with_the_log_is_only_noted() -> None:
    lab = small()
    lab.stock("a", 1)
    for what in ({"count": 1}, {"kind": "plate"}, {"labware": LabwareId("P1")}, {}):
        assert [e.TYPE for e in see(lab, "a", **what)] == ["station.observed"]
    assert [e.TYPE for e in see(lab, "b", count=0)] == ["station.observed"]
    assert [e.TYPE for e in see(lab, "stack", count=5)] == ["station.observed"]


def test_a_plate_that_is_not_there_is_asked_for_and_only_it_is_uncertain() -> None:
    for choice, left in [("there", ["a"]), ("gone", [])]:
        lab = small()
        lab.stock("a", 1)
        lab.stock("c", 1)
        waiting = lab.submit(route("c", "hotel"))
        see(lab, "a", count=0)
        assert maybe(lab) == ["a", ""]
        assert lab.where("P2") == "c"
        assert lab.code(waiting) == "", "others go on"
        lab.answer(lab.question("contradiction"), choice)
        assert [lab.where(name) for name in lab.at("a")] == left
        lab.check_log()


def test_a_missing_plate_that_is_seen_elsewhere_is_found() -> None:
    lab = small()
    lab.stock("a", 1)
    see(lab, "a", count=0)
    see(lab, "b", labware=LabwareId("P1"))
    assert (lab.where("P1"), lab.questions()) == ("b", [])
    lab.check_log()


def test_what_is_awaited_at_its_target_is_not_in_its_own_way() -> None:
    """Seen elsewhere first, and then where its motion was to end."""
    lab, run = doubtful()
    see(lab, "hotel", labware=LabwareId("P1"))
    see(lab, "b", labware=LabwareId("P1"))
    lab.answer(lab.question("contradiction"), "seen")
    assert lab.where("P1") == "b"
    lab.answer(lab.question("unknown_action"), "done")
    assert lab.code(run, 1) == ""
    lab.check_log()


def test_what_was_lost_on_its_way_to_a_place_that_is_taken_now_can_be_taken_away() -> None:
    """One plate hangs in a hand, the next is lost on its way to where that one stood, and the first is put
    back there."""
    lab, _ = doubtful()
    lab.stock("stack", 2)
    see(lab, "arm.gripper", labware=LabwareId("P1"))
    lab.fail(lab.start(lab.submit(route("stack", "a", arm="arm2"))))
    lab.answer(lab.question("unknown_action"), "not_done")
    assert lab.where("P1") == "a"
    lost = lab.question("lost_labware")
    assert "a is full (P1)" in lab.reject(ResolveIntervention(lost.id, "target", "olga")).message
    lab.answer(lost, "gone")
    assert (lab.at("a"), lab.at("stack"), lab.questions("lost_labware")) == (["P1"], [], [])
    assert len(lab.state.bench.stations[StationName("cell/stack")].stock) == 1
    lab.check_log()


def test_a_plate_where_none_should_be_blocks_its_station_until_somebody_answers() -> None:
    for choice, count in [("removed", 0), ("new", 1)]:
        lab = small()
        lab.stock("a", 1)
        run = lab.submit(route("a", "b"))
        see(lab, "b", kind="plate")
        see(lab, "b", count=1)
        question = lab.question("contradiction")
        assert lab.code(run) == "uncertain"
        lab.answer(question, choice)
        assert len(lab.at("b")) == count
        assert lab.code(run) == ("occupied" if count else "")
        lab.check_log()


def test_a_strange_plate_that_has_gone_again_is_not_asked_about() -> None:
    lab = small()
    see(lab, "b", count=1)
    assert lab.question("contradiction").choices[0].name == "removed"
    see(lab, "b", count=0)
    assert lab.questions() == []
    lab.check_log()


def test_a_plate_recognised_in_anothers_place_makes_both_uncertain() -> None:
    outcomes = {"seen": ("b", None), "recorded": ("a", "b"), "gone": (None, "b")}
    for choice, places in outcomes.items():
        lab = small()
        lab.stock("a", 1)
        lab.stock("b", 1)
        see(lab, "b", labware=LabwareId("P1"))
        assert (maybe(lab, "P1"), maybe(lab, "P2")) == (["b", "a"], ["b", ""])
        lab.answer(lab.question("contradiction"), choice)
        known = lab.state.bench.labware
        found = tuple(lab.where(n) if n in known else None for n in ("P1", "P2"))  # type: ignore[comparison-overlap]
        assert found == places
        lab.check_log()


def test_what_cannot_be_seen_or_is_in_motion_is_refused() -> None:
    lab = small()
    lab.stock("a", 1)
    for place, what, code in [
        ("nowhere", {}, "no_station"),
        ("trash", {}, "waste"),
        ("a", {"count": -1}, "bad_count"),
        ("a", {"labware": LabwareId("P9")}, "no_labware"),
        ("stack", {"count": 2}, "stock_differs"),
    ]:
        assert lab.reject(ObserveStation(StationName(full(place)), "ada", **what)).code == code  # type: ignore[arg-type]
    lab.start(lab.submit(route("a", "b")))
    for place in ("a", "b", "hotel"):
        answer = lab.ask(ObserveStation(StationName(full(place)), "ada", labware=LabwareId("P1")))
        assert getattr(answer, "code", "") == "in_motion"


def test_an_item_half_taken_from_a_stack_is_not_taken_for_another() -> None:
    lab = small()
    lab.fail(lab.start(lab.submit(route("stack", "a"))))
    assert lab.question("lost_labware")
    assert [e.TYPE for e in see(lab, "a", count=1)] == ["station.observed"]
    assert lab.questions("lost_labware")
    lab.check_log()


def test_a_narrowed_waste_is_an_end() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(plan(*route("a", "trash").steps, step("cam", exclusive=False)))
    lab.fail(lab.start(run))
    lab.write(LabwareUncertain(LabwareId("P1"), "", (StationName("cell/a"), StationName("cell/trash")), "?"))
    see(lab, "a", count=0)
    assert lab.state.bench.labware == {}
    assert lab.questions("lost_labware") == []
    lab.check_log()


def test_seen_where_it_changes_grip_it_is_one_plate_and_not_two() -> None:
    """Nobody knows how the motion ended; the plate stands where it is expected, and no second one comes."""
    lab, regrip = small(), StationName("cell/c")
    lab.stock("a", 1)
    way = Move(StationName("cell/a"), StationName("cell/b"), via=regrip)
    lab.doubt(lab.start(lab.submit(plan(step("arm", way)))))
    lab.do(ObserveStation(regrip, "ada", 1))
    assert lab.at("c") == ["P1"]
    lab.answer(lab.questions()[0], "done")
    assert (lab.at("c"), lab.at("b")) == ([], ["P1"])
    lab.check_log()


def carry_to_c() -> tuple[Driver, ActionId]:
    """Nobody knew how the motion from a to b ended; somebody carried the plate to c and said so."""
    lab, _ = doubtful()
    see(lab, "c", labware="P1")
    for question in lab.questions("contradiction"):
        lab.answer(question, "seen")
    assert lab.where("P1") == "c"
    (action,) = lab.state.actions.open
    return lab, action


def test_a_device_that_speaks_late_does_not_take_back_what_somebody_saw_since() -> None:
    lab, action = carry_to_c()
    lab.finish(action)
    assert (lab.where("P1"), lab.at("b")) == ("c", [])
    lab.check_log()


def test_nor_when_it_says_that_it_failed_half_way() -> None:
    lab, action = carry_to_c()
    lab.fail(action, "partial")
    assert (lab.where("P1"), maybe(lab), lab.questions("lost_labware")) == ("c", [], [])
    lab.check_log()


def test_a_person_who_answers_after_that_is_believed() -> None:
    lab, _ = carry_to_c()
    lab.answer(lab.question("unknown_action"), "done")
    assert (lab.where("P1"), lab.at("c")) == ("b", [])
    lab.check_log()


def test_lost_labware_that_is_found_in_the_waste_is_gone() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.fail(lab.start(lab.submit(route("a", "trash"))), "partial")
    lab.answer(lab.question("lost_labware"), "target")
    assert "P1" not in lab.state.bench.labware
    assert (lab.at("trash"), lab.state.bench.stations[StationName("cell/trash")].level) == ([], 1)
    lab.check_log()


def test_a_plate_that_was_carried_off_keeps_nobody_from_where_it_stands() -> None:
    """Its motion ended nobody knows how, between two other places."""
    lab, _ = doubtful()
    look = lab.submit(plan(step("cam")))
    see(lab, "cam.nest", labware="P1")
    assert lab.where("P1") == "cam.nest"
    assert lab.code(look) == ""
    lab.step(look)
    lab.check_log()


def test_nobody_puts_it_back_where_others_were_let_in_meanwhile() -> None:
    lab, _ = doubtful()
    see(lab, "arm.gripper", count=1)
    lab.stock("a", 1)
    question = lab.question("unknown_action")
    refusal = lab.reject(ResolveIntervention(question.id, "not_done", "x"))
    assert (refusal.code, refusal.remedy) == (
        "occupied",
        "Put it at b and answer `done`, or remove it and answer `gone`.",
    )
    lab.answer(question, "done")
    assert lab.where("P1") == "b"
    lab.check_log()


def test_nor_into_a_module_that_is_anothers_meanwhile() -> None:
    cell = small_cell()
    deck = [station(f"dev.n{number}", "deck", claim=True) for number in (1, 2)]
    hands = [station("arm.gripper", "gripper"), station("arm2.gripper", "gripper")]
    lab = Driver(small_cell(stations=[*cell.stations, *deck, *hands]))
    lab.stock("a", 1)
    mine = lab.submit(route("a", "dev.n1", "b"))
    lab.step(mine)
    lab.doubt(lab.start(mine, 1))
    lab.stock("c", 1)
    other = lab.submit(plan(step("arm2", Move(StationName("cell/c"), StationName("cell/dev.n2")))))
    assert lab.code(other) == "held"
    see(lab, "arm.gripper", count=1)
    lab.start(other)
    question = lab.question("unknown_action")
    assert lab.reject(ResolveIntervention(question.id, "not_done", "x")).code == "occupied"
    lab.answer(question, "done")
    assert lab.where("P1") == "b"
    lab.check_log()


@pytest.mark.parametrize("look", [("arm.gripper", 1), ("dev.n1", 0)], ids=["in the hand", "not where it was"])
@pytest.mark.parametrize("ended", [False, True], ids=["at work", "holding"])
def test_nor_into_a_module_that_works_for_another_or_is_held(look: tuple[str, int], ended: bool) -> None:
    cell = small_cell()
    more = [station("dev.n1", "deck", claim=True), station("arm.gripper", "gripper")]
    lab = Driver(small_cell(stations=[*cell.stations, *more]))
    lab.stock("a", 1)
    mine = lab.submit(route("a", "dev.n1", "b"))
    lab.step(mine)
    lab.doubt(lab.start(mine, 1))
    lab.stock("c", 1)
    steps = (step("dev", sets("lid", "open")), step("arm2", move("c", "dev.n1")))
    other = lab.submit(plan(*steps, holds=(hold("dev", 0, 1),)))
    assert lab.code(other) == "held"
    place, count = look
    see(lab, place, count=count)
    opening = lab.start(other)
    if ended:
        lab.finish(opening)
    question = lab.question("unknown_action")
    refusal = lab.reject(ResolveIntervention(question.id, "not_done", "x"))
    assert refusal.code == "occupied"
    assert f"run:{other} has moved to dev.n1" in refusal.message
    if not ended:
        lab.finish(opening)
    lab.answer(question, "done")
    lab.step(other, 1)
    assert lab.where("P1") == "b"
    lab.check_log()
