"""Priority goes before age, but not for ever: who is inside is overtaken so often and no more."""

from __future__ import annotations

from labos.core.decide.runs import PauseRun, SubmitRun
from labos.core.ids import RunId
from labos.planning.touch import every_wait_key, near_key
from labos.planning.waiting import PATIENCE
from tests.support.bench import (
    Driver,
    elsewhere,
    module,
    move,
    plan,
    route,
    small,
    small_cell,
    station,
    step,
    take,
    workcell,
)

OLD = plan(step("cam"), step("dev"), name="old")
YOUNG = plan(step("dev"), name="young")


def count_overtaken(lab: Driver, old: RunId, rounds: int, priority: int = 9) -> int:
    """How many younger runs start on ``dev`` while the old one waits for it; there are always two more."""
    before = 0
    for _ in range(rounds):
        while len(lab.state.runs.queued) < 2:
            lab.submit(YOUNG, user="bob", priority=priority)
        started = lab.pump()
        if f"{old}#1" in started:
            return before
        before += len(started)
        lab.wait(60.0)
        lab.finish(lab.list_flying()[0])
    return before


def inside(lab: Driver) -> RunId:
    """An old run of no priority whose next step has to wait for ``dev``."""
    old = lab.submit(OLD)
    lab.pump()
    first = lab.list_flying()[0]
    lab.submit(YOUNG, user="bob", priority=9)
    lab.pump()
    lab.finish(first)
    return old


def test_who_is_inside_is_overtaken_so_often_and_no_more() -> None:
    lab = small()
    old = inside(lab)
    assert count_overtaken(lab, old, rounds=60) <= PATIENCE


def test_priority_goes_first_until_then() -> None:
    lab = small()
    old = inside(lab)
    for _ in range(PATIENCE - 1):
        lab.submit(YOUNG, user="bob", priority=9)
    order: list[str] = []
    while lab.list_flying():
        lab.finish(lab.list_flying()[0])
        order += lab.pump()
    assert order[-1] == f"{old}#1"
    assert len(order) == PATIENCE


def test_who_is_let_in_meanwhile_is_told_for_whom_it_waits() -> None:
    lab = small()
    old = inside(lab)
    lab.pump()
    for number in range(PATIENCE):
        lab.scheduler.patience.overtake(old, RunId(f"X{number}"))
    young = lab.submit(YOUNG, user="bob", priority=9)
    wait = lab.scheduler.patience.find_run_that_goes_first(lab.state, lab.run(young), lab.scheduler.wait_list)
    assert wait == old
    beside = lab.submit(plan(step("arm")), user="bob")
    assert lab.scheduler.check_start(lab.state, lab.run(beside), 0, lab.now) is None, (
        "it needs nothing of the old's"
    )


def test_a_cell_is_emptied_for_one_that_needs_two_places_at_once() -> None:
    """To go first is not enough for it: of the two places one is always taken, as younger runs come in."""
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("cam")],
            [station("stack", "stack", 90), station("trash", "waste", 199), *map(station, "abc")],
        )
    )
    lab.stock("stack", 90)
    old = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "b", via="c")), step("cam")))
    young = {
        place: plan(
            step("arm2", take("stack", place)),
            step("cam", exclusive=False),
            step("arm2", move(place, "trash")),
            name=place,
        )
        for place in "bc"
    }
    for place in "bc":
        lab.submit(young[place], user="bob")
    started = lab.pump()
    for _ in range(120):
        for place in "bc":
            if not any(run.workflow == place for run in lab.state.runs.queued.values()):
                lab.submit(young[place], user="bob")
        started += lab.pump()
        if f"{old}#1" in started:
            break
        flying = [lab.state.actions.open[name] for name in lab.list_flying()]
        lab.finish(min(flying, key=lambda action: action.module == "cell/cam").id)
    assert f"{old}#1" in started
    assert len(lab.state.runs.queued) == 2
    assert lab.state.runs.named <= 2 * PATIENCE


def test_nobody_is_kept_out_for_one_that_a_person_has_stopped() -> None:
    lab = small()
    old = inside(lab)
    lab.pump()
    for number in range(PATIENCE):
        lab.scheduler.patience.overtake(old, RunId(f"X{number}"))
    lab.do(PauseRun(old))
    young = lab.submit(YOUNG, user="bob")
    lab.pump()
    assert (
        lab.scheduler.patience.find_run_that_goes_first(lab.state, lab.run(young), lab.scheduler.wait_list)
        is None
    )


def test_where_nothing_moves_nobody_is_kept_out() -> None:
    """The old one waits for a place; a younger one may be what brings the labware away from there."""
    lab = small()
    experiment = lab.experiment()
    lab.step(lab.submit(route("stack", "a"), experiment=experiment))
    old = lab.submit(route("stack", "b", "a", "trash"))
    lab.step(old)
    lab.pump()
    for number in range(PATIENCE):
        lab.scheduler.patience.overtake(old, RunId(f"X{number}"))
    away = lab.submit(route("a", "trash"), experiment=experiment)
    assert lab.pump()[0] == f"{away}#0"


def test_a_workflow_stays_in_its_workcell() -> None:
    """What an event may change for others is looked for in its workcell only."""
    lab = Driver(small_cell())
    lab.furnish(elsewhere("other", small_cell()))
    for far in (step("other/cam"), step("arm", move("a", "other/b"))):
        refusal = lab.reject(SubmitRun(plan(step("cam"), far), "ada"))
        assert refusal.code == "other_workcell"
        assert "other/" in refusal.message


def test_what_happens_in_one_workcell_is_looked_at_in_no_other() -> None:
    """The end of a run looks at every wait of its workcell anew, and at no other's."""

    def count_looks(cells: int) -> int:
        lab = Driver(small_cell())
        for number in range(1, cells):
            lab.furnish(elsewhere(f"cell{number}", small_cell()))
        names = ["cell", *(f"cell{number}" for number in range(1, cells))]
        for name in names:
            for _ in range(3):
                lab.submit(elsewhere(name, YOUNG) if name != "cell" else YOUNG)
                lab.submit(elsewhere(name, OLD) if name != "cell" else OLD)
        lab.pump()
        before = lab.scheduler.evaluations
        lab.finish("A1")
        assert {key for key in lab.keys if key.startswith(("*", "near:"))} == {near_key("cell")}
        lab.pump()
        assert every_wait_key("cell") not in lab.keys
        return lab.scheduler.evaluations - before

    assert count_looks(5) == count_looks(1)
