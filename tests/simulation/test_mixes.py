"""Whole labs in virtual time: nothing lost, nothing twice, nobody trapped.

A failing seed is replayed by ``pytest tests/simulation --seed N -k storm``.
"""

from __future__ import annotations

import random
from collections import Counter

import pytest

from labos.core.actions import ActionEvent, ActionRequested
from labos.core.ids import local
from labos.core.registry import decode
from labos.core.runs import RunSubmitted
from labos.core.state import LabState, hash_state
from labos.planning.layout import lay_out
from labos.planning.safety import Safety
from labos.testing.faults import CRASH_POINTS, QUIET, STORMY, FaultRates, Faults
from labos.testing.lab import SimulatedLab, make_bare_scheduler
from labos.testing.loop import Stalled
from tests.simulation.invariants import fold_again
from tests.simulation.mixes import identical, make_generated, mix, pcr, stand

pytestmark = pytest.mark.timeout(300)
"""These tests compute for half a minute; on a busy computer they take several times as long."""

CI_SEEDS = range(5)
ALL_SEEDS = range(200)
FIVE_DAYS_S = 5 * 24 * 3600.0
STILL_S = 12 * 3600.0
"""A lab in which nothing has happened for so long is stuck."""


def live_through(seed: int, rates: FaultRates) -> tuple[LabState, Faults]:
    """One seed to its end; the bench and the log agree in every plate."""
    lab = SimulatedLab(stand(), seed, rates)
    try:
        state = lab.run(mix(seed), limit_s=FIVE_DAYS_S)
        assert lab.differences(state) == [], f"seed {seed}"
        assert not state.runs.active
        assert not state.runs.queued
        faults = [fault for kernel in lab.opened for fault in kernel.faults]
        assert not faults, f"seed {seed}: {faults}"
        assert hash_state(fold_again(lab.store.records)) == hash_state(state)
        return state, lab.faults
    finally:
        lab.close()


def seeds(request: pytest.FixtureRequest, usual: range) -> range:
    one = request.config.getoption("--seed")
    return usual if one is None else range(one, one + 1)


def test_one_pcr_runs_to_its_end() -> None:
    lab = SimulatedLab(stand(), 0, QUIET)
    try:
        state = lab.run([pcr("one", "ada")])
        assert lab.differences(state) == []
        output = state.bench.stations[next(n for n in state.bench.stations if local(n) == "wc.output")]
        assert [state.bench.labware[name].owner for name in output.labware] == ["user:ada"]
        assert len(lab.world.at("wc.output.1")) == 1
    finally:
        lab.close()


@pytest.mark.parametrize(
    "usual", [range(2), pytest.param(range(2, 12), marks=pytest.mark.full)], ids=["few", "many"]
)
def test_quiet_mixes_complete(request: pytest.FixtureRequest, usual: range) -> None:
    for seed in seeds(request, usual):
        live_through(seed, QUIET)


@pytest.mark.slow
def test_storms_lose_nothing_and_repeat_nothing(request: pytest.FixtureRequest) -> None:
    crashes: Counter[str] = Counter()
    for seed in seeds(request, CI_SEEDS):
        crashes += live_through(seed, STORMY)[1].crashes
    print("crashes", dict(crashes))


@pytest.mark.slow
@pytest.mark.parametrize("point", CRASH_POINTS)
@pytest.mark.parametrize("seeds", [range(2)], ids=["few"])
def test_a_crash_at_this_point_costs_nothing(point: str, seeds: range) -> None:
    """Processes die at one kind of place only, but often. A short lab may come through without a death:
    then the seeds after it are tried."""
    hit = 0
    for seed in range(seeds.start, seeds.stop + 10):
        if seed >= seeds.stop and hit:
            break
        lab = SimulatedLab(stand(), seed, FaultRates(crash=0.02, longest_delay_s=0.2))
        lab.faults.only = point
        try:
            state = lab.run(mix(seed, largest=5), limit_s=FIVE_DAYS_S)
            assert lab.differences(state) == [], f"seed {seed}"
            hit += lab.faults.crashes[point]
        finally:
            lab.close()
    assert hit > 0


STOPPED = ("pf400", "sciclops", "sealer", "peeler", "camera_module")
"""Modules without a door or lid: of one that was stopped half-way a person would have to say where
it is."""


def count_stops(seed: int) -> tuple[Counter[str], Counter[str]]:
    """Emergency stops in the midst of a storm; how many were recorded, and what became of resets."""
    rng = random.Random(f"stops/{seed}")
    stops = [(f"rpl/{rng.choice(STOPPED)}", rng.uniform(600, 9000)) for _ in range(8)]
    jobs = [pcr(f"j{n}", "ada", rng.uniform(0, 3600)) for n in range(4)]
    jobs += [make_generated(f"k{n}", "bo", rng.randrange(40), rng.uniform(0, 3600)) for n in range(3)]
    lab = SimulatedLab(stand(), seed, STORMY, stops=stops)
    lab.tidies = True  # a run that was stopped with its plate at a station has failed, and leaves it there
    try:
        state = lab.run(jobs, limit_s=FIVE_DAYS_S)
        assert lab.differences(state) == [], f"seed {seed}"
        assert not [name for name, module in state.modules.by_name.items() if module.status == "ERROR"]
        types, resets, mine = Counter[str](), Counter[str](), set()
        for record in lab.store.records:
            event = decode(record.head.type, record.head.schema, record.payload)
            types[event.TYPE] += 1
            if isinstance(event, ActionRequested) and event.name == "reset":
                mine.add(event.action)
            if isinstance(event, ActionEvent) and event.action in mine:
                resets[event.TYPE] += 1
        return types, resets
    finally:
        lab.close()


@pytest.mark.slow
def test_emergency_stops_and_resets_in_a_storm_lose_nothing(request: pytest.FixtureRequest) -> None:
    types, resets = Counter[str](), Counter[str]()
    for seed in seeds(request, range(3)):
        found = count_stops(seed)
        types += found[0]
        resets += found[1]
    print(f"stops {types['module.emergency_stopped']}, resets {dict(resets)}")
    assert types["module.emergency_stopped"] > 0
    assert resets["action.succeeded"] > 0


@pytest.mark.slow
def test_the_same_seed_gives_the_same_log() -> None:
    hashes = set()
    for _ in range(2):
        lab = SimulatedLab(stand(), 7, STORMY)
        try:
            lab.run(mix(7, largest=4), limit_s=FIVE_DAYS_S)
            hashes.add(lab.store.head().hash)
        finally:
            lab.close()
    assert len(hashes) == 1


def deadlocks(count_seeds: range, work: object = None) -> int:
    """How many mixes hang under the paper's rule: source occupied, target empty, nothing more."""
    hung = 0
    for seed in count_seeds:
        lab = SimulatedLab(stand(), seed, QUIET, plan_with=make_bare_scheduler, still_s=STILL_S)
        try:
            lab.run(mix(seed), limit_s=60 * 3600.0)
        except Stalled:
            hung += 1
        finally:
            lab.close()
    return hung


@pytest.mark.slow
def test_the_bare_rule_deadlocks_where_safety_does_not() -> None:
    hung = deadlocks(range(4))
    print(f"bare rule: {hung} of 4 mixes deadlock; with safety: 0")
    assert hung > 0


@pytest.mark.slow
def test_six_identical_routes_deadlock_only_under_the_bare_rule() -> None:
    lab = SimulatedLab(stand(), 1, QUIET)
    try:
        lab.run(identical(6), limit_s=FIVE_DAYS_S)
    finally:
        lab.close()


def outlive(seed: int, module: str) -> Counter[str]:
    """Runs in all, runs that ended, runs let in that could still reach their end but hang; and of those that
    wait outside, how many do not need the dead module: plates that do are in their way."""
    lab = SimulatedLab(stand(), seed, QUIET, doomed={module: 4000.0 + 500.0 * (seed % 7)}, still_s=STILL_S)
    try:
        state = lab.run_for(mix(seed), 60 * 3600.0)
        submitted = sum(record.head.type == RunSubmitted.TYPE for record in lab.store.records)
        left = len(state.runs.active) + len(state.runs.queued)
        safety = Safety()
        actors = safety.list_actors(state, stand().workcell.name)
        floor = lay_out(state, stand().workcell.name, actors, hopeful=False)
        names = {str(run) for run in state.runs.active}
        _, ends = safety.find(floor, actors, set())
        waiting = [state.runs.plan_of(run).steps for run in state.runs.queued.values()]
        without = sum(all(local(step.module) != module for step in steps) for steps in waiting)
        told = {"submitted": submitted, "ended": submitted - left, "hang": len(ends & names)}
        return Counter(told | {"kept out, though they do not need it": without})
    finally:
        lab.close()


def with_one_module_dead(count_seeds: range) -> Counter[str]:
    total: Counter[str] = Counter()
    for seed in count_seeds:
        module = ["peeler", "sealer", "camera_module", "ot2_pcr_alpha", "biometra"][seed % 5]
        total += outlive(seed, module)
    print(f"one module dead: {dict(total)}")
    return total


@pytest.mark.full
def test_who_can_finish_without_a_dead_module_does() -> None:
    assert with_one_module_dead(range(5))["hang"] == 0


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_two_hundred_storms(request: pytest.FixtureRequest) -> None:
    crashes: Counter[str] = Counter()
    events = 0
    for seed in seeds(request, ALL_SEEDS):
        state, faults = live_through(seed, STORMY)
        crashes += faults.crashes
        events += state.position
    print(f"200 storms complete, {events} events, crashes {dict(crashes)}")


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_two_hundred_under_the_bare_rule() -> None:
    for seed in ALL_SEEDS:
        live_through(seed, QUIET)
    print(f"bare rule: {deadlocks(ALL_SEEDS)} of {len(ALL_SEEDS)} mixes deadlock; with safety: 0")


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_two_hundred_with_one_module_dead() -> None:
    assert with_one_module_dead(ALL_SEEDS)["hang"] == 0
