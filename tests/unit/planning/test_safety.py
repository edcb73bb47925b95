"""No start takes away anybody's way to the end."""

from __future__ import annotations

import random

import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.nodes import LoseNode
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.ids import ModuleName
from labos.core.model import Plan
from labos.planning.obstacle import find_obstacle
from labos.planning.safety import Safety
from labos.planning.scheduler import Scheduler
from labos.planning.stuck import find_block
from tests.support.bench import (
    Driver,
    hold,
    module,
    move,
    needs,
    plan,
    requires,
    route,
    sets,
    small,
    station,
    step,
    take,
    workcell,
)


def nests(*names: str, stock: int = 9, **more: int) -> Driver:
    """Two arms, a stack, a waste, and nests of capacity 1 (or as said)."""
    places = [station(name, capacity=more.get(name, 1)) for name in names]
    cell = workcell(
        [module("arm"), module("arm2"), module("dev"), module("cam")],
        [station("stack", "stack", 20), station("trash", "waste", 50), station("hotel", "hotel", 6), *places],
    )
    lab = Driver(cell)
    if stock:
        lab.stock("stack", stock)
    return lab


def works(lab: Driver, seed: int = 0) -> bool:
    return lab.work(random.Random(seed))


# -- who would trap whom ---------------------------------------------------------------------------


def test_two_that_would_swap_places_do_not_meet() -> None:
    lab = nests("x", "y")
    first = lab.submit(route("stack", "x", "y", "trash"))
    second = lab.submit(route("stack", "y", "x", "trash", arm="arm2"))
    lab.step(first)
    assert lab.code(second) == "", "the rules alone would let it in"
    assert Safety().list_trapped(lab.state, lab.run(second), 0) == [first, second]
    assert lab.pump() == ["R1#1"]
    assert works(lab)


def test_by_the_rules_alone_they_do_meet() -> None:
    lab = nests("x", "y")
    lab.submit(route("stack", "x", "y", "trash"))
    lab.submit(route("stack", "y", "x", "trash", arm="arm2"))
    assert not lab.work(random.Random(0), lab.pump_by_rule)


@pytest.mark.parametrize("seed", range(6))
def test_routes_that_come_back_to_where_they_were(seed: int) -> None:
    lab = nests("hub", "u", "v")
    for number in range(6):
        lab.submit(
            route("stack", "hub", ("u", "v")[number % 2], "hub", "trash", arm=("arm", "arm2")[number % 2])
        )
    assert works(lab, seed), lab.describe_stuck()


def test_a_run_that_could_never_come_out_is_not_let_in() -> None:
    lab = nests("x", "y")
    lab.stock("y", 1)
    run = lab.submit(route("stack", "x", "y"), user="eve")
    assert Safety().list_trapped(lab.state, lab.run(run), 0) == [run]
    assert lab.pump() == []
    assert lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)[0][1].code == "no_way_out"
    lab.submit(route("y", "trash"))
    assert works(lab)


def test_steps_that_carry_nothing_are_not_asked_about() -> None:
    lab = nests("x")
    run = lab.submit(plan(step("dev"), step("arm", take("stack", "x"))))
    lab.step(run)
    safety = Safety()
    assert not safety.changes_anything(lab.state, lab.run(run), 0)
    assert safety.changes_anything(lab.state, lab.run(run), 1)


def test_who_does_not_know_how_a_motion_ended_is_hoped_to_go_on() -> None:
    """R1 may have come to b, and has to go on to c: nobody settles there meanwhile."""
    lab = nests("a", "b", "c")
    first = lab.submit(route("stack", "a", "b", "c"))
    lab.step(first)
    lab.doubt(lab.start(first, 1))
    assert Safety().can_reach_end(lab.state, lab.run(first))
    settles = lab.submit(route("stack", "c", arm="arm2"))
    assert Safety().list_trapped(lab.state, lab.run(settles), 0) == [first]


# -- branches of one run ---------------------------------------------------------------------------


def two_branches() -> Plan:
    """Two plates of one run, each of which goes to ``x`` and from there to a place of its own."""
    return plan(
        step("arm", take("stack", "x"), key="first in"),
        step("arm", move("x", "y"), key="first on", after=(0,)),
        step("arm", move("y", "trash"), key="first out", after=(1,)),
        step("arm2", take("stack", "x"), key="second in"),
        step("arm2", move("x", "z"), key="second on", after=(3,)),
        step("arm2", move("z", "trash"), key="second out", after=(4,)),
        parallel=True,
    )


def test_of_two_branches_that_use_one_place_the_one_written_later_may_go_first() -> None:
    lab = nests("x", "y", "z")
    run = lab.submit(two_branches())
    assert Safety().list_trapped(lab.state, lab.run(run), 3) == []
    lab.step(run, 3)
    safety = Safety()
    assert safety.list_trapped(lab.state, lab.run(run), 4) == [], (
        "the order in which it goes on is found again"
    )
    assert works(lab), lab.describe_stuck()


def test_a_branch_that_only_another_run_could_set_free_may_not_go_first() -> None:
    """R1 stands at z and wants to y by way of x: where R2 has a plate at x that has to go to z."""
    lab = nests("x", "y", "z")
    first = lab.submit(route("stack", "z", "x", "trash"))
    second = lab.submit(two_branches())
    lab.step(first)
    assert Safety().list_trapped(lab.state, lab.run(second), 3) == [first, second]
    assert Safety().list_trapped(lab.state, lab.run(second), 0) == []
    assert works(lab), lab.describe_stuck()


def test_two_runs_find_an_order_of_their_branches_together() -> None:
    """R1 has its later branch at x, R2 stands at z: R1's plate has to wait until R2 has gone to w."""
    lab = nests("x", "y", "z", "w")
    first = lab.submit(two_branches())
    second = lab.submit(
        plan(
            step("arm", take("stack", "w"), key="a"),
            step("arm", move("w", "x"), key="b", after=(0,)),
            step("arm", move("x", "trash"), key="c", after=(1,)),
            step("arm", take("stack", "z"), key="d"),
            step("arm", move("z", "w"), key="e", after=(3,)),
            step("arm", move("w", "trash"), key="f", after=(4,)),
            parallel=True,
        )
    )
    lab.step(second, 3)
    assert Safety().list_trapped(lab.state, lab.run(first), 3) == []
    lab.step(first, 3)
    assert Safety().list_trapped(lab.state, lab.run(second), 0) == [first, second], "w is the only way out"
    assert works(lab), lab.describe_stuck()


# -- interleaving ----------------------------------------------------------------------------------

CROSSING = (route("stack", "a", "b", "trash"), route("stack", "b", "c", "a", "trash", arm="arm2"))


def make_crossed() -> Driver:
    """R1 at a wants b; R2 at b wants c and then a: neither can finish alone, both can together."""
    lab = nests("a", "b", "c")
    lab.submit(CROSSING[0])
    lab.submit(CROSSING[1])
    assert lab.pump() == ["R1#0", "R2#0"]
    lab.finish("A1")
    return lab


def test_orders_that_greed_misses_are_found() -> None:
    lab = nests("a", "b", "c")
    first, second = lab.submit(CROSSING[0]), lab.submit(CROSSING[1])
    lab.step(first)
    assert Safety(limit=0).list_trapped(lab.state, lab.run(second), 0) == [first, second]
    patient = Safety()
    assert patient.list_trapped(lab.state, lab.run(second), 0) == []
    assert patient.interleavings >= 1


@pytest.mark.parametrize("seed", range(10))
def test_a_crossing_is_got_through(seed: int) -> None:
    lab = make_crossed()
    assert works(lab, seed), lab.describe_stuck()


def test_who_can_finish_only_together_is_protected_too() -> None:
    """A third one at c, on its way to a, would close the circle."""
    lab = make_crossed()
    lab.finish("A2")
    lab.keys.clear()
    third = lab.submit(route("stack", "c", "a", "trash"))
    for judge in (lab.scheduler.safety, Safety()):
        assert {"R1", "R2"} & set(judge.list_trapped(lab.state, lab.run(third), 0, only_asking=True))
    harmless = lab.submit(route("stack", "c", "trash"))
    assert Safety().list_trapped(lab.state, lab.run(harmless), 0) == []
    assert works(lab), lab.describe_stuck()


@pytest.mark.parametrize("seed", range(6))
def test_who_stays_at_its_end_goes_last(seed: int) -> None:
    """R1 could finish first, but its plate would then stand in R2's way for good."""
    lab = nests("x", "y", "z")
    stays = lab.submit(route("stack", "x", "y"))
    passes = lab.submit(route("stack", "z", "y", "trash", arm="arm2"))
    lab.pump()
    assert list(lab.state.runs.active) == [stays, passes]
    lab.finish("A1")
    lab.scheduler = Scheduler()  # as after a restart: nothing is remembered
    assert works(lab, seed), lab.describe_stuck()


def test_the_next_motion_of_a_witness_needs_no_new_search() -> None:
    lab = make_crossed()
    lab.finish("A2")
    safety = Safety()
    ways = [
        s for s in ("R1#1", "R2#1") if not safety.list_trapped(lab.state, lab.run(s[:2]), 1, only_asking=True)
    ]
    assert ways == ["R2#1"]
    before = safety.searches
    assert safety.list_trapped(lab.state, lab.run("R2"), 1) == []
    assert safety.searches == before


# -- what changes from outside ---------------------------------------------------------------------


def test_a_plate_that_a_person_puts_in_the_way_does_not_freeze_the_others() -> None:
    """R1 cannot end any more, whoever starts: nobody has to wait for it."""
    lab = nests("a", "b", "c")
    lab.submit(route("stack", "a", "b", "trash"))
    assert lab.pump() == ["R1#0"]
    lab.do(PauseRun(lab.run("R1").id))
    lab.finish("A1")
    lab.pump()
    lab.stock("b", 1)
    lab.submit(route("stack", "c", "trash"), user="eve")
    assert lab.pump() == ["R2#0"]
    assert lab.find_missed() == []


def test_a_stack_that_is_emptied_by_hand_does_not_freeze_the_others() -> None:
    lab = nests("a", "b", "c")
    lab.submit(plan(step("arm", take("stack", "a")), step("arm", take("stack", "b")), step("cam")))
    assert lab.pump() == ["R1#0"]
    lab.do(PauseRun(lab.run("R1").id))
    lab.finish("A1")
    lab.pump()
    lab.stock("stack", 0)
    lab.stock("c", 1)
    lab.submit(route("c", "hotel"))
    assert lab.pump() == ["R2#0"]


# -- those who are stuck ---------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["dead module", "paused", "lost labware", "unknown action"])
def test_who_is_stuck_is_an_obstacle_and_freezes_nobody_else(how: str) -> None:
    lab = nests("a", "b", "c", "d")
    stuck = lab.submit(plan(*route("stack", "a", "b", "a", "trash").steps[:3], step("dev")))
    lab.step(stuck)
    if how == "dead module":
        lab.do(LoseNode(ModuleName("cell/dev"), "i1", "power"))
    elif how == "paused":
        lab.do(PauseRun(stuck))
    elif how == "lost labware":
        lab.fail(lab.start(stuck, 1))
    else:
        lab.doubt(lab.start(stuck, 1))
    arm = "arm2"
    for _ in range(3):
        lab.submit(route("stack", "c", "d", "trash", arm=arm), user="bob")
    works(lab)
    left = {*lab.state.runs.active, *lab.state.runs.queued}
    assert left <= {stuck}, lab.describe_stuck()


def test_nobody_is_let_in_who_needs_what_is_dead() -> None:
    lab = nests("a", "b")
    lab.do(LoseNode(ModuleName("cell/dev"), "i1", "power"))
    run = lab.submit(plan(step("arm", take("stack", "a")), step("dev"), step("arm", move("a", "trash"))))
    lab.submit(route("stack", "a", "trash"))
    works(lab)
    assert list(lab.state.runs.queued) == [run]
    lab.join("dev")
    assert works(lab)


def test_who_is_free_again_finds_its_way_open() -> None:
    """A paused run's way is kept open for the time after."""
    lab = nests("a", "b", "c")
    first = lab.submit(route("stack", "a", "b", "trash"))
    lab.pump()
    lab.finish("A1")
    lab.do(PauseRun(first))
    for _ in range(3):
        lab.submit(route("stack", "b", "a", "trash", arm="arm2"))
        lab.submit(route("stack", "c", "b", "trash", arm="arm2"))
    works(lab)
    lab.do(ResumeRun(first))
    assert works(lab), lab.describe_stuck()


def test_a_cancelled_run_leaves_its_plate_and_the_others_go_on() -> None:
    lab = nests("a", "b", "c")
    first = lab.submit(route("stack", "a", "b", "trash"))
    lab.step(first)
    lab.do(CancelRun(first))
    lab.submit(route("stack", "b", "c", "trash"), user="bob")
    assert works(lab)
    assert lab.at("a") == ["P1"]


# -- decks, waste, regrip --------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_decks_with_one_holder(seed: int) -> None:
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("p"), module("q")],
            [
                station("stack", "stack", 20),
                station("trash", "waste", 50),
                *(station(f"{m}.{n}", "deck", claim=True) for m in "pq" for n in "12"),
            ],
        )
    )
    lab.stock("stack", 9)
    for number in range(5):
        there, back = ("p.1", "q.1") if number % 2 else ("q.2", "p.2")
        lab.submit(route("stack", there, back, "trash", arm=("arm", "arm2")[number % 2]), user=f"u{number}")
    assert works(lab, seed), lab.describe_stuck()


def test_a_waste_that_would_be_full_lets_nobody_in() -> None:
    lab = small(stock=9)
    for _ in range(5):
        lab.submit(route("stack", "a", "trash"))
    assert not works(lab)
    assert (len(lab.state.runs.active), len(lab.state.runs.queued)) == (0, 1)


def test_a_regrip_station_is_passed_through_one_by_one() -> None:
    lab = nests("a", "b", "regrip")
    for number in range(4):
        there = ("a", "b")[number % 2]
        arm = ("arm", "arm2")[number % 2]
        lab.submit(plan(step(arm, take("stack", there)), step(arm, move(there, "hotel", via="regrip"))))
    assert works(lab), lab.describe_stuck()


# -- experiments -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_what_experiments_park_can_always_be_cleared_away(seed: int) -> None:
    lab = nests("park1", "park2", "mix", "gate")
    names = []
    for number in (1, 2):
        park = f"park{number}"
        names.append(lab.experiment(closing=route(park, "gate", "trash"), user=f"u{number}"))
        lab.submit(route("stack", "gate", park), experiment=names[-1])
        for _ in range(2):
            lab.submit(route(park, "gate", "mix", park), experiment=names[-1])
    assert works(lab, seed), lab.describe_stuck()
    for name in names:
        lab.end(name)
    assert works(lab, seed)
    assert lab.state.experiments.open == {}
    assert lab.state.bench.labware == {}
    lab.check_log()


def test_a_parked_plate_is_counted_once() -> None:
    """A run that has to park where its experiment has parked already can never end: the closing
    workflow comes only after it."""
    lab = nests("park", "gate")
    name = lab.experiment(closing=route("park", "trash"))
    lab.submit(route("stack", "park"), experiment=name)
    assert works(lab)
    second = lab.submit(route("stack", "gate", "park"), experiment=name)
    assert lab.pump() == []
    assert Safety().list_trapped(lab.state, lab.run(second), 0) == [second, f"experiment:{name}"]


def test_nobody_blocks_the_way_of_a_parked_plate_to_its_end() -> None:
    lab = nests("park", "gate", "out")
    name = lab.experiment(closing=route("park", "gate", "trash"))
    lab.submit(route("stack", "park"), experiment=name)
    assert works(lab)
    blocker = lab.submit(route("stack", "gate", "park", "trash"), user="bob")
    assert lab.pump() == []
    assert Safety().list_trapped(lab.state, lab.run(blocker), 0) == [blocker, f"experiment:{name}"]
    settled = lab.submit(route("stack", "gate"), user="bob")
    assert Safety().list_trapped(lab.state, lab.run(settled), 0) == [f"experiment:{name}"]
    lab.end(name)
    assert works(lab)
    lab.check_log()


def test_two_runs_of_one_experiment_share_its_closing() -> None:
    lab = nests("park", "a", "b")
    name = lab.experiment(closing=route("park", "trash"))
    lab.submit(route("stack", "a", "trash"), experiment=name)
    lab.submit(route("stack", "b", "trash", arm="arm2"), experiment=name)
    assert works(lab)
    assert lab.end(name)


# -- holding, sharing ------------------------------------------------------------------------------


def test_a_module_that_is_held_by_waiting_labware_is_not_needed_by_the_one_it_waits_for() -> None:
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("dev")],
            [
                station("stack", "stack", 9),
                station("dev.n", "deck", claim=True),
                station("y"),
                station("trash", "waste", 9),
            ],
        )
    )
    lab.stock("stack", 5)
    lab.submit(route("stack", "dev.n", "y", "trash"))
    away = step("arm", move("y", "trash"))
    lab.submit(plan(step("arm2", take("stack", "y")), step("dev"), away), user="bob")
    assert works(lab), lab.describe_stuck()


def test_a_lid_that_stays_shut_while_its_run_is_elsewhere() -> None:
    ended = []
    for seed in range(10):
        lab = Driver(
            workcell(
                [
                    module("arm"),
                    module("arm2"),
                    module("dev", variables={"lid": "open"}, rest={"lid": "open"}),
                ],
                [station("stack", "stack", 9), station("x"), station("y"), station("trash", "waste", 9)],
            )
        )
        lab.stock("stack", 5)
        lab.submit(
            plan(
                step("arm", take("stack", "x")),
                step("dev", sets("lid", "shut")),
                step("arm", move("x", "y")),
                step("dev", sets("lid", "open")),
                step("arm", move("y", "trash")),
            )
        )
        lab.submit(plan(step("arm2", take("stack", "y")), step("dev"), step("arm", move("y", "trash"))))
        ended.append(works(lab, seed))
    assert all(ended)


def test_two_runs_do_not_both_count_on_the_one_shared_plate() -> None:
    lab = nests("x", "y", "z")
    lab.stock("x", 1)
    for arm, place in (("arm", "y"), ("arm2", "z")):
        lab.submit(
            plan(
                step(arm, take("stack", place)),
                step(arm, move("x", "trash")),
                step(arm, move(place, "trash")),
            )
        )
    works(lab)
    assert not lab.state.runs.active, lab.describe_stuck()


def test_a_users_own_plate_on_a_deck_does_not_lock_its_user_out() -> None:
    lab = small()
    lab.submit(route("stack", "dev.n1"))
    assert works(lab)
    run = lab.submit(
        plan(step("arm", take("stack", "dev.n2")), step("dev", needs()), step("arm", move("dev.n2", "trash")))
    )
    assert lab.code(run) == ""
    assert works(lab), lab.describe_stuck()


def test_a_regrip_station_with_room_left_is_used() -> None:
    lab = nests("x", "v", "w", v=2)
    lab.stock("v", 1)
    lab.stock("x", 1)
    run = lab.submit(plan(step("arm", move("x", "w", via="v"))))
    assert lab.code(run) == ""
    assert works(lab), lab.describe_stuck()


def test_a_judge_that_only_asks_changes_nothing() -> None:
    lab = make_crossed()
    lab.finish("A2")
    asked = Scheduler()
    for _ in range(2):
        for run in lab.state.runs.active.values():
            asked.list_waits(lab.state, run, lab.now)
    first = next(iter(asked.iterate_proposals(lab.state, lab.now)))
    assert first == next(iter(Scheduler().iterate_proposals(lab.state, lab.now)))


def test_nobody_inside_waits_for_an_application_to_end() -> None:
    """The other could end only once the experiment has closed; the experiment's next run needs what the
    other would hold until then."""
    lab = nests("park", "gate")
    name = lab.experiment(closing=route("park", "trash"))
    lab.step(lab.submit(route("stack", "park"), experiment=name))
    other = lab.submit(route("stack", "gate", "park", "trash", arm="arm2"))
    assert lab.pump() == [], "what is parked may stay for ever"
    waits = lab.scheduler.list_waits(lab.state, lab.run(other), lab.now)
    assert [wait.code for _, wait in waits] == ["no_way_out"]
    assert find_obstacle(Safety(), lab.state, lab.run(other)) == (
        "'to park' needs room at park, where P1 of experiment E1 stands"
    )
    again = lab.submit(route("park", "gate", "park"), experiment=name)
    assert lab.pump() == [f"{again}#0"]
    lab.work(random.Random(0))
    assert again not in lab.state.runs.active
    lab.end(name)
    assert works(lab), lab.describe_stuck()
    assert other not in lab.state.runs.active


def test_nobody_parks_for_long_where_somebody_who_is_stuck_has_to_pass() -> None:
    """Once it goes on, it would wait for the application; which may wait for it."""
    lab = nests("park", "gate")
    first = lab.submit(route("stack", "gate", "park", "trash", arm="arm2"))
    lab.step(first)
    lab.do(PauseRun(lab.run(first).id))
    name = lab.experiment(closing=route("park", "trash"))
    parks = lab.submit(route("stack", "park"), experiment=name)
    assert Safety().list_trapped(lab.state, lab.run(parks), 0) == [first]
    lab.do(ResumeRun(lab.run(first).id))
    assert works(lab), lab.describe_stuck()
    lab.end(name)
    assert works(lab), lab.describe_stuck()


@pytest.mark.parametrize("why", ["not_accepted", "unfit", "wrong_way"])
def test_who_finds_that_its_labware_does_not_fit_is_in_the_way(why: str) -> None:
    """It will not move before a person has done something: nobody is let in who needs its place."""
    cell = workcell(
        [module("arm"), module("arm2"), module("cam"), module("dev")],
        [
            station("stack", "stack", 20),
            station("x"),
            station("y", accepts=("plate",), a1=90 if why == "wrong_way" else None),
            station("z"),
            station("trash", "waste", 50),
        ],
    )
    lab = Driver(cell)
    lab.stock("stack", 9, "tube" if why == "not_accepted" else "plate")
    wants = (needs("x"), requires("sealed", True, of="labware")) if why == "unfit" else ()
    checks = [step("cam", *wants)] if wants else []
    lost = lab.submit(
        plan(
            step("arm", take("stack", "x")),
            *checks,
            step("arm", move("x", "y")),
            step("arm", move("y", "trash")),
        )
    )
    lab.step(lost)
    stuck = find_block(lab.state, lab.run(lost))
    assert stuck is not None
    assert (stuck.code, stuck.blocked) == (why, True)
    needing = lab.submit(route("stack", "z", "x", "trash", arm="arm2"))
    other = lab.submit(route("stack", "z", "trash", arm="arm2"))
    assert lab.pump() == [f"{other}#0"]
    lab.finish(lab.list_flying()[0])
    lab.work(random.Random(0))
    assert other not in lab.state.runs.active
    waits = lab.scheduler.list_waits(lab.state, lab.run(needing), lab.now)
    assert [wait.code for _, wait in waits] == ["no_way_out"]


# -- stacks ----------------------------------------------------------------------------------------


def make_piled() -> Driver:
    """Two arms, a stack of fresh plates, and a pile of two."""
    cell = workcell(
        [module("arm"), module("arm2"), module("cam")],
        [
            station("stack", "stack", 20),
            station("pile", "stack", 2),
            station("x"),
            station("trash", "waste", 50),
        ],
    )
    lab = Driver(cell)
    lab.stock("stack", 9)
    return lab


def test_nobody_is_buried_by_one_who_waits_for_him() -> None:
    """The second would lie on the first and wait for the place that the first has to leave later."""
    lab = make_piled()
    first = lab.submit(
        plan(
            step("cam"),
            step("arm", take("stack", "pile")),
            step("arm", move("pile", "trash")),
            holds=(hold("cam", 0, 2),),
        )
    )
    second = lab.submit(
        plan(
            step("arm2", take("stack", "x")),
            step("arm2", move("x", "pile")),
            step("cam"),
            step("arm2", move("pile", "trash")),
        )
    )
    for run in (first, second):
        lab.step(run)
    lab.step(first, 1)
    assert lab.code(second, 1) == "", "there is room on the pile"
    assert Safety().list_trapped(lab.state, lab.run(second), 1) != []
    assert works(lab)


def test_fresh_labware_waits_until_nothing_lies_on_the_stack() -> None:
    lab = nests("x", "y")
    for number in range(4):
        arm = ("arm", "arm2")[number % 2]
        back = [step(arm, take("stack", "x")), step(arm, move("x", "stack"))]
        lab.submit(plan(*back, step(arm, move("stack", "y")), step(arm, move("y", "trash"))))
    assert works(lab), lab.describe_stuck()


def test_a_pile_is_taken_down_from_the_top() -> None:
    lab = make_piled()
    for _ in range(5):
        lab.submit(route("stack", "pile", "x", "trash"))
    assert works(lab), lab.describe_stuck()


# -- who only uses modules --------------------------------------------------------------------------


def test_a_run_that_only_uses_modules_is_let_in_without_a_search() -> None:
    lab = nests("x", "y")
    lab.step(lab.submit(route("stack", "x", "y", "trash")))
    safety = lab.scheduler.safety
    searches = safety.searches
    passer = lab.submit(plan(step("dev"), step("cam"), name="pass"))
    lab.step(passer)
    assert safety.searches == searches
    other = lab.submit(route("stack", "y", "x", "trash", arm="arm2"))
    assert safety.list_trapped(lab.state, lab.run(other), 0), "what was known of the others still holds"
    assert works(lab)


def test_a_run_that_could_not_use_its_module_now_is_looked_at_closely() -> None:
    """Somebody inside has left a door open and closes it later: the newcomer can go only after that."""
    lab = Driver(
        workcell([module("arm"), module("dev", rest={"door": "closed"}), module("cam")], [station("x")])
    )
    opener = lab.submit(
        plan(step("dev", sets("door", "open")), step("cam"), step("dev", sets("door", "closed")), name="open")
    )
    lab.step(opener)
    safety = lab.scheduler.safety
    newcomer = lab.run(lab.submit(plan(step("cam"), step("dev"), name="pass")))
    assert not safety._can_pass(lab.state, newcomer, "cell")
    assert safety.list_trapped(lab.state, newcomer, 0) == []
