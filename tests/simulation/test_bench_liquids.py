"""Liquids are used up as tips, foil and tape are, in their own unit: no protocol starts that would find a
vessel empty. The bench has its own count of every liquid."""

from __future__ import annotations

import pytest

from labos.core import binding, rules
from labos.core.ids import ModuleName
from labos.core.state import LabState
from labos.planning import stuck
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.simulation.corners import Corner, jobs

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: ot2, model: ot2, resources: {tips: 960, color_A: 100, color_B: 1000}}
stations:
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""")

MIX = CORNER.run(
    "mix",
    "left.get_plate loc=tower1",
    "ur.transfer source=left.exchange target=ot2.deck2",
    "ot2.run_protocol config_path=mix.py color_A_volumes=[20,20] color_B_volumes=[5,5] "
    "destination_wells=[A1,B1]",
    "ur.transfer source=ot2.deck2 target=wc.trash",
)
RUNS = [MIX] * 4
"""Two of them find what they need."""


def run_lab(seed: int) -> tuple[LabState, list[str], dict[str, float | None]]:
    """The log, what crashed, and what is really left."""
    lab = SimulatedLab(CORNER.stand, seed, QUIET)
    try:
        state = lab.run_for(jobs(RUNS), 3 * 3600.0)
        left = {name: lab.world.find_level("ot2", name) for name in ("color_A", "color_B", "color_C")}
        return state, [motion.facts["what"] for motion in lab.world.crashes()], left
    finally:
        lab.close()


def test_who_would_run_out_of_a_liquid_waits() -> None:
    for seed in range(3):
        state, crashed, left = run_lab(seed)
        assert crashed == []
        assert len(state.runs.queued) == 2
        assert left == {"color_A": 20, "color_B": 980, "color_C": None}
        for name, amount in left.items():
            assert state.resources.find_left(ModuleName("corner/ot2"), name) == amount


def test_where_only_solid_things_are_counted_the_robot_runs_dry(monkeypatch: pytest.MonkeyPatch) -> None:
    real = binding.find_unreserved

    def solid(state: LabState, module: ModuleName, resource: str) -> float | None:
        return real(state, module, resource) if resource in ("tips", "foil", "tape") else float("inf")

    for place in (binding, rules, stuck):
        monkeypatch.setattr(place, "find_unreserved", solid)
    for seed in range(3):
        assert "runs out of color_A" in run_lab(seed)[1], f"seed {seed}"
