"""Random small cells, worked through to the end: nobody is ever trapped, nobody sleeps through
what he waits for, nothing is proposed that the rules forbid."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.decide.lab import DeclareStation
from labos.core.ids import StationName
from labos.planning.scheduler import Scheduler
from tests.support.bench import CELL, Driver, elsewhere
from tests.support.seeds import few_and_many
from tests.unit.core.test_any_order import Chaos, check_nothing_left
from tests.unit.planning.cases import Case

FEW, MANY = 12, 120


def work(rng: random.Random, **kinds: bool) -> Driver:
    """Work a case through; whatever is started must be legal (``pump`` raises else), and after
    each round nothing may be left that a scheduler without memory would start."""
    lab = Case(rng, **kinds).submit_all()

    def pump() -> None:
        lab.pump()
        assert lab.find_missed() == [], lab.describe_stuck()

    assert lab.work(rng, pump), f"trapped: {lab.describe_stuck()}"
    lab.check_log()
    return lab


@pytest.mark.parametrize("kind", ["plain", "lids", "holds", "zones", "hands", "covers"])
@few_and_many(FEW, MANY)
def test_with_all_modules_alive_every_run_completes(kind: str, seeds: range) -> None:
    searched = 0
    for seed in seeds:
        lab = work(random.Random(seed), **{kind: True} if kind != "plain" else {})
        assert lab.types().count("run.completed") == lab.state.runs.named
        searched += lab.scheduler.safety.interleavings > 0
    assert searched > len(seeds) // 12, "the cases are too easy: greed alone finds a way"


@few_and_many(FEW, MANY)
def test_nobody_inside_is_trapped_by_what_comes_to_rest_or_by_a_restart(seeds: range) -> None:
    """Plates that stay where their run ended fill the cell: not everybody gets in, but who is in
    comes out, also where planning has forgotten everything in between."""
    trapped_by_rule = 0
    for seed in seeds:
        rng = random.Random(seed)
        lab = Case(rng, stays=0.3).submit_all()

        def pump(lab: Driver = lab, rng: random.Random = rng) -> None:
            if rng.random() < 0.15:
                lab.scheduler = Scheduler()
                lab.keys.clear()
            lab.pump()
            assert lab.find_missed() == [], lab.describe_stuck()

        lab.work(rng, pump)
        assert not lab.state.runs.active, f"seed {seed}, trapped: {lab.describe_stuck()}"
        rng = random.Random(seed)
        bare = Case(rng, stays=0.3).submit_all()
        bare.work(rng, bare.pump_by_rule)
        trapped_by_rule += bool(bare.state.runs.active)
    assert trapped_by_rule > len(seeds) // 4


@pytest.mark.parametrize("seed", range(40))
def test_in_two_workcells_everybody_is_woken(seed: int) -> None:
    """Users and an experiment have runs in both; what happens in one may end a wait in the other."""
    rng = random.Random(seed)
    kinds = {rng.choice(["lids", "holds", "zones", "hands", "covers"]): True}
    here, there = Case(rng, **kinds), Case(rng, **kinds)
    lab = here.lab()
    other = elsewhere("other", there.cell)
    lab.furnish(other)
    lab.do(DeclareStation(StationName("other/stack"), ("plate+lid" if there.covers else "plate",) * 40))
    experiment = lab.experiment()
    what = [*here.plans, *(elsewhere("other", plan) for plan in there.plans)]
    rng.shuffle(what)
    for number, plan in enumerate(what):
        more = {"experiment": experiment} if number % 3 == 0 else {"user": ("ada", "bob")[number % 2]}
        lab.submit(plan, priority=rng.choice([0, 0, 1]), **more)

    def pump() -> None:
        lab.pump()
        assert lab.find_missed() == [], lab.describe_stuck()

    assert lab.work(rng, pump), f"trapped: {lab.describe_stuck()}"
    lab.end(experiment)
    lab.check_log()


@given(st.randoms(use_true_random=False))
@settings(max_examples=25, derandomize=True, deadline=None)
def test_every_run_completes_in_cells_that_are_looked_for(rng: random.Random) -> None:
    work(rng)


def test_by_the_papers_rule_alone_many_of_the_same_cases_deadlock(capsys: pytest.CaptureFixture[str]) -> None:
    """Move a → b when a is occupied and b is empty, with no thought of what comes after."""
    trapped = 0
    for seed in range(MANY):
        rng = random.Random(seed)
        lab = Case(rng).submit_all()
        trapped += not lab.work(rng, lab.pump_by_rule)
    with capsys.disabled():
        print(f"\nbare rule: {trapped} of {MANY} cases deadlock; with the safety check: none")
    assert trapped > 0


class Day(Chaos):
    """A bad day on which planning is watched: nobody may be missed."""

    def __init__(self, rng: random.Random) -> None:
        super().__init__(rng)
        self.lab.pump_by_rule = lambda: None  # type: ignore[method-assign]
        pump = self.lab.pump

        def watch_pump(limit: int = 10_000) -> list[str]:
            started = pump(limit)
            assert self.lab.find_missed() == [], (self.lab.describe_stuck(), self.lab.types()[-8:])
            return started

        self.lab.pump = watch_pump  # type: ignore[method-assign]


@pytest.mark.parametrize("seed", range(30))
def test_on_bad_days_too_everybody_is_woken(seed: int) -> None:
    day = Day(random.Random(seed))
    day.day(60)
    day.end_day()
    check_nothing_left(day.lab)
    day.lab.check_log()


def test_the_same_seed_gives_the_same_log() -> None:
    first, second = work(random.Random(7)), work(random.Random(7))
    assert first.log == second.log


@few_and_many(FEW // 3, MANY // 3)
def test_after_somebody_has_reached_in_everybody_goes_on(seeds: range) -> None:
    """While a workcell is held nothing starts there; then nobody sleeps on, and nobody is trapped."""
    granted = 0
    for seed in seeds:
        rng = random.Random(seed)
        lab = Case(rng, lids=seed % 2 == 0).submit_all()

        def pump(lab: Driver = lab, rng: random.Random = rng) -> None:
            if rng.random() < 0.2 and not lab.state.lab.access:
                lab.do(RequestAccess(CELL, "ada"))
            started = lab.pump()
            assert not (started and lab.state.lab.access), started
            assert lab.find_missed() == [], lab.describe_stuck()
            if lab.state.lab.access and not lab.list_flying():
                lab.do(EndAccess(CELL, "ada"))
                lab.pump()
                assert lab.find_missed() == [], lab.describe_stuck()

        assert lab.work(rng, pump), f"seed {seed}, trapped: {lab.describe_stuck()}"
        granted += lab.types().count("workcell.access_granted")
        lab.check_log()
    assert granted > len(seeds)
