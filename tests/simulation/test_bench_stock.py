"""A device that runs dry crashes: no action starts without what it uses up.

The simulated bench has its own count of foil, tape and tips. What the mutants show: with the rule
switched off, the same seeds break the devices.
"""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from msgspec.structs import replace

from labos.core import binding, rules
from labos.core.ids import local
from labos.planning import stuck
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import SimulatedLab, Stand
from labos.testing.loop import Stalled
from tests.simulation.mixes import mix, stand
from tests.support.seeds import few_and_many

SEEDS = range(3)
DAYS_S = 3 * 24 * 3600.0


def poor() -> Stand:
    """The RPL workcell with next to nothing in its devices."""
    few: dict[str, float] = {"foil": 2, "tape": 2, "tips": 24}
    full = stand()
    modules = tuple(
        replace(m, levels={name: few.get(name, capacity) for name, capacity in m.levels.items()})
        for m in full.workcell.modules
    )
    return replace(full, workcell=replace(full.workcell, digest="poor", modules=modules))


def find_left(lab: SimulatedLab, name: str) -> float:
    """How much there really is of what the log calls ``module:resource``."""
    module, _, resource = name.rpartition(":")
    return lab.world.find_level(local(module), resource) or 0.0


def live(
    seed: int, rates: FaultRates, refills: bool = False, limit_s: float = DAYS_S
) -> tuple[Any, list[str]]:
    """A seed's state at its end and what crashed."""
    lab = SimulatedLab(poor(), seed, rates)
    lab.refills = refills
    try:
        state = lab.run(mix(seed), limit_s=limit_s) if refills else lab.run_for(mix(seed), limit_s)
        too_much = {
            name: (level.level, find_left(lab, name))
            for name, level in state.resources.levels.items()
            if level.level > find_left(lab, name)
        }
        assert too_much == {}, f"seed {seed}: the log believes in more than there is"
        return state, [motion.facts["what"] for motion in lab.world.crashes()]
    finally:
        lab.close()


@pytest.fixture
def _unruled(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rule switched off: everything is thought to be there in any amount."""
    for place in (binding, rules, stuck):
        monkeypatch.setattr(place, "find_unreserved", lambda state, module, resource: float("inf"))


@few_and_many(1, 3)
def test_nothing_runs_dry_and_somebody_who_refills_keeps_everything_going(seeds: range) -> None:
    for seed in seeds:
        state, crashed = live(seed, QUIET, refills=True)
        assert crashed == [], f"seed {seed}"
        assert not state.runs.active
        assert not state.runs.queued


@few_and_many(1, 3)
def test_in_storms_too(seeds: range) -> None:
    for seed in seeds:
        _, crashed = live(seed, STORMY, refills=True)
        assert not [what for what in crashed if "runs out" in what], f"seed {seed}"


@pytest.mark.slow
def test_without_refills_runs_wait_and_nothing_breaks() -> None:
    waiting = 0
    for seed in range(3):
        state, crashed = live(seed, QUIET, limit_s=12 * 3600.0)
        assert crashed == [], f"seed {seed}"
        waiting += bool(state.runs.active or state.runs.queued)
    assert waiting, "nobody ran out of anything"


@pytest.mark.full
@pytest.mark.usefixtures("_unruled")
def test_with_the_rule_off_the_same_seeds_break_devices() -> None:
    dry = 0
    for seed in SEEDS:
        lab = SimulatedLab(poor(), seed, QUIET)
        try:
            with contextlib.suppress(Stalled):
                lab.run_for(mix(seed), 24 * 3600.0)
        finally:
            dry += any("runs out" in motion.facts["what"] for motion in lab.world.crashes())
            lab.close()
    assert dry
