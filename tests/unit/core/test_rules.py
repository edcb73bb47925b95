"""What is legal here and now, and the first thing that is not."""

from __future__ import annotations

import pytest

from labos.core import reasons
from labos.core.binding import explain_missing, find_usable, is_same
from labos.core.decide.lab import DeclareStation
from labos.core.decide.nodes import LoseNode, ReportState, TakeOut
from labos.core.holding import find_other_holder
from labos.core.ids import LabwareId, Owner, RunId
from labos.core.labware import LabwareHandedOver
from labos.core.model import StationSpec
from labos.core.modules import VariableSet
from labos.core.rules import check_module_free
from labos.core.waits import Wait, list_party
from tests.support.bench import (
    Driver,
    claims,
    consumes,
    module,
    move,
    needs,
    plan,
    requires,
    route,
    sets,
    small,
    small_cell,
    station,
    step,
    take,
    workcell,
)


def place_owned(lab: Driver, place: str, owner: str, labware: str = "plate") -> LabwareId:
    """Labware of an owner at a station."""
    before = lab.at(place)
    lab.do(DeclareStation(lab.state.bench.stations[f"cell/{place}"].spec.name, (labware,)))  # type: ignore[index]
    (name,) = set(lab.at(place)) - set(before)
    lab.write(LabwareHandedOver(LabwareId(name), "", Owner(owner)))
    return LabwareId(name)


def wait(lab: Driver, run: str, index: int = 0) -> Wait:
    found = lab.check_start(run, index)
    assert isinstance(found, Wait)
    return found


# -- the module -------------------------------------------------------------------------------------


def test_a_module_has_to_be_there_well_and_idle() -> None:
    lab = small()
    run = lab.submit(plan(step("dev")))
    dev = lab.state.modules.by_name["cell/dev"].spec.name  # type: ignore[index]
    lab.do(ReportState(dev, "BUSY"))
    assert (wait(lab, run).code, wait(lab, run).blocked) == ("module_busy", False)
    lab.do(ReportState(dev, "ERROR", "jam"))
    assert (wait(lab, run).names, wait(lab, run).blocked) == (("cell/dev", "ERROR", "jam"), True)
    lab.do(LoseNode(dev, "i1", "silent"))
    assert (wait(lab, run).code, wait(lab, run).names[1]) == ("module_down", "GONE")
    lab.do(TakeOut(dev, "service"))
    assert wait(lab, run).names == ("cell/dev", "service")
    missing = step("laser")
    found = check_module_free(lab.state, lab.run(run), missing)
    assert found is not None
    assert (found.code, found.blocked) == ("no_module", True)


def test_one_exclusive_action_at_a_time() -> None:
    lab = small()
    first, second = lab.submit(plan(step("dev"))), lab.submit(plan(step("dev")))
    query = lab.submit(plan(step("dev", exclusive=False)))
    action = lab.start(first)
    assert wait(lab, second) == Wait(reasons.ModuleBusy("cell/dev"), ("module:cell/dev",))
    assert lab.code(query) == ""
    lab.finish(action)
    assert lab.code(second) == ""


def test_nothing_starts_on_a_module_while_an_arm_reaches_in() -> None:
    lab = small()
    lab.stock("a", 1)
    mine = plan(step("arm", move("a", "dev.n1")), step("arm", move("dev.n1", "b")))
    run, other = lab.submit(mine), lab.submit(plan(step("dev")))
    action = lab.start(run)
    assert lab.code(other) == "held"
    lab.write(LabwareHandedOver(LabwareId("P1"), run, Owner("shared")))
    lab.finish(action)
    lab.write(LabwareHandedOver(LabwareId("P1"), "", Owner("shared")))
    assert lab.code(other) == ""
    action = lab.start(run, 1)
    lab.write(LabwareHandedOver(LabwareId("P1"), "", Owner("shared")))
    reached = wait(lab, other)
    assert reached.code == "reached_into"
    assert set(reached.on) == {"station:cell/dev.n1", "module:cell/arm"}


# -- holding ----------------------------------------------------------------------------------------


def test_a_module_is_held_from_the_first_labware_until_it_left_and_the_lid_is_at_rest() -> None:
    lab = small()
    run = lab.submit(
        plan(
            step("arm", take("stack", "dev.n1")),
            step("dev", needs(), sets("lid", "closed")),
            step("cam"),
            step("dev", sets("lid", "open")),
            step("arm", move("dev.n1", "b")),
        )
    )
    other = lab.submit(plan(step("dev")), user="bob")
    assert lab.code(other) == ""
    action = lab.start(run)
    assert wait(lab, other).names == ("cell/dev", "run:R1")
    lab.finish(action)
    for index in (1, 2, 3):
        assert wait(lab, other).names == ("cell/dev", "run:R1")
        lab.step(run, index)
    assert lab.code(other) == "held"
    action = lab.start(run, 4)
    assert lab.code(other) == "held"
    lab.finish(action)
    assert lab.code(other) == ""


def test_a_lid_left_away_from_rest_holds_without_labware() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", sets("lid", "closed")), step("cam")))
    other = lab.submit(plan(step("dev")))
    lab.step(run)
    assert wait(lab, other).names == ("cell/dev", "run:R1")
    assert find_other_holder(lab.state, lab.state.modules.by_name["cell/dev"].spec.name, lab.run(run)) == ""  # type: ignore[index]
    lab.step(run, 1)
    assert lab.code(other) == "", "a run that has ended holds nothing"


def test_a_deck_has_one_holder_also_for_arms_under_way() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    first, second = lab.submit(route("a", "dev.n1")), lab.submit(route("b", "dev.n2", arm="arm2"))
    third = lab.submit(route("stack", "dev.n2", arm="arm2"))
    action = lab.start(first)
    assert wait(lab, second).names == ("cell/dev", "run:R1")
    assert lab.code(third) == "held"
    lab.finish(action)
    assert lab.code(second) == "", "the run has ended, and its user is this one's"


def test_labware_of_nobody_in_particular_holds_against_everybody_but_its_owner() -> None:
    lab = small()
    place_owned(lab, "dev.n1", "user:bob")
    assert wait(lab, lab.submit(plan(step("dev")))).names == ("cell/dev", "user:bob")
    assert lab.code(lab.submit(plan(step("dev")), user="bob")) == ""
    lab.write(LabwareHandedOver(LabwareId("P1"), "", Owner("")))
    assert wait(lab, "R2").names == ("cell/dev", "nobody")


def test_stations_without_a_claim_are_for_everybody() -> None:
    lab = small()
    place_owned(lab, "cam.nest", "user:bob")
    assert lab.code(lab.submit(plan(step("cam")))) == ""


# -- reaching in ------------------------------------------------------------------------------------


@pytest.mark.parametrize("plate_at", ["a", "stack"])
def test_an_arm_needs_an_open_lid_and_an_idle_module(plate_at: str) -> None:
    lab = small()
    if plate_at == "a":
        lab.stock("a", 1)
    run = lab.submit(route(plate_at, "dev.n1"))
    busy = lab.submit(plan(step("dev")))
    action = lab.start(busy)
    assert lab.code(run) == "module_busy"
    lab.finish(action)
    lab.write(VariableSet(lab.state.modules.by_name["cell/dev"].spec.name, "lid", "closed"))  # type: ignore[index]
    assert wait(lab, run) == Wait(reasons.NoAccess("cell/dev.n1", "lid", "open"), ("module:cell/dev",))
    lab.write(VariableSet(lab.state.modules.by_name["cell/dev"].spec.name, "lid", None))  # type: ignore[index]
    assert lab.code(run) == "no_access", "a lid of which nothing is known is not open"


def test_a_closed_source_is_not_reached_either() -> None:
    lab = small()
    lab.step(lab.submit(route("stack", "dev.n1")))
    lab.write(VariableSet(lab.state.modules.by_name["cell/dev"].spec.name, "lid", "closed"))  # type: ignore[index]
    assert lab.code(lab.submit(route("dev.n1", "a"))) == "no_access"


def test_stores_are_reached_while_their_module_works() -> None:
    cell = workcell([module("arm"), module("inc")], [station("inc.h", "hotel", 3), station("a")])
    lab = Driver(cell)
    lab.stock("a", 1)
    run = lab.submit(route("a", "inc.h"))
    lab.start(lab.submit(plan(step("inc"))))
    assert lab.code(run) == ""


# -- room -------------------------------------------------------------------------------------------


def test_a_target_is_reserved_from_the_request_on() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("c", 1)
    first, second = lab.submit(route("a", "b")), lab.submit(route("c", "b", arm="arm2"))
    lab.start(first)
    found = wait(lab, second)
    assert (found.code, found.names) == ("occupied", ("cell/b", "an arrival under way"))
    assert set(found.on) == {"station:cell/b", "module:cell/arm"}


def test_a_regrip_station_is_reserved_and_has_to_be_free() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(plan(step("arm", move("a", "b", via="c"))))
    other = lab.submit(route("stack", "c", arm="arm2"))
    action = lab.start(run)
    assert lab.code(other) == "occupied"
    lab.finish(action)
    lab.step(other)
    lab.stock("a", 1)
    again = lab.submit(plan(step("arm", move("a", "hotel", via="c"))))
    assert wait(lab, again).names == ("cell/c", "P2")


def test_a_hotel_has_room_for_some() -> None:
    lab = small()
    for _ in range(3):
        lab.step(lab.submit(route("stack", "hotel")))
    assert wait(lab, lab.submit(route("stack", "hotel"))).names == ("cell/hotel", "P1, P2, P3")


def test_one_action_does_not_overfill_what_has_room_for_each_of_its_motions() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.stock("b", 1)
    run = lab.submit(plan(step("arm", move("a", "c"), move("b", "c"))))
    assert wait(lab, run).names == ("cell/c", "2 arrivals at once")
    pair = plan(step("arm", move("a", "hotel"), move("b", "hotel")))
    assert lab.code(lab.submit(pair)) == ""
    twice = lab.submit(plan(step("arm2", take("stack", "hotel"), take("stack", "hotel"))))
    assert lab.code(twice) == ""
    lab.stock("stack", 1)
    assert lab.code(twice) == "stack_empty"
    assert lab.code(lab.submit(plan(step("arm", move("a", "hotel"), move("a", "c"))))) == "nothing_there"


@pytest.mark.parametrize("place", ["a", "hotel", "dev.n1"])
def test_what_nobody_declared_is_unknown_not_empty(place: str) -> None:
    lab = Driver(small_cell(), empty=False)
    lab.stock("stack", 2)
    run = lab.submit(route("stack", place))
    assert (wait(lab, run).code, wait(lab, run).blocked) == ("undeclared", True)
    away = lab.submit(route(place, "trash"))
    assert lab.code(away) == "undeclared"
    assert lab.code(lab.submit(route("stack", "trash"))) == ""


def test_types_that_are_not_accepted() -> None:
    lab = small()
    lab.stock("a", 1, "lid")
    found = wait(lab, lab.submit(route("a", "cam.nest")))
    assert (found.code, found.names, found.blocked) == ("not_accepted", ("cell/cam.nest", "lid"), True)


# -- stacks -----------------------------------------------------------------------------------------


def test_a_stack_is_last_in_first_out() -> None:
    lab = small(stock=0)
    lab.do(DeclareStation("cell/stack", ("lid", "plate")))  # type: ignore[arg-type]
    first = lab.submit(route("stack", "a"))
    lab.step(first)
    assert lab.state.bench.labware["P1"].type == "plate"  # type: ignore[index]
    back = lab.submit(route("a", "stack"))
    lab.step(back)
    buried = wait(lab, lab.submit(route("stack", "b")))
    assert (buried.code, buried.names) == ("buried", ("cell/stack", "P1"))
    off = lab.submit(plan(step("arm", move("stack", "c"))))
    lab.step(off)
    lab.step(lab.submit(route("stack", "b")))
    assert lab.state.bench.labware["P2"].type == "lid"  # type: ignore[index]


def test_what_is_buried_is_out_of_reach_in_a_stack_but_not_in_a_hotel() -> None:
    for kind, code in [("stack", "not_yours"), ("hotel", "")]:
        cell = workcell([module("arm")], [station("pile", kind, 3), station("a"), station("b")])  # type: ignore[arg-type]
        lab = Driver(cell)
        lab.stock("a", 1)
        mine = lab.submit(plan(step("arm", move("a", "pile")), step("arm", move("pile", "b"))))
        lab.step(mine)
        lab.stock("a", 1)
        lab.step(lab.submit(route("a", "pile"), user="bob"))
        assert lab.code(mine, 1) == code


def test_one_hand_at_a_time_reaches_for_a_stack() -> None:
    """Of two that put down at once nobody could say whose plate came to lie on top."""
    cell = workcell(
        [module("arm"), module("arm2")],
        [station("pile", "stack", 3), *(station(name) for name in "abc")],  # type: ignore[arg-type]
    )
    lab = Driver(cell)
    lab.stock("a", 1)
    lab.stock("b", 1)
    first, second = lab.submit(route("a", "pile")), lab.submit(route("b", "pile", arm="arm2"))
    putting = lab.start(first)
    found = wait(lab, second)
    assert (found.code, found.names, found.blocked) == ("reached_into", ("cell/pile",), False)
    lab.finish(putting)
    lab.step(second)
    lab.stock("a", 1)
    third, fourth = lab.submit(route("pile", "c")), lab.submit(route("a", "pile", arm="arm2"))
    taking = lab.start(third)
    assert lab.code(fourth) == "reached_into"
    lab.finish(taking)
    assert lab.code(fourth) == ""


def test_two_arms_take_from_one_stack_at_once_only_what_is_alike() -> None:
    for top, code in (("plate", ""), ("lid", "reached_into")):
        lab = small(stock=0)
        lab.do(DeclareStation("cell/stack", ("plate", top)))  # type: ignore[arg-type]
        first, second = lab.submit(route("stack", "a")), lab.submit(route("stack", "b", arm="arm2"))
        action = lab.start(first)
        assert lab.code(second) == code
        lab.finish(action)
        assert lab.code(second) == ""


def test_two_arms_do_not_take_the_last_item_both() -> None:
    lab = small(stock=1)
    first, second = lab.submit(route("stack", "a")), lab.submit(route("stack", "b", arm="arm2"))
    action = lab.start(first)
    assert (wait(lab, second).code, wait(lab, second).blocked) == ("stack_empty", True)
    lab.finish(action)
    lab.stock("stack", 1)
    lab.step(second)
    lab.check_log()


def test_a_full_hotel_and_a_full_waste() -> None:
    lab = small(stock=9)
    for number in range(4):
        run = lab.submit(route("stack", "a", "trash"))
        lab.step(run)
        action = lab.start(run, 1)
        assert lab.state.bench.stations["cell/trash"].count == number + 1  # type: ignore[index]
        lab.finish(action)
    run = lab.submit(route("stack", "a", "trash"))
    lab.step(run)
    assert (wait(lab, run, 1).code, wait(lab, run, 1).blocked) == ("waste_full", True)


# -- resources, variables ---------------------------------------------------------------------------


def test_what_is_used_up_stops_and_what_was_never_declared_does_not() -> None:
    lab = small()
    run = lab.submit(plan(step("dev", consumes("tips", 8.0)), step("dev", consumes("tips", 8.0))))
    lab.step(run)
    found = wait(lab, run, 1)
    assert (found.code, found.names, found.blocked) == ("used_up", ("cell/dev", "tips"), True)
    lab.level("dev", "tips", 8.0)
    lab.step(run, 1)
    assert lab.state.resources.find_left("cell/dev", "tips") == 0.0  # type: ignore[arg-type]
    assert lab.code(lab.submit(plan(step("dev", consumes("water", 1e9))))) == ""


def test_variables_of_module_and_labware_have_to_fit() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(
        plan(
            step("dev", needs("a"), requires("sealed", False, "labware"), sets("sealed", True, "labware")),
            step("dev", needs("a"), requires("sealed", False, "labware")),
        )
    )
    lab.step(run)
    assert wait(lab, run, 1) == Wait(reasons.Requires("P1", "sealed", "False"), ("station:cell/a",))
    other = lab.submit(plan(step("dev", requires("lid", "closed"))))
    assert wait(lab, other) == Wait(reasons.Requires("cell/dev", "lid", "closed"), ("module:cell/dev",))
    assert lab.code(lab.submit(plan(step("dev", requires("lid", "open"))))) == ""


@pytest.mark.parametrize(
    ("actual", "wanted", "fits"),
    [
        (None, False, True),
        (None, True, False),
        (True, True, True),
        ("open", "open", True),
        (None, "open", False),
    ],
)
def test_a_variable_that_was_never_set_counts_as_false(actual: object, wanted: object, fits: bool) -> None:
    assert is_same(actual, wanted) is fits


# -- whose labware ----------------------------------------------------------------------------------


def test_a_run_uses_its_own_labware_before_its_experiments_its_users_and_what_is_shared() -> None:
    lab = small()
    name = lab.experiment()
    run = lab.submit(plan(step("arm", needs("hotel"))), experiment=name)
    assert list_party(lab.run(run)) == (f"run:{run}", "experiment:E1", "user:ada", "shared")
    hotel = StationSpec(lab.state.bench.stations["cell/hotel"].spec.name, "hotel", capacity=9)  # type: ignore[index]
    lab.state.bench.stations[hotel.name].spec = hotel
    owners = ["shared", "user:bob", "user:ada", "experiment:E1", f"run:{run}"]
    lab.do(DeclareStation(hotel.name, ("plate",) * len(owners)))
    for labware, owner in zip(lab.at("hotel"), owners, strict=True):
        lab.write(LabwareHandedOver(LabwareId(labware), "", Owner(owner)))
    for expected in reversed(owners):
        if expected == "user:bob":
            continue
        found = find_usable(lab.state, lab.run(run), hotel.name)
        assert found is not None
        assert found.owner == expected
        lab.write(LabwareHandedOver(found.id, "", Owner("user:bob")))
    found_wait = wait(lab, run)
    assert (found_wait.code, found_wait.names[2], found_wait.blocked) == ("not_yours", "user:bob", True)


def test_using_labware_makes_it_the_runs() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(plan(step("cam", needs("a")), step("cam")))
    lab.start(run)
    assert lab.owner("P1") == "run:R1"
    assert lab.code(lab.submit(route("a", "b"))) == "in_motion"


def test_labware_without_a_named_place_is_looked_for_at_the_module() -> None:
    lab = small()
    run = lab.submit(plan(step("arm", take("stack", "dev.n2")), step("dev", needs())))
    assert lab.code(run, 0) == ""
    lab.step(run)
    assert lab.check_start(run, 1)[0].labware == "P1"  # type: ignore[index,union-attr]
    alone = lab.submit(plan(step("arm", needs())))
    assert wait(lab, alone).names == ("cell/arm",)


def test_why_there_is_nothing_to_use() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(plan(step("arm", move("a", "b")), step("cam", needs("b")), parallel=True))
    lab.start(run)
    found = wait(lab, run, 1)
    assert (found.code, found.blocked) == ("still_to_come", False)
    other = lab.submit(plan(step("cam", needs("c"))))
    assert (wait(lab, other).code, wait(lab, other).blocked) == ("nothing_there", True)
    assert wait(lab, lab.submit(route("a", "c", arm="arm2"))).code == "in_motion"
    assert explain_missing(lab.state, lab.run(run), "cell/nowhere").code == "still_to_come"  # type: ignore[arg-type]
    assert find_usable(lab.state, lab.run(run), "cell/nowhere") is None  # type: ignore[arg-type]


def test_uncertain_labware_makes_only_its_places_wait() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.doubt(lab.start(lab.submit(route("a", "b"))))
    assert lab.code(lab.submit(route("a", "hotel", arm="arm2"))) == "uncertain"
    assert lab.code(lab.submit(route("stack", "c", arm="arm2"))) == ""


def test_labware_that_may_stand_on_a_deck_claims_it() -> None:
    """It was to be carried away, and nobody knows whether it was: it may turn out to be there still."""
    lab = small()
    run = lab.submit(route("stack", "dev.n1", "a"))
    lab.step(run)
    other = lab.submit(route("stack", "dev.n2", "b", arm="arm2"), user="bob")
    lab.doubt(lab.start(run, 1))
    assert wait(lab, other).names == ("cell/dev", "run:R1")
    lab.answer(lab.question("unknown_action"), "not_done")
    assert wait(lab, other).names == ("cell/dev", "run:R1")
    lab.step(run, 1)
    assert lab.code(other) == ""


def test_a_claim_by_a_run_that_has_ended_is_its_heirs() -> None:
    lab = small()
    run = lab.submit(route("stack", "dev.n1"))
    lab.step(run)
    assert lab.code(lab.submit(plan(step("dev")))) == ""
    assert wait(lab, lab.submit(plan(step("dev")), user="bob")).names == ("cell/dev", "user:ada")
    assert RunId("R1") not in lab.state.runs.active


def test_on_one_claim_a_deck_is_one_runs_independent_slots_are_anybodys() -> None:
    for claim, code in ((True, "held"), (False, "")):
        deck = [station(f"dev.n{number}", "deck", claim=claim) for number in (1, 2)]
        cell = small_cell(
            stations=[station("stack", "stack", 9), *deck], modules=[module("arm"), module("dev")]
        )
        lab = Driver(cell)
        lab.stock("stack", 9)
        lab.step(lab.submit(plan(*route("stack", "dev.n1").steps, step("dev"))))
        other = lab.submit(plan(*route("stack", "dev.n2").steps, step("dev")), user="bob")
        assert lab.code(other) == code


def test_a_stack_gives_only_what_lies_on_top_and_a_hotel_anything() -> None:
    for kind, code in (("stack", "not_yours"), ("hotel", "")):
        store = station("store", kind, 3)  # type: ignore[arg-type]
        lab = Driver(workcell([module("arm")], [store, *map(station, "abc")]))
        place_owned(lab, "a", "user:ada")
        place_owned(lab, "b", "user:bob")
        for user, place in (("ada", "a"), ("bob", "b")):
            lab.step(lab.submit(route(place, "store"), user=user))
        assert lab.at("store") == ["P1", "P2"]
        assert lab.code(lab.submit(route("store", "c"), user="ada")) == code
        assert lab.code(lab.submit(route("store", "c"), user="bob")) == ""


@pytest.mark.parametrize("effects", ["all", "partial"])
def test_a_setpoint_that_the_last_step_of_a_run_claims_is_free_again_when_the_run_has_ended(
    effects: str,
) -> None:
    lab = small()
    first = lab.submit(plan(step("dev", claims("t", 37))))
    action = lab.start(first)
    if effects == "all":
        lab.finish(action)
    else:
        lab.fail(action, effects)
    assert first not in lab.state.runs.active
    assert lab.code(lab.submit(plan(step("dev", claims("t", 42)), step("cam")))) == ""
    lab.check_log()


def test_a_stack_behind_a_door_is_reached_through_it() -> None:
    """Taking off a stack needs its door open as carrying away what lies there does; and while another run
    has left the door open, it is that run's."""
    cell = workcell(
        [module("arm"), module("oven", variables={"door": "shut"}, rest={"door": "shut"})],
        [station("oven.mag", "stack", 9, access={"door": "open"}), station("a")],
    )
    lab = Driver(cell)
    lab.stock("oven.mag", 2)
    opens, takes = step("oven", sets("door", "open")), step("arm", take("oven.mag", "a"))
    run = lab.submit(plan(opens, takes, parallel=True))
    other = lab.submit(plan(takes))
    assert lab.code(other) == "no_access"
    lab.step(run, 0)
    assert (lab.code(run, 1), lab.code(other)) == ("", "held")


def test_one_action_carries_two_pieces_off_one_place() -> None:
    lab = small()
    lab.stock("hotel", 2)
    run = lab.submit(plan(step("arm", move("hotel", "a"), move("hotel", "b"))))
    assert lab.code(run) == ""
    lab.step(run)
    assert sorted(lab.at("a") + lab.at("b")) == ["P1", "P2"]
    three = lab.submit(plan(step("arm", move("a", "c"), move("a", "hotel"))), "ada")
    assert lab.code(three) == "nothing_there"
    lab.check_log()
