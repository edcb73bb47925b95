"""An arm's hand is a station: what is picked stays in it until it is placed."""

from __future__ import annotations

from labos.core.waits import Wait
from labos.planning.obstacle import find_obstacle
from tests.support.bench import Driver, module, move, plan, route, station, step, take, workcell

HAND = "arm.gripper"


def two_arms() -> Driver:
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("cam")],
            [
                station("stack", "stack", 9),
                *map(station, ("a", "b", "c")),
                station(HAND, "gripper"),
                station("arm2.gripper", "gripper"),
                station("trash", "waste", 9),
            ],
        )
    )
    lab.stock("stack", 9)
    return lab


def test_while_its_hand_is_full_an_arm_only_puts_that_down() -> None:
    lab = two_arms()
    lab.stock("a", 1)
    held = lab.submit(plan(step("arm", move("a", HAND)), step("arm"), step("arm", move(HAND, "b"))))
    going = lab.start(held)
    assert lab.code(lab.submit(route("stack", "c"))) == "module_busy"
    lab.finish(going)
    assert lab.at(HAND) == ["P1"]
    for other in (route("stack", "c"), plan(step("arm", move("c", HAND)))):
        run = lab.submit(other)
        found = lab.check_start(run)
        assert isinstance(found, Wait)
        assert found.code in ("hand_full", "nothing_there")
    assert lab.check_start("R2").reason.sentence == "the hand of arm holds P1"  # type: ignore[union-attr]
    assert lab.code(lab.submit(plan(step("arm")))) == "", "what carries nothing needs no hand"
    assert lab.code(lab.submit(route("stack", "c", arm="arm2"))) == "", "other hands are free"
    lab.step(held, 1)
    lab.step(held, 2)
    assert lab.at("b") == ["P1"]
    assert lab.code("R2") == ""


def test_what_is_put_down_wakes_who_waits_for_the_hand() -> None:
    lab = two_arms()
    lab.stock("a", 1)
    lab.submit(plan(step("arm", move("a", HAND)), step("cam"), step("arm", move(HAND, "b")), step("cam")))
    waiting = lab.submit(route("stack", "c", "trash"))
    started = []
    for _ in range(8):
        started += lab.pump()
        assert lab.find_missed() == []
        for action in lab.list_flying():
            lab.finish(action)
    assert f"{waiting}#0" in started
    assert not lab.state.runs.active


def test_nothing_is_picked_that_could_not_be_put_down() -> None:
    """The place where it has to go is taken by who needs this very arm to get away."""
    lab = two_arms()
    stays = lab.submit(plan(step("arm", take("stack", "b")), step("cam"), step("arm", move("b", "trash"))))
    lab.step(stays)
    picks = lab.submit(
        plan(step("arm2", take("stack", "a")), step("arm", move("a", HAND)), step("arm", move(HAND, "b")))
    )
    lab.step(picks)
    assert lab.code(picks, 1) == "", "the rules of the bench see nothing wrong"
    assert lab.scheduler.safety.list_trapped(lab.state, lab.run(picks), 1) == [stays, picks]


def test_a_run_is_told_of_a_hand_that_nobody_empties() -> None:
    lab = two_arms()
    lab.step(lab.submit(plan(step("arm", take("stack", HAND)))))
    out = lab.run(lab.submit(route("stack", "a", "trash"), user="bob"))  # type: ignore[arg-type]
    told = find_obstacle(lab.scheduler.safety, lab.state, out)
    assert told == "'to a' needs the hand of arm, where P1 of user ada stands"


def test_lost_labware_still_haunts_the_hand() -> None:
    lab = two_arms()
    lab.stock("a", 1)
    lab.doubt(lab.start(lab.submit(plan(step("arm", move("a", HAND))))))
    lab.answer(lab.question("unknown_action"), "done")
    assert lab.at(HAND) == ["P1"]
