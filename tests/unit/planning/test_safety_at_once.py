"""Steps that do several things at once, and steps that may fail: safe only as a whole, and either way."""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import groupby

import msgspec
import pytest

from labos.core.ids import ActionId
from labos.core.model import OnError, Plan, PlanStep
from labos.planning.layout import lay_out
from labos.planning.safety import Safety, View, view_actor
from tests.support.bench import (
    CELL,
    Driver,
    claims,
    hold,
    module,
    move,
    plan,
    route,
    sets,
    station,
    step,
    take,
    workcell,
)
from tests.unit.planning.test_safety import nests, works

# -- steps that do several things at once ----------------------------------------------------------


def make_crossing(first: int, last: int) -> Driver:
    """Two that cross each other; one keeps the sealer from a step on that carries its plate."""
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("sealer")],
            [
                station("stack", "stack", 9),
                station("trash", "waste", 9),
                *map(station, ("n1", "n2", "n3", "n4")),
            ],
        )
    )
    lab.stock("stack", 5)
    kept = route("stack", "n1", "n2", "n3", "trash")
    lab.submit(msgspec.structs.replace(kept, holds=(hold("sealer", first, last),)))
    lab.submit(route("stack", "n3", "n2", "n4", "n1", "trash", arm="arm2"))
    return lab


@pytest.mark.parametrize("first", range(4))
def test_who_takes_hold_of_a_module_and_carries_labware_in_one_step_traps_nobody(first: int) -> None:
    for last in range(first, 4):
        for seed in range(20):
            lab = make_crossing(first, last)
            assert works(lab, seed), (last, seed, lab.describe_stuck())


def test_the_motions_of_a_step_follow_one_another_in_a_witness() -> None:
    lab = make_crossing(1, 2)
    lab.step("R1", 0)
    lab.step("R2", 0)
    safety = Safety()
    view = View(CELL, hopeful=True, closing=True)
    actors = [view_actor(actor, view) for actor in safety.list_actors(lab.state, CELL)]
    order, ends = safety.find(lay_out(lab.state, CELL, actors, hopeful=True), actors, {"R1", "R2"})
    assert ends == {"R1", "R2"}
    assert [name for name, _ in groupby(order)] == list(dict.fromkeys(order))


def test_a_device_that_carries_labware_itself_waits_until_nobody_else_holds_it() -> None:
    for seed in range(10):
        lab = Driver(
            workcell(
                [module("arm"), module("dev", variables={"lid": "open"}, rest={"lid": "open"})],
                [station("stack", "stack", 9), station("trash", "waste", 9), station("x"), station("y")],
            )
        )
        lab.stock("stack", 5)
        lab.submit(plan(step("arm", take("stack", "x")), step("dev", move("x", "trash"))))
        shut, opened = step("dev", sets("lid", "shut")), step("dev", sets("lid", "open"))
        lab.submit(
            plan(
                shut,
                step("arm", take("stack", "y")),
                step("arm", move("y", "x")),
                opened,
                step("arm", move("x", "trash")),
            )
        )
        assert works(lab, seed), lab.describe_stuck()


def test_nobody_keeps_a_module_whose_door_another_has_left_shut() -> None:
    for seed in range(10):
        lab = Driver(
            workcell(
                [
                    module("arm"),
                    module("cam"),
                    module("press", variables={"lid": "open"}, rest={"lid": "open"}),
                ],
                [station("stack", "stack", 9), station("trash", "waste", 9), station("x"), station("y")],
            )
        )
        lab.stock("stack", 5)
        shut, opened = step("press", sets("lid", "shut")), step("press", sets("lid", "open"))
        lab.submit(
            plan(step("arm", take("stack", "x")), shut, step("cam"), opened, step("arm", move("x", "trash")))
        )
        lab.submit(
            plan(
                step("arm", take("stack", "y")),
                step("arm", move("y", "x")),
                step("arm", move("x", "trash")),
                holds=(hold("press", 0, 1),),
            )
        )
        assert works(lab, seed), lab.describe_stuck()


# -- steps in flight that may fail -----------------------------------------------------------------


def make_recovering(*steps: PlanStep, failing: int, rescue: Sequence[PlanStep]) -> Plan:
    """A plan of which one step may fail and is then made good by others."""
    main = plan(*steps)
    policy = OnError("run", "go_on")
    main_steps = [
        msgspec.structs.replace(s, on_error=policy) if n == failing else s for n, s in enumerate(main.steps)
    ]
    behind = [
        msgspec.structs.replace(s, key=f"r{n}", part=failing, after=(len(steps) + n - 1,) if n else ())
        for n, s in enumerate(rescue)
    ]
    return msgspec.structs.replace(main, steps=(*main_steps, *behind))


def test_what_is_carried_to_the_waste_may_fail_and_be_recovered_from() -> None:
    lab = nests("x", "y")
    rescue = [step("arm2", move("x", "y")), step("arm2", move("y", "trash"))]
    steps = [step("arm", take("stack", "x")), step("arm", move("x", "trash"))]
    lab.submit(make_recovering(*steps, failing=1, rescue=rescue))
    lab.pump()
    lab.finish("A1")
    assert lab.pump() == ["R1#1"]
    lab.fail("A2", "none")
    assert works(lab)
    assert lab.types()[-1] == "run.completed"


def test_a_step_that_may_fail_keeps_the_place_it_came_from_until_it_has_ended() -> None:
    """If it does fail, the plate stands in the deck again and goes round by y; whoever stands in y
    needs the deck before it can go on."""
    for seed in range(30):
        lab = Driver(
            workcell(
                [module("arm"), module("arm2"), module("dev")],
                [
                    station("stack", "stack", 9),
                    station("trash", "waste", 9),
                    station("y"),
                    station("dev.n", "deck", claim=True),
                ],
            )
        )
        lab.stock("stack", 5)
        rescue = [step("arm", move("dev.n", "y")), step("arm", move("y", "trash"))]
        steps = [step("arm2", take("stack", "dev.n")), step("arm2", move("dev.n", "trash"))]
        lab.submit(make_recovering(*steps, failing=1, rescue=rescue))
        lab.submit(plan(step("arm", take("stack", "y")), step("dev"), step("arm", move("y", "trash"))))

        def end(_: random.Random, action: ActionId, lab: Driver = lab) -> None:
            at = lab.state.actions.open[action]
            if (at.run, at.step) == ("R1", 1):
                lab.fail(action, "none")
            else:
                lab.finish(action)

        assert lab.work(random.Random(seed), end=end), lab.describe_stuck()


def test_a_run_that_went_on_without_a_step_that_changes_nothing_is_still_on_its_way() -> None:
    lab = nests("x", "y")
    rescue = [step("arm2", move("y", "x")), step("arm2", move("x", "trash"))]
    steps = [
        step("arm", take("stack", "x")),
        step("cam"),
        step("arm", move("x", "y")),
        step("arm", move("y", "trash")),
    ]
    what = make_recovering(*steps, failing=3, rescue=rescue)
    skipped = msgspec.structs.replace(what.steps[1], on_error=OnError("skip", may_skip=True))
    run = lab.submit(msgspec.structs.replace(what, steps=(what.steps[0], skipped, *what.steps[2:])))
    lab.pump()
    lab.finish("A1")
    lab.pump()
    lab.fail("A2", "none")
    (actor,) = Safety().list_actors(lab.state, CELL)
    assert (actor.name, [motion.step for motion in actor.motions]) == (run, [2])
    assert len(actor.forks) == 2


def test_a_setpoint_that_a_step_in_flight_changes_may_stay_as_it_was() -> None:
    """The first run may keep 42 to its end, and needs x for that; the second stands in x and needs 37."""
    for seed in range(20):
        lab = Driver(
            workcell(
                [module("arm"), module("arm2"), module("heat")],
                [station("stack", "stack", 9), station("trash", "waste", 9), station("x")],
            )
        )
        lab.stock("stack", 5)
        skip = OnError("skip", may_skip=True)
        change = msgspec.structs.replace(step("heat", claims("t", 37)), on_error=skip)
        away = step("arm", move("x", "trash"))
        lab.submit(plan(step("heat", claims("t", 42)), change, step("arm", take("stack", "x")), away))
        lab.submit(plan(step("arm2", take("stack", "x")), step("heat", claims("t", 37)), away))

        def end(_: random.Random, action: ActionId, lab: Driver = lab) -> None:
            at = lab.state.actions.open[action]
            if (at.run, at.step) == ("R1", 1):
                lab.fail(action, "none")
            else:
                lab.finish(action)

        assert lab.work(random.Random(seed), end=end), lab.describe_stuck()
