"""Poses have versions, and the first move to a new one is slow where the driver can be slow."""

from __future__ import annotations

import msgspec

from labos.core.decide.stock import UnloadStation
from labos.core.decide.teach import TeachLocation
from labos.core.ids import ModuleName, StationName
from labos.core.modules import LocationTaught
from tests.support.bench import Driver, full, move, plan, relid, small, small_cell, step, take, unlid


def teach(*pose: float) -> TeachLocation:
    return TeachLocation(ModuleName(full("arm")), StationName(full("a")), pose, "ada", "moved")


def make_move_args(lab: Driver, **args: object) -> dict[str, object]:
    """The arguments with which a plate is brought to the station."""
    run = lab.submit(plan(step("arm", take("stack", "a"), args=args), step("arm", move("a", "trash"))))
    action = lab.start(run)
    told = dict(lab.state.actions.open[action].args)
    lab.finish(action)
    lab.step(run, 1)
    return told


def test_each_pose_is_a_version() -> None:
    lab = small()
    assert [e.version for e in lab.do(teach(1, 2)) if isinstance(e, LocationTaught)] == [1]
    assert lab.do(teach(1, 2)) == []
    assert [e.version for e in lab.do(teach(1, 3)) if isinstance(e, LocationTaught)] == [2]
    assert lab.reject(teach(1, 2, 3)).code == "bad_pose"
    assert lab.reject(teach()).code == "bad_pose"
    lab.check_log()


def test_the_first_move_is_slow_where_the_driver_can_be() -> None:
    lab = small()
    assert make_move_args(lab, slow=False) == {"slow": False}
    lab.do(teach(1, 2))
    assert make_move_args(lab) == {}
    assert make_move_args(lab, slow=False) == {"slow": True}
    assert make_move_args(lab, slow=False) == {"slow": False}
    lab.check_log()


def test_poses_are_not_changed_under_a_moving_arm() -> None:
    lab = small()
    lab.start(lab.submit(plan(step("arm", take("stack", "a")))))
    assert lab.reject(teach(1, 2)).code == "module_in_use"


TOLD: dict[str, object] = {"slow": False, "labware_type": "", "plate_type": ""}


def teach_type(kind: str, *pose: float, station: str = "a") -> TeachLocation:
    place = StationName(full(station))
    return TeachLocation(ModuleName(full("arm")), place, pose, "ada", labware_type=kind)


def make_carry_args(lab: Driver, kind: str) -> dict[str, object]:
    """The arguments with which labware of a type is brought from b to a."""
    lab.stock("b", 1, kind)
    run = lab.submit(plan(step("arm", move("b", "a"), args=TOLD), step("arm", move("a", "trash"))))
    action = lab.start(run)
    told = dict(lab.state.actions.open[action].args)
    lab.finish(action)
    lab.step(run, 1)
    lab.do(UnloadStation(StationName(full("trash")), "ada"))
    return told


def test_a_labware_type_has_versions_of_its_own() -> None:
    lab = small()
    refusal = lab.reject(teach_type("deep", 5, 6))
    assert (refusal.code, refusal.remedy) == (
        "no_pose",
        "Teach the station first, without a labware type.",
    )
    lab.do(teach(1, 2))
    taught = [lab.do(teach_type("deep", 5, number)) for number in (6, 6, 7)]
    versions = [[e.version for e in events if isinstance(e, LocationTaught)] for events in taught]
    assert versions == [[1], [], [2]]
    assert lab.reject(teach_type("deep", 5)).code == "bad_pose"
    arm = lab.state.modules.by_name[ModuleName(full("arm"))]
    at = StationName(full("a"))
    assert (arm.find_pose(at), arm.find_pose(at, "deep"), arm.find_pose(at, "flat")) == ((1, 2), (5, 7), None)
    assert arm.list_poses_by_type() == {"deep": {"a": [5, 7]}}
    lab.check_log()


def test_the_first_move_is_slow_for_each_type_that_was_taught() -> None:
    lab = small()
    flat = {"slow": False, "labware_type": "flat", "plate_type": ""}
    deep = {**flat, "labware_type": "deep"}
    assert make_carry_args(lab, "flat") == flat
    lab.do(teach(1, 2))
    lab.do(teach_type("deep", 5, 6))
    assert make_carry_args(lab, "flat") == {**flat, "slow": True}
    assert make_carry_args(lab, "flat") == flat
    assert make_carry_args(lab, "deep") == {**deep, "slow": True}
    assert make_carry_args(lab, "deep") == deep
    # A new pose of the station is not tried by labware that has its own.
    lab.do(teach(1, 3))
    assert make_carry_args(lab, "deep") == deep
    assert make_carry_args(lab, "flat") == {**flat, "slow": True}
    lab.check_log()


def test_a_pose_in_the_workcell_file_goes_before_the_stations_own() -> None:
    cell = small_cell()
    poses = {"poses": {"a": [1.0, 2.0]}, "poses_of": {"deep": {"a": [5.0, 6.0]}}}
    modules = tuple(
        msgspec.structs.replace(module, config=poses) if module.name == full("arm") else module
        for module in cell.modules
    )
    lab = Driver(msgspec.structs.replace(cell, modules=modules))
    lab.do(teach(1, 2))
    assert make_carry_args(lab, "deep")["slow"] is False
    assert make_carry_args(lab, "flat")["slow"] is True
    assert lab.reject(teach_type("deep", 5)).code == "bad_pose"
    lab.do(teach_type("deep", 7, 8))
    assert make_carry_args(lab, "deep")["slow"] is True
    lab.check_log()


def test_an_arm_is_told_what_it_takes_and_whose_lid_it_carries() -> None:
    lab = small()
    lab.stock("stack", 2, "flat")
    lab.stock("hotel", 1, "deep+cap")
    steps = (
        step("arm", take("stack", "a"), args=TOLD),
        step("arm", move("a", "trash"), args={**TOLD, "labware_type": "said"}),
        step("arm", unlid("hotel", "b"), args=TOLD),
        step("arm", relid("b", "hotel"), args=TOLD),
    )
    run, told = lab.submit(plan(*steps)), []
    for index in range(len(steps)):
        action = lab.start(run, index)
        args = lab.state.actions.open[action].args
        told.append((args["labware_type"], args["plate_type"]))
        lab.finish(action)
    assert told == [("flat", ""), ("said", ""), ("cap", "deep"), ("cap", "deep")]
    lab.check_log()


def test_a_lids_plate_is_found_by_the_plates_pose() -> None:
    lab = small()
    lab.stock("c", 1, "deep+cap")
    lab.do(TeachLocation(ModuleName(full("arm")), StationName(full("c")), (1, 2), "ada"))
    lab.do(teach_type("cap", 3, 4, station="c"))
    lab.do(teach_type("deep", 5, 6, station="c"))
    run = lab.submit(plan(step("arm", unlid("c", "b"), args=TOLD)))
    action = lab.start(run)
    arm = lab.state.modules.by_name[ModuleName(full("arm"))]
    assert arm.in_flight[action].proving == ((StationName(full("c")), "deep"),)
    lab.finish(action)
    proven = {kind: taught.proven for kind, taught in arm.taught[StationName(full("c"))].items() if kind}
    assert proven == {"cap": False, "deep": True}
    lab.check_log()
