"""Hands that lose plates and do not notice: with observers the log knows, without them it is wrong.

A failing seed is replayed by ``pytest tests/simulation/test_bench_mishaps.py --seed N -k drop``.
"""

from __future__ import annotations

import random
from collections import Counter

import pytest
from msgspec.structs import replace

from labos.core.actions import ActionFailed
from labos.core.labware import LabwareUncertain
from labos.core.runs import RunFailed
from labos.testing.faults import STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.corners import Corner
from tests.simulation.seen import events

CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: stacker, model: sciclops}
  - {name: pf400, model: pf400}
  - {name: ur, model: ur5}
  - {name: sealer, model: A4S_sealer}
  - {name: peeler, model: brooks_xpeel}
  - {name: eye, model: camera}
stations:
  stacker.exchange: {observer: eye}
  stacker.tower1: {observer: eye}
  sealer.default: {observer: eye}
  peeler.default: {observer: eye}
  wc.a: {observer: eye}
  wc.b: {observer: eye}
  wc.output: {shelves: 60, observer: eye}
stock:
  stacker.tower1: {plate96: 20}
"""
)

CI_SEEDS = range(3)
ALL_SEEDS = range(200)
CLUMSY = FaultRates(mishap=0.08)
A_WEEK_S = 7 * 24 * 3600.0


def without_observers() -> Stand:
    """The same bench, and nobody looks."""
    full = CORNER.stand
    blind = tuple(replace(station, verify="never") for station in full.workcell.stations)
    return replace(full, workcell=replace(full.workcell, stations=blind))


def mix(seed: int) -> list[Job]:
    """Plates that are carried about, sealed and peeled, submitted over an hour."""
    rng = random.Random(f"mishaps/{seed}")
    jobs = []
    for number in range(rng.randint(3, 7)):
        arm, place, sealed = rng.choice(["pf400", "ur"]), "stacker.exchange", False
        steps = ["stacker.get_plate loc=tower1"]
        for _ in range(rng.randint(2, 5)):
            places = ["wc.a", "wc.b", "peeler.default" if sealed else "sealer.default"]
            target = rng.choice([p for p in places if p != place])
            steps.append(f"{arm}.transfer source={place} target={target}")
            if target.startswith(("sealer", "peeler")):
                steps.append("peeler.peel" if sealed else "sealer.seal time=3.0 temperature=175")
                sealed = not sealed
            place = target
        steps.append(f"{arm}.transfer source={place} target=wc.output")
        run = CORNER.run(f"way {seed}.{number}", *steps)
        jobs.append(Job(f"j{number}", "ada", (run,), after_s=rng.uniform(0, 3600)))
    # By then people have answered everything.
    return [*jobs, Job("last", "ada", (CORNER.run("last", "stacker.home"),), after_s=6 * 3600.0)]


def live_through(stand: Stand, seed: int, rates: FaultRates) -> tuple[list[str], SimulatedLab]:
    blind = {"eye": 1500.0} if rates.crash and seed % 3 == 0 else {}  # in storms it is away for a while
    lab = SimulatedLab(stand, seed, rates, still_s=12 * 3600.0, doomed=blind, mended={"eye": 1200.0})
    lab.tidies = True
    try:
        state = lab.run_for(mix(seed), A_WEEK_S)
        return lab.differences(state), lab
    finally:
        lab.close()


def count_slips(seeds: range, rates: FaultRates) -> Counter[str]:
    """With observers: how often hands slipped, and what was seen of it."""
    total: Counter[str] = Counter()
    for seed in seeds:
        wrong, lab = live_through(CORNER.stand, seed, rates)
        assert not wrong, f"seed {seed}: {wrong}"
        assert len(lab.done_jobs) == len(mix(seed)), f"seed {seed}: {lab.report()}"
        assert not [fault for kernel in lab.opened for fault in kernel.faults]
        slips = sum(count for how, count in lab.world.mishaps.items() if how)
        happened = events(lab)
        failed = [e for e in happened if isinstance(e, ActionFailed) and e.kind == "operational"]
        total["motions"] += sum(lab.world.mishaps.values())
        total["slips"] += slips
        total["seen"] += len(failed)
        total["runs failed (operational)"] += sum(
            isinstance(e, RunFailed) and e.kind == "operational" for e in happened
        )
        total["lost"] += sum(isinstance(e, LabwareUncertain) for e in happened)
    return total


def seeds(request: pytest.FixtureRequest, usual: range) -> range:
    one = request.config.getoption("--seed")
    return usual if one is None else range(one, one + 1)


@pytest.mark.slow
def test_what_hands_drop_is_noticed_where_somebody_looks(request: pytest.FixtureRequest) -> None:
    total = count_slips(seeds(request, CI_SEEDS), CLUMSY)
    print(dict(total))
    assert total["seen"] == total["slips"] > 0


@pytest.mark.full
def test_what_hands_drop_is_believed_where_nobody_looks() -> None:
    """The control: without observers the log differs from the bench."""
    wrong = [live_through(without_observers(), seed, CLUMSY)[0] for seed in range(12)]
    assert sum(map(bool, wrong)) > len(wrong) / 2


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_two_hundred_clumsy_labs_in_storms(request: pytest.FixtureRequest) -> None:
    total = count_slips(seeds(request, ALL_SEEDS), replace(STORMY, mishap=0.08))
    print(dict(total))
    assert total["seen"] > 0


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_two_hundred_clumsy_labs_that_nobody_looks_at() -> None:
    wrong = [live_through(without_observers(), seed, CLUMSY)[0] for seed in ALL_SEEDS]
    print(f"without observers {sum(map(bool, wrong))} of {len(wrong)} labs differ from their bench")
    assert sum(map(bool, wrong)) > len(wrong) / 2
