"""Labware that several runs need where it stands, and variables of modules that stay as they were set: whose
the labware is meanwhile, and that nobody is trapped by what another one does to either."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from labos.core import reasons
from labos.core.decide.handover import HandOver
from labos.core.ids import LabwareId, Owner
from labos.core.model import Plan
from labos.core.waits import Wait
from labos.planning.obstacle import explain_wait
from labos.planning.scheduler import Scheduler
from tests.support.bench import (
    Driver,
    module,
    move,
    needs,
    plan,
    requires,
    sets,
    small,
    station,
    step,
    take,
    unlid,
    workcell,
)
from tests.unit.planning.exhaustive import Count, Explored
from tests.unit.planning.sharing import Sharing


def throw_away() -> Plan:
    """A plate of its own, and the one at ``a``, into the waste."""
    return plan(
        step("arm", take("stack", "b")),
        step("arm2", move("a", "trash")),
        step("arm", move("b", "trash")),
        name="throws",
    )


def look_at(place: str = "a", times: int = 2) -> Plan:
    return plan(*[step("cam", needs(place))] * times, name="looks")


def lab_with(place: str = "a", labware: str = "plate") -> Driver:
    lab = small()
    lab.stock(place, 1, labware)
    return lab


# -- whose it is ---------------------------------------------------------------------------------


def test_what_a_run_only_works_on_is_lent_to_it_and_is_everybodys_again_at_its_end() -> None:
    lab = lab_with()
    run = lab.submit(look_at())
    lab.step(run)
    assert lab.owner("P1") == f"run:{run}"
    assert lab.state.bench.labware[LabwareId("P1")].lender == "shared"
    lab.step(run, 1)
    assert lab.owner("P1") == "shared"
    lab.check_log()


@pytest.mark.parametrize(
    "effects",
    [(needs("a"), sets("sealed", True, "labware")), (move("a", "c"),), (unlid("a", "c"),)],
    ids=["changed", "carried", "uncovered"],
)
@pytest.mark.parametrize("at_once", [True, False])
def test_what_a_run_changes_or_carries_is_its_users(effects: tuple, at_once: bool) -> None:  # type: ignore[type-arg]
    lab = lab_with(labware="plate+lid")
    steps = [step("cam", needs("a")), step("arm", *effects)][at_once:]
    run = lab.submit(plan(*steps))
    for index in range(len(steps)):
        lab.step(run, index)
    assert {item.owner for item in lab.state.bench.labware.values()} == {"user:ada"}
    assert not any(item.lender for item in lab.state.bench.labware.values())
    lab.check_log()


def test_the_lid_of_a_plate_is_lent_with_it() -> None:
    lab = lab_with(labware="plate+lid")
    run = lab.submit(look_at())
    lab.step(run)
    assert {i.owner for i in lab.state.bench.labware.values()} == {f"run:{run}"}
    lab.step(run, 1)
    assert {i.owner for i in lab.state.bench.labware.values()} == {"shared"}


def test_what_an_experiment_has_lent_to_its_run_is_the_experiments_again() -> None:
    lab = lab_with()
    experiment = lab.experiment(user="bob")
    lab.do(HandOver(LabwareId("P1"), Owner(f"experiment:{experiment}"), "labos"))
    run = lab.submit(look_at(), user="bob", experiment=experiment)
    lab.step(run)
    lab.step(run, 1)
    assert lab.owner("P1") == f"experiment:{experiment}"
    lab.end(experiment)
    assert lab.owner("P1") == "user:bob"
    lab.check_log()


def test_a_run_that_fails_left_nothing_that_was_lent_to_it() -> None:
    lab = lab_with()
    run = lab.submit(look_at())
    lab.step(run)
    lab.fail(lab.start(run, 1), "none")
    lab.answer(lab.question("failed_step"), "fail") if lab.questions("failed_step") else None
    assert lab.owner("P1") == "shared"
    assert not lab.questions("left_labware")


def test_who_needs_what_is_lent_waits_for_the_end_of_that_run_and_for_nobody() -> None:
    lab = lab_with()
    first, second = lab.submit(look_at()), lab.submit(look_at(), user="bob")
    lab.step(first)
    found = lab.check_start(second)
    assert isinstance(found, Wait)
    assert found.reason == reasons.InUse("P1", "cell/a", f"run:{first}")
    assert not found.blocked
    assert found.reason.sentence == f"run {first} works on P1 at a until it ends"
    lab.pump()
    for _ in range(4):
        for action in lab.list_flying():
            lab.finish(action)
        lab.pump()
    assert lab.types().count("run.completed") == 2
    lab.check_log()


def test_of_several_plates_a_run_works_on_its_own() -> None:
    """Also if another one stands at a station that comes before it."""
    lab = small()
    lab.stock("dev.n1", 1)
    run = lab.submit(plan(step("arm", take("stack", "dev.n2")), step("dev", needs())))
    lab.step(run)
    action = lab.start(run, 1)
    assert [e.labware for e in lab.state.actions.open[action].effects] == ["P2"]  # type: ignore[union-attr]
    assert lab.owner("P1") == "shared"


# -- nobody is trapped ---------------------------------------------------------------------------


@pytest.mark.parametrize("restarts", [False, True])
def test_who_needs_shared_labware_traps_nobody_who_throws_it_away(restarts: bool) -> None:
    """Both are let in; the one that needs the plate where it stands comes first."""
    lab = lab_with()
    throws = lab.submit(throw_away(), user="bob")
    lab.pump()
    lab.submit(look_at(), user="ada")

    def pump() -> None:
        if restarts:
            lab.scheduler = Scheduler()
        lab.pump()

    assert lab.work(random.Random(1), pump), lab.describe_stuck()
    assert lab.types().count("run.completed") == 2
    assert throws not in lab.state.runs.active
    lab.check_log()


def test_what_a_run_inside_will_need_is_not_thrown_away() -> None:
    lab = lab_with()
    looks = lab.submit(
        plan(step("arm", take("stack", "b")), *look_at().steps, step("arm", move("b", "trash")))
    )
    throws = lab.submit(plan(step("arm2", move("a", "trash"))), user="bob")
    lab.start(looks)
    safety = lab.scheduler.safety
    assert safety.list_trapped(lab.state, lab.run(throws), 0, only_asking=True) == [looks]
    assert lab.work(random.Random(0)), lab.describe_stuck()


def test_who_needs_what_is_not_there_is_not_let_in_and_says_what_is_missing() -> None:
    lab = small()
    run = lab.submit(plan(step("dev"), *look_at("cam.nest").steps))
    assert lab.pump() == []
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    told = explain_wait(lab.scheduler.safety, lab.state, lab.run(run), wait)
    assert told.endswith("finds nothing that it may use at cam.nest"), told
    lab.stock("cam.nest", 1)
    assert lab.work(random.Random(0)), lab.describe_stuck()


def test_who_needs_a_plate_that_is_sealed_is_not_let_in_before_it_is_not() -> None:
    lab = lab_with()
    seals = lab.submit(plan(step("dev", needs("a"), sets("sealed", True, "labware"))))
    lab.step(seals)
    bare = (needs("a"), requires("sealed", False, "labware"))
    run = lab.submit(
        plan(step("arm", take("stack", "b")), step("cam", *bare), step("arm", move("b", "trash")))
    )
    assert lab.pump() == []
    assert lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)[0][1].code == "unfit"
    peels = lab.submit(plan(step("dev", needs("a"), sets("sealed", False, "labware"))))
    assert lab.work(random.Random(0)), lab.describe_stuck()
    assert {run, peels}.isdisjoint(lab.state.runs.active)


def modes(*wanted: int) -> Driver:
    """Runs that set a mode of ``dev``, do something else, and need it as they have set it."""
    lab = Driver(workcell([module("dev", variables={"mode": 0}), module("cam")], [station("a")]))
    for mode in wanted:
        steps = (step("dev", sets("mode", mode)), step("cam"), step("dev", requires("mode", mode)))
        lab.submit(plan(*steps, name=f"mode {mode}"), user=("ada", "bob")[mode % 2])
    return lab


@pytest.mark.parametrize("wanted", [(1, 2), (1, 2, 1), (1, 1, 1)])
def test_nobody_sets_a_variable_otherwise_that_another_still_needs(wanted: tuple[int, ...]) -> None:
    for seed in range(10):
        lab = modes(*wanted)
        assert lab.work(random.Random(seed)), (seed, lab.describe_stuck())


def test_who_needs_a_variable_that_nobody_will_set_says_so() -> None:
    lab = modes()
    lab.step(lab.submit(plan(step("dev", sets("mode", 7)))))
    run = lab.submit(plan(step("cam"), step("dev", requires("mode", 0))))
    assert lab.pump() == []
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    told = explain_wait(lab.scheduler.safety, lab.state, lab.run(run), wait)
    assert told.endswith("'s1' needs dev.mode = 0, which no step will have set"), told


# -- by seeds ------------------------------------------------------------------------------------


def find_trapped(seed: int) -> str:
    """Who cannot go on of those inside at the end of a lab; empty if nobody."""
    rng = random.Random(seed)
    lab = Sharing(rng).submit_all()

    def pump() -> None:
        if rng.random() < 0.1:  # planning has forgotten all that it knew
            lab.scheduler = Scheduler()
            lab.keys.clear()
        lab.pump()
        assert lab.find_missed() == [], (seed, lab.describe_stuck())

    lab.work(rng, pump)
    return f"seed {seed}: {lab.describe_stuck()}" if lab.state.runs.active else ""


def find_all_trapped(seeds: Iterable[int]) -> list[str]:
    return [who for who in map(find_trapped, seeds) if who]


def count_all(seeds: Iterable[int]) -> Count:
    total = Count()
    for seed in seeds:
        count = Explored(Sharing(random.Random(seed), 2 + seed % 2).submit_all()).count()
        assert not count.unsafe_allowed, (seed, count)
        assert not count.dead_ends, (seed, count)
        total = total.with_(count)
    return total


def test_nobody_inside_is_trapped_where_labware_is_shared() -> None:
    assert find_all_trapped(range(40)) == []


def test_who_does_not_look_at_what_runs_need_traps_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.planning.paths._list_needs", lambda *_: ())
    assert len(find_all_trapped(range(20))) > 4


def test_who_does_not_look_at_what_modules_are_set_to_traps_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.planning.paths._drop_resting_values", lambda *_: ())
    assert find_all_trapped(range(40))


def test_who_lets_runs_in_to_labware_that_is_not_as_they_need_it_traps_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("labos.planning.stuck._check_labware_ahead", lambda *_: None)
    assert find_all_trapped((0, 206, 214, 484))


def test_no_start_is_unsafe_in_any_state_where_labware_is_shared() -> None:
    count = count_all(range(20))
    assert count.safe_refused < 0.05 * count.asked, count


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_nobody_inside_is_trapped_in_10_000_labs() -> None:
    assert find_all_trapped(range(10_000)) == []


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_no_start_is_unsafe_in_any_state_of_1000_small_workcells(capsys: pytest.CaptureFixture[str]) -> None:
    count = count_all(range(1000))
    with capsys.disabled():
        share = 100 * count.safe_refused / count.asked
        print(f"\n{count}: {share:.2f} % of what was asked was refused though it is safe")
    assert count.safe_refused < 0.03 * count.asked
