"""A lid is labware of its own: on its plate, in a nest, or nobody knows where."""

from __future__ import annotations

import pytest

from labos.core import reasons
from labos.core.decide.lab import DeclareStation
from labos.core.ids import LabwareId, Owner, StationName
from labos.core.labware import LabwareHandedOver, LabwareObserved
from labos.core.model import Plan
from labos.core.waits import Wait
from tests.support.bench import (
    Driver,
    module,
    move,
    needs,
    plan,
    relid,
    requires,
    station,
    step,
    take,
    unlid,
    workcell,
)

CELL = workcell(
    [module("arm"), module("dev")],
    [
        station("stack", "stack", 10),
        station("a"),
        station("b"),
        station("dev.n", claim=True),
        station("nest", accepts=("lid",)),
        station("trash", "waste", 5),
    ],
)
USES = step("dev", needs(), requires("lidded", False, of="labware"))


def lab_with(count: int = 2, item: str = "plate+lid") -> Driver:
    lab = Driver(CELL)
    lab.stock("stack", count, item)
    return lab


def there_and_back() -> Plan:
    return plan(
        step("arm", take("stack", "a")),
        step("arm", unlid("a", "nest")),
        step("arm", relid("nest", "a")),
        step("arm", move("a", "trash")),
    )


def lid_of(lab: Driver, plate: str) -> str:
    return lab.state.bench.labware[LabwareId(plate)].lid


def test_a_plate_comes_off_its_stack_with_its_lid_on_and_leaves_with_it() -> None:
    lab = lab_with()
    run = lab.submit(there_and_back())
    lab.step(run, 0)
    assert (lab.at("a"), lid_of(lab, "P1")) == (["P1"], "P2")
    lid = lab.state.bench.labware[LabwareId("P2")]
    assert (lid.type, lid.on, lid.station, lid.owner) == ("lid", "P1", "", f"run:{run}")
    lab.step(run, 1)
    assert (lab.at("a"), lab.at("nest"), lid_of(lab, "P1")) == (["P1"], ["P2"], "")
    lab.step(run, 2)
    assert (lab.at("nest"), lid_of(lab, "P1")) == ([], "P2")
    lab.step(run, 3)
    assert not lab.state.bench.labware
    assert lab.state.bench.stations[StationName("cell/trash")].level == 1
    assert not lab.state.runs.active
    lab.check_log()


def test_a_lid_rides_along_when_its_plate_is_moved() -> None:
    lab = lab_with()
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b")), USES))
    lab.step(run, 0)
    lab.step(run, 1)
    assert (lab.at("b"), lid_of(lab, "P1")) == (["P1"], "P2")


def test_what_needs_an_open_plate_waits_for_the_lid_to_come_off() -> None:
    lab = lab_with()
    steps = (
        step("arm", take("stack", "dev.n")),
        step("arm", unlid("dev.n", "nest")),
        step("dev", needs(), requires("lidded", False, of="labware"), after=(0,)),
    )
    run = lab.submit(plan(*steps))
    lab.step(run, 0)
    found = lab.check_start(run, 2)
    assert found == Wait(reasons.Requires("P1", "lidded", "False"), ("station:cell/dev.n",))
    action = lab.start(run, 1)
    lab.keys.clear()
    lab.finish(action)
    assert "station:cell/dev.n" in lab.keys
    assert lab.code(run, 2) == ""


def test_no_second_lid_no_missing_lid_no_plate_in_a_lid_nest() -> None:
    lab = lab_with(2)
    first = lab.submit(plan(step("arm", take("stack", "a")), step("arm", unlid("a", "nest")), USES))
    other = lab.submit(plan(step("arm", take("stack", "b")), step("arm", unlid("b", "nest")), USES))
    lab.step(first, 0)
    lab.step(other, 0)
    lab.step(first, 1)
    assert lab.code(other, 1) == "occupied"
    bare = lab.submit(plan(step("arm", unlid("a", "nest"))))
    lab.write(LabwareHandedOver(LabwareId("P1"), "", Owner("shared")))
    found = lab.check_start(bare)
    assert isinstance(found, Wait)
    assert found.names == ("P1", "lidded", "True")
    wrong = lab.submit(plan(step("arm", move("a", "nest"))))
    assert lab.code(wrong) == "not_accepted"
    lab.write(LabwareHandedOver(LabwareId("P2"), "", Owner("shared")))
    lab.write(LabwareHandedOver(LabwareId("P3"), "", Owner("shared")))
    twice = lab.submit(plan(step("arm", relid("nest", "b"))))
    found = lab.check_start(twice)
    assert isinstance(found, Wait)
    assert found.names == ("P3", "lidded", "False")


def test_the_lid_on_a_plate_belongs_to_whom_the_plate_belongs() -> None:
    lab = lab_with()
    lab.do(DeclareStation(StationName("cell/b"), ("plate+lid",)))
    assert (lid_of(lab, "P1"), lab.owner("P2")) == ("P2", "shared")
    lab.write(LabwareHandedOver(LabwareId("P1"), "", Owner("user:ada")))
    assert lab.owner("P2") == "user:ada"
    run = lab.submit(plan(step("arm", move("b", "a"))))
    action = lab.start(run)
    assert lab.owner("P2") == f"run:{run}"
    lab.finish(action)
    assert (lab.owner("P1"), lab.owner("P2")) == ("user:ada", "user:ada")


@pytest.mark.parametrize(("choice", "lidded", "nest"), [("source", "P2", []), ("target", "", ["P2"])])
def test_a_lid_that_was_half_taken_off_leaves_its_plate_in_doubt(
    choice: str, lidded: str, nest: list[str]
) -> None:
    lab = lab_with()
    run = lab.submit(plan(step("arm", take("stack", "dev.n")), step("arm", unlid("dev.n", "nest")), USES))
    lab.step(run, 0)
    action = lab.start(run, 1)
    lab.fail(action)
    lab.write(LabwareHandedOver(LabwareId("P1"), "", Owner("shared")))
    other = lab.submit(plan(USES))
    assert lab.code(other) == "uncertain"
    lab.answer(lab.question("lost_labware"), choice)
    assert (lid_of(lab, "P1"), lab.at("nest"), lab.at("dev.n")) == (lidded, nest, ["P1"])
    assert lab.code(other) == ("requires" if lidded else "")
    lab.check_log()


@pytest.mark.parametrize(("choice", "lidded", "nest"), [("done", "P2", []), ("not_done", "", ["P2"])])
def test_a_lid_that_was_put_on_by_who_knows_whom_is_asked_for(
    choice: str, lidded: str, nest: list[str]
) -> None:
    lab = lab_with()
    run = lab.submit(there_and_back())
    lab.step(run, 0)
    lab.step(run, 1)
    action = lab.start(run, 2)
    lab.doubt(action)
    assert lab.state.bench.is_lid_in_doubt(lab.state.bench.labware[LabwareId("P1")])
    lab.answer(lab.question("unknown_action"), choice)
    assert (lid_of(lab, "P1"), lab.at("nest"), lab.at("a")) == (lidded, nest, ["P1"])
    lab.check_log()


def test_a_lid_that_is_gone_leaves_a_bare_plate() -> None:
    lab = lab_with()
    run = lab.submit(there_and_back())
    lab.step(run, 0)
    lab.doubt(lab.start(run, 1))
    lab.answer(lab.question("unknown_action"), "gone")
    assert lid_of(lab, "P1") == ""
    assert LabwareId("P2") not in lab.state.bench.labware
    lab.check_log()


def test_a_lid_seen_in_the_hand_and_put_back_by_a_person_lies_on_its_plate_again() -> None:
    """The answer is that the step was not done, though the lid has been seen off its plate."""
    lab = lab_with()
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", unlid("a", "nest")), USES))
    lab.step(run, 0)
    lab.doubt(lab.start(run, 1))
    lab.write(LabwareObserved(LabwareId("P2"), "", StationName("cell/b"), "arm"))
    assert lid_of(lab, "P1") == ""
    lab.answer(lab.question("unknown_action"), "not_done")
    assert (lab.at("a"), lab.at("nest"), lid_of(lab, "P1")) == (["P1"], [], "P2")
    lab.check_log()
