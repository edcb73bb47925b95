"""Pendant drops: the arm wears its gripper or its pipette, and no run takes it with the other's tip on."""

from __future__ import annotations

import pytest

from labos.testing.faults import QUIET, STORMY
from labos.testing.lab import SimulatedLab
from tests.simulation.corners import Corner, jobs

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur3e, config: {pendant: {pipette_input: 16, tip_input: 17}}}
stations:
  wc.wells: {}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""")

DROP = [
    *("ur.pick_pipette", "ur.create_sample plate=wc.wells well=A1 liquid_1=water liquid_2=silica"),
    *("ur.place_pipette", "ur.run_droplet", "ur.pick_pipette", "ur.dispose_tip", "ur.place_pipette"),
]
RUNS = [
    CORNER.run(
        "drop",
        "left.get_plate loc=tower1",
        "ur.transfer source=left.exchange target=wc.wells",
        *DROP,
        "ur.transfer source=wc.wells target=wc.trash",
    )
] * 3


@pytest.mark.parametrize("rates", [QUIET, STORMY])
def test_drops_of_several_runs_do_not_meet(rates: object) -> None:
    lab = SimulatedLab(CORNER.stand, 1, rates)  # type: ignore[arg-type]
    try:
        state = lab.run(jobs(RUNS), limit_s=24 * 3600.0)
        assert lab.differences(state) == []
        assert lab.world.crashes() == []
        if rates is QUIET:
            verbs = [m.verb for m in lab.world.motions() if m.device == "ur"]
            done = [verb for verb in verbs if any(verb == step.split()[0][3:] for step in DROP)]
            assert done == [step.split()[0][3:] for step in DROP] * len(RUNS)
    finally:
        lab.close()
