"""Several runs work at once on what their experiment has parked, and its closing workflow clears it away."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from labos.core.decide.cancelling import CancelRun
from labos.core.ids import ActionId, ExperimentId
from labos.core.model import OnError
from tests.support.bench import Driver, full, move, plan, route, step, take
from tests.unit.planning.test_safety import nests, works


def make_two_parked(*, second: str = "park2") -> tuple[Driver, ExperimentId]:
    """An experiment that has parked two plates; one closing workflow clears away both."""
    lab = nests("park1", "park2", "a", "b")
    away = [step("arm", move(place, "trash")) for place in ("park1", "park2")]
    name = lab.experiment(closing=plan(*away, name="clear"))
    for place in ("park1", second):
        lab.submit(route("stack", place), experiment=name)
    assert works(lab)
    return lab, name


def test_runs_of_one_experiment_work_on_its_parked_plates_at_the_same_time() -> None:
    lab, name = make_two_parked()
    first = lab.submit(route("park1", "a", "park1"), experiment=name)
    second = lab.submit(route("park2", "b", "park2", arm="arm2"), experiment=name)
    assert lab.pump() == [f"{first}#0", f"{second}#0"]
    assert works(lab), lab.describe_stuck()
    lab.end(name)
    assert works(lab), lab.describe_stuck()
    assert (lab.state.bench.labware, lab.state.experiments.open) == ({}, {})
    lab.check_log()


def test_runs_that_need_the_same_parked_plate_are_inside_one_after_the_other() -> None:
    lab, name = make_two_parked()
    first = lab.submit(route("park1", "a", "park1"), experiment=name)
    second = lab.submit(
        plan(step("arm2", take("stack", "b")), step("arm2", move("park1", "trash"))), experiment=name
    )
    assert lab.pump() == [f"{first}#0"]
    (wait,) = lab.scheduler.list_waits(lab.state, lab.run(second), lab.now)
    assert wait[1].code in ("unsafe", "no_way_out")
    assert works(lab), lab.describe_stuck()
    lab.check_log()


@pytest.mark.parametrize("seed", range(8))
def test_experiments_that_park_much_are_cleared_away_in_any_order(seed: int) -> None:
    """Two of them, each with two plates of its own and three runs on these at once; one gate for all."""
    rng = random.Random(seed)
    lab = nests("park1", "park2", "park3", "park4", "gate", "mix1", "mix2")
    names = []
    for number in (0, 1):
        parks = [f"park{2 * number + 1}", f"park{2 * number + 2}"]
        away = [step("arm", move(a, b)) for park in parks for a, b in ((park, "gate"), ("gate", "trash"))]
        names.append(lab.experiment(closing=plan(*away, name="clear"), user=f"u{number}"))
        for park in parks:
            lab.submit(route("stack", "gate", park), experiment=names[-1])
    assert works(lab, seed), lab.describe_stuck()
    for _ in range(8):
        number = rng.randrange(4)
        way = rng.choice([("gate", f"mix{1 + number % 2}"), ("mix1", "gate"), ("gate",)])
        arm = rng.choice(["arm", "arm2"])
        park = f"park{number + 1}"
        lab.submit(route(park, *way, park, arm=arm), experiment=names[number // 2])
    assert works(lab, seed), lab.describe_stuck()
    for name in names:
        lab.end(name)
    assert works(lab, seed), lab.describe_stuck()
    assert (lab.state.bench.labware, lab.state.experiments.open) == ({}, {})
    lab.check_log()


@pytest.mark.parametrize("seed", range(6))
def test_nobody_is_trapped_if_steps_on_parked_plates_fail(seed: int) -> None:
    """Recoveries go through the gate, too; a run that fails leaves its plate where it was, and the closing
    workflow finds it there."""
    rng = random.Random(seed)
    lab = nests("park1", "park2", "park3", "park4", "gate", "mix1", "mix2", stock=14)
    names = []
    for number in (0, 1):
        parks = [f"park{2 * number + 1}", f"park{2 * number + 2}"]
        ways = [(a, b) for park in parks for a, b in ((park, "gate"), ("gate", "trash"))]
        away = [step("arm", move(a, b)) for a, b in (*ways, ("mix1", "trash"), ("mix2", "trash"))]
        names.append(lab.experiment(closing=plan(*away, name="clear"), user=f"u{number}"))
        for park in parks:
            lab.submit(route("stack", "gate", park), experiment=names[-1])
    assert works(lab, seed), lab.describe_stuck()
    for _ in range(10):
        number, mix, arm = rng.randrange(4), rng.choice(["mix1", "mix2"]), rng.choice(["arm", "arm2"])
        main = plan(
            step(arm, move(f"park{number + 1}", mix)),
            step("cam", on_error=OnError("run", then=rng.choice(["fail", "go_on"]))),
            step(arm, move(mix, f"park{number + 1}")),
        )
        over = replace(step(arm, move(mix, "gate")), key="over", part=1)
        back = replace(step(arm, move("gate", mix)), key="back", part=1, after=(3,))
        lab.submit(replace(main, steps=(*main.steps, over, back)), experiment=names[number // 2])

    def end(rng: random.Random, action: ActionId) -> None:
        if lab.state.actions.open[action].module == full("cam") and rng.random() < 0.4:
            lab.fail(action, "none")
        else:
            lab.finish(action)

    lab.work(rng, end=end)
    assert not lab.state.runs.active, lab.describe_stuck()
    for run in list(lab.state.runs.queued):
        lab.do(CancelRun(run))  # its plate is not where it looks for it
    for name in names:
        lab.end(name)
    assert works(lab, seed), lab.describe_stuck()
    assert (lab.state.bench.labware, lab.state.experiments.open) == ({}, {})
    lab.check_log()
