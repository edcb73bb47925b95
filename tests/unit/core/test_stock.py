"""Consumables with lots, stacks that people load and unload."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.binding import find_unreserved
from labos.core.decide import Rejection
from labos.core.decide.lab import DeclareStation
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.effects import Transfers
from labos.core.ids import LabwareId, ModuleName, RunId, StationName
from labos.core.labware import LiquidTransferred
from labos.core.resources import LevelSet, Lot
from labos.core.waits import Wait
from tests.support.bench import CELL, Driver, consumes, full, needs, plan, route, small, step

DEV = ModuleName(f"{CELL}/dev")


def dry(level: float = 10.0, capacity: float = 100.0) -> Driver:
    """A small lab whose device has so much foil, of a lot ``old``."""
    lab = small()
    lab.set_level(LevelSet(DEV, "foil", level, capacity, "old"))
    return lab


def refill(amount: float, lot: str, expires: str = "") -> Replenish:
    return Replenish(DEV, "foil", amount, lot, expires)


def lots(lab: Driver) -> list[tuple[str, float]]:
    return [(lot.name, lot.left) for lot in lab.state.resources.levels[f"{DEV}:foil"].lots]


def list_used(lab: Driver) -> list[tuple[str, float]]:
    events = [entry.event for entry in lab.log if entry.event.TYPE == "resource.consumed"]
    return [(event.lot, event.amount) for event in events]  # type: ignore[attr-defined]


def load(name: str, count: int, lot: str = "", labware: str = "plate") -> LoadStation:
    return LoadStation(StationName(full(name)), labware, count, lot)


def unload(name: str, labware: str = "", count: int | None = None) -> UnloadStation:
    return UnloadStation(StationName(full(name)), "ada", LabwareId(labware), count)


# -- consumables ----------------------------------------------------------------------------------


def test_what_is_used_up_comes_from_the_oldest_lot() -> None:
    lab = dry(3)
    lab.do(refill(5, "new", "2027-05-31"))
    assert lab.state.resources.levels[f"{DEV}:foil"].lots[1] == Lot("new", 5.0, "2027-05-31")
    run = lab.submit(plan(step("dev", consumes("foil", 2)), step("dev", consumes("foil", 4))))
    lab.step(run, 0)
    assert lots(lab) == [("old", 1), ("new", 5)]
    lab.step(run, 1)
    assert list_used(lab) == [("old", 2), ("old", 1), ("new", 3)]
    assert lots(lab) == [("new", 2)]
    assert lab.state.resources.find_left(DEV, "foil") == 2
    lab.check_log()


def test_two_amounts_of_one_step_are_charged_one_after_the_other() -> None:
    lab = dry(3)
    lab.do(refill(5, "new"))
    run = lab.submit(plan(step("dev", consumes("foil", 2), consumes("foil", 2))))
    lab.step(run)
    assert list_used(lab) == [("old", 2), ("old", 1), ("new", 1)]


def test_two_in_flight_are_not_promised_the_same() -> None:
    lab = dry(3)
    both = [lab.submit(plan(step("dev", consumes("foil", 2), exclusive=False))) for _ in range(2)]
    action = lab.start(both[0])
    assert lab.code(both[1]) == "used_up"
    assert find_unreserved(lab.state, DEV, "foil") == 1
    lab.fail(action, "none")
    assert lab.code(both[1]) == "", "what failed without effect used nothing"
    lab.check_log()


def test_two_amounts_of_one_step_have_to_be_there_together() -> None:
    lab = dry(3)
    run = lab.submit(plan(step("dev", consumes("foil", 2), consumes("foil", 2))))
    assert lab.code(run) == "used_up"


@pytest.mark.parametrize(("effects", "left"), [("none", 10), ("all", 6), ("partial", 6), ("unknown", 6)])
def test_a_failed_action_has_used_what_it_says(effects: str, left: float) -> None:
    lab = dry(10)
    lab.fail(lab.start(lab.submit(plan(step("dev", consumes("foil", 4))))), effects)
    assert lab.state.resources.find_left(DEV, "foil") == left


@pytest.mark.parametrize(("choice", "left"), [("done", 6), ("not_done", 10), ("gone", 6)])
def test_an_unknown_action_has_used_what_a_person_says(choice: str, left: float) -> None:
    lab = dry(10)
    lab.doubt(lab.start(lab.submit(plan(step("dev", consumes("foil", 4)), step("dev")))))
    assert find_unreserved(lab.state, DEV, "foil") == 6, "until then it may be used"
    lab.answer(lab.question("unknown_action"), choice)
    assert lab.state.resources.find_left(DEV, "foil") == left


def test_an_empty_resource_waits_for_a_person_and_a_refill_wakes_it() -> None:
    lab = dry(1)
    run = lab.submit(plan(step("dev", consumes("foil", 2))))
    assert lab.pump() == []
    wait = lab.check_start(run)
    assert isinstance(wait, Wait)
    assert (wait.code, wait.names, wait.blocked) == ("used_up", (DEV, "foil"), True)
    lab.do(refill(5, "new"))
    assert lab.find_missed() == [f"{run}#0"] or lab.pump() == [f"{run}#0"]


def test_a_run_is_let_in_only_with_enough_for_all_its_steps() -> None:
    lab = dry(3)
    run = lab.submit(plan(*[step("dev", consumes("foil", 2))] * 2))
    assert lab.code(run) == "used_up"
    lab.do(refill(1, "new"))
    assert lab.code(run) == ""


def test_a_run_that_uses_more_than_the_module_holds_may_be_refilled_on_its_way() -> None:
    lab = dry(3, capacity=3)
    run = lab.submit(plan(*[step("dev", consumes("foil", 2))] * 2))
    lab.step(run, 0)
    assert lab.code(run, 1) == "used_up"
    lab.do(refill(2, "new"))
    assert lab.code(run, 1) == ""


def test_a_step_that_needs_more_than_the_module_holds_is_refused() -> None:
    lab = dry(3, capacity=3)
    found = lab.reject(SubmitRun(plan(step("dev", consumes("foil", 4), key="Seal")), "ada"))
    assert found.code == "beyond_capacity"
    assert "'Seal' needs 4 of foil, but dev holds at most 3" in found.message


def test_who_ran_dry_stands_in_nobodys_calculation() -> None:
    """A run that waits for tips with its plate on the deck counts as an obstacle: others that pass
    it by go on, and no new run is let in that needs it to go away."""
    lab = dry(2)
    steps = [*route("stack", "dev.n1").steps, step("dev", needs("dev.n1"), consumes("foil", 2))]
    run = lab.submit(plan(*steps, *route("dev.n1", "trash").steps, name="sealed"))
    lab.step(run, 0)
    lab.set_level(LevelSet(DEV, "foil", 0, 100))
    beside = lab.submit(route("stack", "a", "trash", name="beside"))
    through = lab.submit(route("stack", "a", "dev.n1", "trash", name="through"))
    assert lab.pump() == [f"{beside}#0"]
    assert lab.code(run, 1) == "used_up"
    lab.finish("A2")
    lab.pump()
    lab.finish("A3")
    assert lab.state.runs.get(through) is not None
    assert lab.pump() == [], "it would come to stand before the deck"
    lab.do(refill(2, "new"))
    assert lab.log[-1].event.awaited == (run,)  # type: ignore[attr-defined]
    assert lab.pump() != []


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (Replenish(ModuleName("cell/nobody"), "foil"), "no_module"),
        (Replenish(DEV, "ink"), "no_resource"),
        (refill(-1, ""), "bad_level"),
        (refill(91, ""), "too_many"),
        (refill(1, "", "tomorrow"), "bad_date"),
        (refill(1, "", "2027-13-01"), "bad_date"),
    ],
)
def test_what_does_not_fit_is_refused(command: Replenish, code: str) -> None:
    assert dry(10).reject(command).code == code


def test_without_an_amount_it_is_full_and_then_takes_no_more() -> None:
    lab = dry(10)
    lab.do(refill(0, "new"))
    assert lots(lab) == [("old", 10), ("new", 90)]
    assert lab.reject(refill(0, "newer")).code == "bad_level"


# -- stacks ---------------------------------------------------------------------------------------


def test_labware_from_a_stack_carries_its_lot() -> None:
    lab = small()
    lab.do(load("stack", 2, "L1"))
    lab.do(load("stack", 1, "L2"))
    run = lab.submit(route("stack", "a"))
    other = lab.submit(route("stack", "b"))
    lab.step(run)
    lab.step(other)
    assert [lab.state.bench.labware[LabwareId(n)].variables for n in ("P1", "P2")] == [
        {"lot": "L2"},
        {"lot": "L1"},
    ]
    lab.check_log()


def test_slots_give_what_is_loaded_a_name() -> None:
    lab = small()
    lab.do(load("a", 1, "L1"))
    (item,) = lab.at("a")
    labware = lab.state.bench.labware[LabwareId(item)]
    assert (labware.owner, labware.variables) == ("shared", {"lot": "L1"})
    assert lab.reject(load("a", 1)).code == "too_many"


def test_loading_and_unloading_wakes_who_waits() -> None:
    lab = small()
    run = lab.submit(route("stack", "a"))
    lab.do(DeclareStation(StationName(full("stack"))))
    assert lab.pump() == []
    assert lab.code(run) == "stack_empty"
    lab.do(load("stack", 1))
    assert lab.find_missed() == [f"{run}#0"] or lab.pump() == [f"{run}#0"]


def test_what_is_refused_to_be_loaded() -> None:
    lab = small()
    room = lab.state.bench.stations[StationName(full("stack"))].spec.capacity
    assert lab.reject(load("nowhere", 1)).code == "no_station"
    assert lab.reject(load("trash", 1)).code == "not_accepted"
    assert lab.reject(load("stack", room + 1)).code == "too_many"
    lab.do(load("stack", 1))
    lab.start(lab.submit(route("stack", "a")))
    assert lab.reject(load("stack", 1)).code == "in_motion"
    assert lab.reject(unload("stack", count=1)).code == "in_motion"
    assert lab.reject(load("a", 1)).code == "in_motion"


def test_what_was_taken_away_has_left_the_bench() -> None:
    lab = small()
    lab.do(unload("stack"))
    lab.do(load("stack", 5, "L1"))
    lab.do(unload("stack", count=2))
    stack = lab.state.bench.stations[StationName(full("stack"))]
    assert (stack.stock, stack.lots) == (["plate"] * 3, ["L1"] * 3)
    lab.do(unload("stack"))
    assert stack.count == 0
    assert lab.reject(unload("stack")).code == "too_many"
    lab.do(load("a", 1))
    (item,) = lab.at("a")
    lab.do(unload("a", item))
    assert lab.at("a") == []
    assert item not in lab.state.bench.labware
    assert lab.reject(unload("a", item)).code == "not_there"
    lab.check_log()


def test_what_a_run_still_owns_is_not_taken_away() -> None:
    lab = small()
    run = lab.submit(route("stack", "a", "b"))
    lab.step(run)
    (item,) = lab.at("a")
    found = lab.reject(unload("a", item))
    assert (found.code, f"run {run}" in found.message) == ("in_use", True)
    lab.step(run, 1)
    lab.do(unload("b", item))


def test_a_waste_is_emptied() -> None:
    lab = small()
    lab.do(load("stack", 2))
    lab.step(lab.submit(route("stack", "a")))
    run = lab.submit(route("a", "trash"))
    lab.step(run)
    trash = lab.state.bench.stations[StationName(full("trash"))]
    assert trash.level == 1
    lab.do(unload("trash"))
    assert trash.level == 0
    assert isinstance(lab.ask(unload("trash")), Rejection)
    lab.check_log()


# -- liquids --------------------------------------------------------------------------------------


def doses(lab: Driver) -> list[LiquidTransferred]:
    return [entry.event for entry in lab.log if isinstance(entry.event, LiquidTransferred)]


def make_pipetted(wells: Any, volumes: Any, **more: Any) -> tuple[Driver, RunId]:
    """A plate on a device that puts foil (of all things) into its wells."""
    lab = dry(10)
    effects = (needs("dev.n1"), Transfers("ink", wells, volumes, "foil"), consumes("foil", 4))
    lab.step(lab.submit(route("stack", "dev.n1")))
    return lab, lab.submit(plan(step("cam"), step("dev", *effects, **more), name="dose", feeds=(0,)))


def test_what_was_pipetted_is_told_with_wells_volumes_and_lot() -> None:
    lab, run = make_pipetted(["A1", "A2", "A3"], [10, 0, 2.5])
    lab.step(run)
    lab.step(run, 1)
    (told,) = doses(lab)
    assert (told.labware, told.liquid, told.wells, told.volumes_ul) == ("P1", "ink", ("A1", "A3"), (10, 2.5))
    assert (told.lots, told.certain, told.module) == (("old",), True, DEV)
    lab.check_log()


def test_lists_that_an_earlier_step_worked_out_are_written_in() -> None:
    lab, run = make_pipetted(["A1"], {"$result": [0, "volumes"]})
    lab.step(run, 0, {"volumes": [7.0]})
    lab.step(run, 1)
    assert [told.volumes_ul for told in doses(lab)] == [(7.0,)]


@pytest.mark.parametrize(("effects", "told"), [("none", []), ("partial", [False]), ("unknown", [False])])
def test_a_pipette_that_failed_is_not_sure(effects: str, told: list[bool]) -> None:
    lab, run = make_pipetted(["A1"], [5])
    lab.step(run)
    lab.fail(lab.start(run, 1), effects)
    assert [dose.certain for dose in doses(lab)] == told


def test_without_wells_nothing_is_told() -> None:
    lab, run = make_pipetted("", "")
    lab.step(run)
    lab.step(run, 1)
    assert doses(lab) == []
