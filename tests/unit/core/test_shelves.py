"""Hotels with shelves: which shelf it is, and what people may say of them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from labos.core.actions import ActionRequested
from labos.core.decide.access import EndAccess, ReportedChange, RequestAccess
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.observation import ObserveStation
from labos.core.decide.stock import LoadStation, UnloadStation
from labos.core.decide.teach import TeachLocation
from labos.core.ids import LabwareId, ModuleName, StationName
from labos.core.model import StationSpec, Workcell
from labos.core.shelves import spread
from tests.support.bench import (
    CELL,
    Driver,
    full,
    module,
    move,
    needs,
    plan,
    relid,
    route,
    station,
    step,
    take,
    unlid,
    workcell,
)

HOTEL = StationName(full("hotel"))


def shelf(number: int) -> StationName:
    return StationName(full(f"hotel.{number}"))


def shelves(count: int, hotel: str = "hotel", owner: str = "") -> list[StationSpec]:
    """A hotel and its shelves; it belongs to a module or to nobody."""
    name, module_ = StationName(full(hotel)), ModuleName(full(owner))
    each = [StationName(f"{name}.{n}") for n in range(1, count + 1)]
    return [
        StationSpec(name, "hotel", module_, count),
        *(StationSpec(shelf_, "hotel", module_, hotel=name) for shelf_ in each),
    ]


def cell(count: int = 2, *others: StationSpec) -> Workcell:
    places = [station("a"), station("b"), station("stack", "stack", 9)]
    return workcell([module("arm"), module("dev")], [*places, *(shelves(count) if count else []), *others])


def lab(count: int = 2, *others: StationSpec) -> Driver:
    made = Driver(cell(count, *others))
    made.stock("stack", 6)
    return made


def find_last_args(made: Driver, name: str) -> Any:
    """The arguments of the last action that was asked for."""
    events = [entry.event for entry in made.log if isinstance(entry.event, ActionRequested)]
    return events[-1].args.get(name)


def carry(*places: str) -> Any:
    """From place to place, with arguments that say so."""
    steps = []
    for source, target in pairwise(places):
        effect = take(source, target) if source == "stack" else move(source, target)
        steps.append(step("arm", effect, args={"source": source, "target": target}))
    return plan(*steps)


# -- which shelf ----------------------------------------------------------------------------------


def test_the_lowest_free_shelf_and_back_from_it() -> None:
    made = lab()
    first, second = made.submit(carry("stack", "hotel", "a")), made.submit(carry("stack", "hotel", "b"))
    made.step(first)
    assert (made.where("P1"), find_last_args(made, "target")) == ("hotel.1", "hotel.1")
    made.step(second)
    assert made.where("P2") == "hotel.2"
    assert made.state.bench.stations[HOTEL].labware == ["P1", "P2"]
    assert made.state.bench.stations[HOTEL].full
    made.step(second, 1)
    assert (made.where("P2"), find_last_args(made, "source")) == ("b", "hotel.2")
    made.step(first, 1)
    assert (made.where("P1"), find_last_args(made, "source"), find_last_args(made, "target")) == (
        "a",
        "hotel.1",
        "a",
    )
    assert made.at("hotel") == []
    made.check_log()


def test_what_is_on_its_way_keeps_its_shelf() -> None:
    made = lab()
    first = made.start(made.submit(carry("stack", "hotel")))
    assert made.state.bench.stations[HOTEL].expected == 1
    second = made.submit(plan(step("dev", take("stack", "hotel"))))
    made.step(second)
    assert made.at("hotel.2") == ["P2"]
    third = made.submit(plan(step("dev", take("stack", "hotel"))))
    assert made.code(third) == "occupied"
    made.fail(first, "none")
    assert made.code(third) == ""
    made.check_log()


def test_an_action_that_brings_two_needs_two_shelves() -> None:
    made = lab()
    both = made.submit(plan(step("arm", take("stack", "hotel"), take("stack", "hotel"))))
    made.step(both)
    assert (made.at("hotel.1"), made.at("hotel.2")) == (["P1"], ["P2"])
    made = lab()
    made.step(made.submit(route("stack", "hotel")))
    both = made.submit(plan(step("arm", take("stack", "hotel"), take("stack", "hotel"))))
    assert made.code(both) == "occupied"


def test_nobody_is_sure_what_stands_on_a_shelf() -> None:
    made = lab()
    lost = made.submit(carry("stack", "a", "hotel"))
    made.step(lost)
    made.doubt(made.start(lost, 1))
    assert made.state.bench.uncertain_at[shelf(1)] == 1
    other = made.submit(plan(step("dev", take("stack", "hotel"))))
    made.step(other)  # the other shelf is beyond doubt
    assert made.at("hotel.2") == ["P2"]
    third = made.submit(plan(step("dev", take("stack", "hotel"))))
    assert made.code(third) == "occupied"  # for that one may be carried away
    made.step(made.submit(plan(step("dev", move("hotel", "b")))))
    assert made.at("b") == ["P2"]
    made.step(third)
    made.do(UnloadStation(shelf(2), "ada"))
    made.do(ApplyWorkcell(cell(1)))
    assert made.code(made.submit(plan(step("dev", take("stack", "hotel"))))) == "uncertain"
    gone = made.submit(plan(step("dev", move("hotel", "b"))), user="bo")
    assert made.code(gone) == "uncertain"
    made.do(ObserveStation(shelf(1), "eye", labware=LabwareId("P1")))
    assert made.where("P1") == "hotel.1"
    made.check_log()


def test_what_is_seen_on_the_last_shelf_while_it_is_expected_there_is_one_piece() -> None:
    made = lab(1)
    run = made.submit(carry("stack", "a", "hotel"))
    made.step(run)
    made.doubt(made.start(run, 1))
    made.do(ObserveStation(shelf(1), "eye", labware=LabwareId("P1")))
    assert made.at("hotel") == made.at("hotel.1") == ["P1"]
    made.check_log()


def test_shelves_that_nobody_has_spoken_of() -> None:
    made = Driver(cell(), empty=False)
    made.stock("stack", 3)
    run = made.submit(route("stack", "hotel"))
    assert made.code(run) == "undeclared"
    made.do(DeclareStation(shelf(2)))
    assert not made.state.bench.stations[HOTEL].known
    made.step(run)
    assert made.where("P1") == "hotel.2"
    made.do(ObserveStation(shelf(1), "eye", 0))
    assert made.state.bench.stations[HOTEL].known
    made.check_log()


def test_work_on_what_stands_on_a_shelf() -> None:
    made = lab(0, *shelves(2, "dev.racks", "dev"))
    made.stock("dev.racks.2", 1)
    run = made.submit(plan(step("dev", needs("dev.racks"), args={"station": "dev.racks", "other": 3})))
    made.start(run)
    assert (find_last_args(made, "station"), find_last_args(made, "other")) == ("dev.racks.2", 3)
    again = made.submit(plan(step("dev", needs())))
    assert made.code(again) == "module_busy"


def test_lids_of_plates_on_shelves_and_on_shelves_themselves() -> None:
    made = lab(3)
    made.do(DeclareStation(shelf(2), ("plate+lid",)))
    on_shelf = made.submit(plan(step("arm", unlid("hotel", "a")), step("arm", relid("a", "hotel"))))
    made.step(on_shelf)
    assert (made.at("hotel"), made.at("a")) == (["P1"], ["P2"])
    made.step(on_shelf, 1)
    assert made.state.bench.labware[LabwareId("P2")].on == "P1"
    made.do(DeclareStation(StationName(full("b")), ("plate+lid",)))
    lid = made.submit(plan(step("arm", unlid("b", "hotel")), step("arm", relid("hotel", "b"))), user="bo")
    made.step(lid)
    assert (made.at("hotel.1"), made.at("hotel.2")) == (["P4"], ["P1"])
    made.step(lid, 1)
    assert made.state.bench.labware[LabwareId("P4")].on == "P3"
    made.check_log()


def test_who_waits_for_a_shelf_is_woken() -> None:
    made = lab(1)
    first, second = made.submit(carry("stack", "hotel", "a")), made.submit(carry("stack", "hotel", "b"))
    assert made.pump() == [f"{first}#0"]
    made.finish(made.list_flying()[0])
    assert made.pump() == [f"{first}#1"]
    made.finish(made.list_flying()[0])
    assert f"{second}#0" in made.pump()
    assert made.find_missed() == []


# -- what people say ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        DeclareStation(HOTEL, ("plate",)),
        ObserveStation(HOTEL, "eye", 1),
        TeachLocation(ModuleName(full("arm")), HOTEL, (1.0, 2.0), "ada"),
    ],
    ids=lambda command: type(command).__name__,
)
def test_a_hotel_is_not_one_place(command: Any) -> None:
    refusal = lab().reject(command)
    assert refusal.code == "many_shelves"
    assert refusal.message == "hotel has 2 shelves: hotel.1 to hotel.2."


def test_nor_is_it_for_somebody_who_reached_in() -> None:
    made = lab()
    made.do(RequestAccess(CELL, "ada", "oil"))
    refusal = made.reject(EndAccess(CELL, "ada", "", (ReportedChange(HOTEL, "plate"),)))
    assert refusal.code == "many_shelves"
    made.do(EndAccess(CELL, "ada", "", (ReportedChange(shelf(2), "plate"),)))
    assert made.at("hotel") == made.at("hotel.2") == ["P1"]


def test_loading_fills_the_lowest_free_shelves() -> None:
    made = lab(3)
    made.do(DeclareStation(shelf(2), ("plate",)))
    refusal = made.reject(LoadStation(HOTEL, "plate", 3))
    assert (refusal.code, refusal.remedy) == ("too_many", "Load 2 at most.")
    made.do(LoadStation(HOTEL, "plate+lid", 2, "L7"))
    assert [made.at(f"hotel.{n}") for n in (1, 2, 3)] == [["P2"], ["P1"], ["P4"]]
    assert made.state.bench.labware[LabwareId("P5")].on == "P4"
    assert made.reject(LoadStation(HOTEL, "plate", 1)).message.startswith("hotel is full")
    made.do(UnloadStation(HOTEL, "ada", LabwareId("P1")))
    assert made.at("hotel.2") == []
    made.do(UnloadStation(HOTEL, "ada"))
    assert made.at("hotel") == []
    assert not made.state.bench.labware
    made.check_log()


def test_loading_says_of_unknown_shelves_that_they_were_empty() -> None:
    made = Driver(cell(), empty=False)
    made.do(LoadStation(HOTEL, "plate", 1))
    assert made.at("hotel.1") == ["P1"]
    assert made.state.bench.stations[shelf(1)].known
    assert not made.state.bench.stations[HOTEL].known


def test_what_stands_there_is_spread_over_the_shelves() -> None:
    bench = lab(3).state.bench
    assert spread(bench, StationName(full("a")), ["x", "y"]) == [(full("a"), ["x", "y"])]
    assert spread(bench, HOTEL, ["x", "y"]) == [(shelf(1), ["x"]), (shelf(2), ["y"]), (shelf(3), [])]
    assert spread(bench, HOTEL, [*"wxyz"])[-1] == (shelf(3), ["y", "z"])


# -- other shelves --------------------------------------------------------------------------------


def test_a_hotel_gains_and_loses_shelves() -> None:
    made = lab(2)
    made.stock("hotel.2", 1)
    refusal = made.reject(ApplyWorkcell(cell(1)))
    assert (refusal.code, "hotel.2" in refusal.message) == ("station_occupied", True)
    made.do(ApplyWorkcell(cell(3)))
    assert made.state.bench.shelves[HOTEL] == [shelf(1), shelf(2), shelf(3)]
    assert not made.state.bench.stations[HOTEL].known
    made.do(UnloadStation(shelf(2), "ada"))
    made.do(ApplyWorkcell(cell(1)))
    assert made.state.bench.shelves[HOTEL] == [shelf(1)]
    made.do(ApplyWorkcell(cell(0)))
    assert not made.state.bench.shelves
    assert HOTEL not in made.state.bench.stations
    made.check_log()


def test_a_hotel_with_labware_is_not_divided_nor_put_together() -> None:
    one_place = cell(0, StationSpec(HOTEL, "hotel", capacity=2))
    made = Driver(one_place)
    made.stock("hotel", 1)
    refusal = made.reject(ApplyWorkcell(cell(2)))
    assert "cannot be divided into other shelves" in refusal.message
    made = lab(2)
    made.stock("hotel.1", 1)
    assert made.reject(ApplyWorkcell(one_place)).code == "station_occupied"
    made.do(UnloadStation(shelf(1), "ada"))
    made.do(ApplyWorkcell(one_place))
    made.do(DeclareStation(HOTEL, ("plate", "plate")))
    assert made.at("hotel") == ["P2", "P3"]
    made.check_log()


def test_what_is_loaded_may_be_sealed_but_not_lidded() -> None:
    made = lab(3)
    made.do(LoadStation(HOTEL, "plate", 2, set=("sealed",), unset=("spun",)))
    for name in ("P1", "P2"):
        assert made.state.bench.labware[LabwareId(name)].variables == {"sealed": True, "spun": False}
    refusal = made.reject(LoadStation(HOTEL, "plate", 1, set=("lidded",)))
    assert refusal.remedy == "Put it there with its lid: plate96+lid96."
    made.check_log()
