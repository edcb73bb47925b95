"""Runs that choose between modules: bound when they are let in, recorded, never less safe than without."""

from __future__ import annotations

import random
from collections import Counter

import msgspec
import pytest

from labos.core.actions import ActionRequested
from labos.core.decide import Command, Rejection
from labos.core.decide.actions import StartStep
from labos.core.decide.choices import MOST_PLANS, BindAnew
from labos.core.decide.nodes import ReportState
from labos.core.decide.runs import SubmitRun
from labos.core.effects import list_carried
from labos.core.ids import ActionId, RunId
from labos.core.model import Plan, PlanStep, Workcell
from labos.core.registry import Event
from labos.core.runs import RunBound, RunSubmitted
from labos.planning.scheduler import Scheduler
from labos.planning.waiting import PATIENCE
from tests.support.bench import (
    Driver,
    full,
    module,
    move,
    needs,
    plan,
    refold,
    station,
    step,
    take,
    workcell,
)
from tests.support.seeds import few_and_many
from tests.unit.planning.cases import Case

FEW, MANY = 10, 150

CELL = workcell(
    [module("arm"), module("a"), module("b"), module("read")],
    [
        station("stack", "stack", 40),
        station("a.nest", claim=True),
        station("b.nest", claim=True),
        station("read.nest", claim=True),
        station("trash", "waste", 99),
    ],
)


def way(cycler: str, seconds: float = 600.0) -> Plan:
    """A plate is read, then cycled on one of two modules."""
    return plan(
        step("arm", take("stack", "read.nest"), key="fetch", duration_s=10.0),
        step("read", needs("read.nest"), key="read", duration_s=20.0),
        step("arm", move("read.nest", f"{cycler}.nest"), key="bring", duration_s=10.0),
        step(cycler, needs(f"{cycler}.nest"), key="cycle", duration_s=seconds),
        step("arm", move(f"{cycler}.nest", "trash"), key="away", duration_s=10.0),
        name="cycle",
    )


class Committing(Driver):
    """Notes where in the log each commit ended."""

    def __init__(self, cell: Workcell | None = None) -> None:
        self.commits: list[int] = []
        super().__init__(cell)

    def ask(self, command: Command, actor: str = "labos") -> list[Event] | Rejection:
        answer = super().ask(command, actor)
        self.commits.append(len(self.log))
        return answer


def lab_with(*seconds: float) -> Committing:
    """A lab in which runs wait that cycle for so long, on either module."""
    lab = Committing(CELL)
    lab.stock("stack", 30)
    for takes in seconds:
        lab.submit(way("a", takes), others=(way("b", takes),))
    return lab


def bindings(lab: Driver) -> dict[str, str]:
    """The cycler of each run that was bound, by its last binding."""
    return {
        e.run: e.modules["cycle"].partition("/")[2]
        for e in (entry.event for entry in lab.log)
        if isinstance(e, RunBound)
    }


def break_down(lab: Driver, name: str, status: str = "ERROR") -> None:
    known = lab.state.modules.by_name[full(name)]  # type: ignore[index]
    lab.do(ReportState(known.spec.name, status, "jammed"))


def play(lab: Driver) -> float:
    """Carry everything out, each action in its time; returns how long it took (s)."""
    began, ends = lab.now, dict[ActionId, float]()
    lab.pump()
    while lab.list_flying():
        for action in lab.list_flying():
            known = lab.state.actions.open[action]
            run = lab.state.runs.active[known.run]
            takes = lab.state.runs.plan_of(run).steps[known.step].duration_s
            ends.setdefault(action, known.requested_at / 1e9 + takes)
        action = min(lab.list_flying(), key=lambda a: ends[a])
        lab.wait(max(0.0, ends[action] - lab.now / 1e9))
        lab.finish(action)
        lab.pump()
    assert not lab.state.runs.active, lab.describe_stuck()
    return (lab.now - began) / 1e9


def test_runs_take_the_module_by_which_they_are_done_first_and_the_log_says_which() -> None:
    lab = lab_with(600, 600, 600, 600)
    play(lab)
    assert Counter(bindings(lab).values()) == {"a": 2, "b": 2}
    submitted = [entry.event for entry in lab.log if isinstance(entry.event, RunSubmitted)]
    assert all(len(event.choices) == 2 and event.plan == event.choices[0] for event in submitted)
    for run, cycler in bindings(lab).items():
        events = [entry.event for entry in lab.log]
        used = {e.module for e in events if isinstance(e, ActionRequested) and e.run == run}
        assert used == {full("arm"), full("read"), full(cycler)}
    assert lab.state.runs.plans == {}  # those that were not taken are forgotten, too
    lab.check_log()


def test_a_choice_is_as_good_as_the_best_fixed_share() -> None:
    seconds = [1800, 7200, 3600, 5400, 1800, 3600, 7200, 1800]
    free = play(lab_with(*seconds))
    fixed = Driver(CELL)
    fixed.stock("stack", 30)
    for number, takes in enumerate(seconds):
        fixed.submit(way("ab"[number % 2], takes))
    assert free < play(fixed)
    assert free < sum(seconds) / 2 * 1.15


def test_after_a_crash_at_each_commit_the_log_gives_the_same_binding_and_work_goes_on() -> None:
    lab = lab_with(300, 600, 300, 600)
    first = len(lab.log)
    play(lab)
    whole = bindings(lab)
    seen = Counter[int]()
    for cut in [position for position in lab.commits if position >= first]:
        state = refold(lab.log[:cut])
        before = {e.run: e.plan for e in (x.event for x in lab.log[:cut]) if isinstance(e, RunBound)}
        for name, chosen in before.items():
            run = state.runs.get(name)
            assert run is None or run.plan == chosen
        again = Driver(None)
        again.state, again.now, again.log = state, lab.log[cut - 1].at, list(lab.log[:cut])
        again._versions = Counter(entry.stream for entry in again.log)
        again._actions = 1000
        play(again)
        after = bindings(again)
        assert all(after[run] == whole[run] for run in before)
        assert not again.state.runs.queued
        seen[len(before)] += 1
    assert set(seen) >= {0, 1, 2, 3, 4}


def test_a_module_in_error_is_not_taken() -> None:
    lab = lab_with(600, 600)
    break_down(lab, "a")
    play(lab)
    assert set(bindings(lab).values()) == {"b"}


def test_who_is_inside_goes_on_by_the_other_module_if_its_own_breaks_down_before_it_is_used() -> None:
    lab = lab_with(600)
    lab.pump()
    assert bindings(lab) == {"R1": "a"}
    break_down(lab, "a")
    play(lab)
    bound = [e for e in (x.event for x in lab.log) if isinstance(e, RunBound)]
    assert [e.modules["cycle"] for e in bound] == ["cell/a", "cell/b"]
    assert bound[1].why == "a cannot be used"
    assert lab.types().count("run.completed") == 1
    lab.check_log()


def test_who_has_its_plate_at_the_module_stays_bound_to_it() -> None:
    lab = lab_with(600)
    lab.pump()
    for _ in range(3):
        lab.finish(lab.list_flying()[0])
        lab.pump()
    break_down(lab, "a")
    lab.pump()
    assert bindings(lab) == {"R1": "a"}
    run = lab.state.runs.active[RunId("R1")]
    other = next(p for p in run.choices if p != run.plan)
    assert lab.reject(BindAnew(run.id, other, "why not")).code == "bound"


def test_no_run_with_a_choice_starts_unbound() -> None:
    lab = lab_with(600)
    assert lab.reject(StartStep(RunId("R1"), 0, ActionId("A1"), lab.now)).code == "unbound"
    assert lab.reject(StartStep(RunId("R1"), 0, ActionId("A1"), lab.now, "other")).code == "unbound"


def test_plans_to_choose_from_have_the_same_steps_and_are_not_too_many() -> None:
    lab = Driver(CELL)
    short = msgspec.structs.replace(way("b"), steps=way("b").steps[:-1])
    assert lab.reject(SubmitRun(way("a"), "ada", others=(short,))).code == "unlike"
    many = tuple(way("b", float(number)) for number in range(1, MOST_PLANS + 1))
    assert lab.reject(SubmitRun(way("a"), "ada", others=many)).code == "too_many_choices"
    assert lab.reject(SubmitRun(way("a"), "ada", others=(way("c"),))).code == "no_station"


def test_what_each_choice_waits_for_is_told() -> None:
    lab = lab_with(600)
    for name in ("a", "b"):
        break_down(lab, name)
    waits = lab.scheduler.list_waits(lab.state, lab.run("R1"), lab.now)
    assert {name for _, wait in waits for name in wait.names} >= {"cell/a", "cell/b"}


def test_who_may_take_several_modules_is_kept_from_none_by_those_who_take_one() -> None:
    """The oldest run is protected on each of its modules once it was overtaken too often."""
    lab = Driver(CELL)
    lab.stock("stack", 30)
    lab.submit(way("a"), others=(way("b"),))
    lab.scheduler.iterate_proposals(lab.state, lab.now)
    lab.scheduler.room.fill(lab.state)
    lab.scheduler.room.overtake(lab.state, lab.run("R1"), PATIENCE)
    lab.submit(way("b"))
    lab.pump()
    assert "R1" in lab.state.runs.active


def some_others(case: Case, what: Plan) -> tuple[Plan, ...]:
    """The same steps in other places, and by other arms."""
    rng, found = case.rng, dict[str, Plan]()
    for _ in range(rng.randint(0, 3)):
        swaps: dict[str, str] = {}
        for group in (
            [p for p in case.places if p.startswith("dev")],
            [p for p in case.places if not p.startswith("dev")],
            case.arms,
        ):
            swaps.update(zip(group, rng.sample(group, len(group)), strict=True))
        text = msgspec.json.encode(what).decode()
        for name in swaps:
            text = text.replace(f'"{full(name)}"', f'"<{name}>"')
        for name, other in swaps.items():
            text = text.replace(f'"<{name}>"', f'"{full(other)}"')
        found[text] = msgspec.json.decode(text, type=Plan)
    if len(case.arms) > 1:
        late = by_other_arms(case, what)
        found.setdefault(msgspec.json.encode(late).decode(), late)
    return tuple(other for other in found.values() if other != what)


def by_other_arms(case: Case, what: Plan) -> Plan:
    """The same, but from some step on each transfer is carried out by another arm: a run may change to it
    when its own arm fails on the way."""
    names = [*case.arms, *(f"{arm}.gripper" for arm in case.arms)]
    others = [*reversed(case.arms), *(f"{arm}.gripper" for arm in reversed(case.arms))]
    cuts, held = [], 0
    for number, each in enumerate(what.steps[:-1], 1):
        for carrying in list_carried(each.effects):
            held += str(carrying.filled).endswith("gripper") - str(carrying.emptied).endswith("gripper")
        cuts += [number] if not held else []
    cut = case.rng.choice(cuts)
    text = msgspec.json.encode(what.steps[cut:]).decode()
    for name in names:
        text = text.replace(f'"{full(name)}"', f'"<{name}>"')
    for name, other in zip(names, others, strict=True):
        text = text.replace(f'"<{name}>"', f'"{full(other)}"')
    late = msgspec.json.decode(text, type=tuple[PlanStep, ...])
    return msgspec.structs.replace(what, steps=(*what.steps[:cut], *late))


def submit_all(case: Case) -> Driver:
    lab = case.lab()
    for number, what in enumerate(case.plans):
        lab.submit(what, user=("ada", "bob")[number % 2], others=some_others(case, what))
    return lab


@pytest.mark.parametrize("kind", ["plain", "lids", "zones", "hands", "covers"])
@few_and_many(FEW, MANY)
def test_whatever_they_choose_everybody_comes_to_the_end(kind: str, seeds: range) -> None:
    for seed in seeds:
        rng = random.Random(seed)
        lab = submit_all(Case(rng, **{kind: True} if kind != "plain" else {}))

        def pump(lab: Driver = lab, rng: random.Random = rng) -> None:
            if rng.random() < 0.1:
                lab.scheduler = Scheduler()
                lab.keys.clear()
            lab.pump()
            assert lab.find_missed() == [], lab.describe_stuck()

        assert lab.work(rng, pump), f"seed {seed}, trapped: {lab.describe_stuck()}"
        assert lab.types().count("run.completed") == lab.state.runs.named
        assert lab.state.runs.plans == {}
        lab.check_log()


@pytest.mark.parametrize("kind", ["plain", "lids", "zones", "hands", "covers"])
@few_and_many(FEW, MANY)
def test_nobody_is_trapped_when_modules_fail_and_come_back(kind: str, seeds: range) -> None:
    """Runs are bound anew while a module is down; when all are back, everybody comes to the end."""
    anew = 0
    for seed in seeds:
        rng = random.Random(seed)
        case = Case(rng, **{kind: True} if kind != "plain" else {})
        lab = submit_all(case)
        lab.pump()
        for _ in range(60):
            name = rng.choice([*case.arms, "dev"])
            if not lab.state.modules.by_name[full(name)].in_flight:  # type: ignore[index]
                break_down(lab, name, rng.choice(["ERROR", "IDLE", "IDLE"]))
                lab.pump()
            for action in lab.list_flying()[:1]:
                lab.wait(1.0)
                lab.finish(action)
                lab.pump()
        for name in [*case.arms, "dev"]:
            break_down(lab, name, "IDLE")
        assert lab.work(rng), f"seed {seed}, trapped: {lab.describe_stuck()}"
        anew += sum(isinstance(e.event, RunBound) and bool(e.event.why) for e in lab.log)
        lab.check_log()
    assert anew or len(seeds) < 50
