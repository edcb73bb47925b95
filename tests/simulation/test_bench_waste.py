"""A chute that holds three plates, and a person who empties it."""

from __future__ import annotations

import pytest

from labos.core.bench import StationState
from labos.testing.faults import QUIET, STORMY
from labos.testing.lab import SimulatedLab
from tests.simulation.corners import Corner, jobs

CORNER = Corner("""
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
stations:
  wc.trash: {kind: waste, capacity: 3}
stock:
  left.tower1: {plate96: 20}
""")

RUNS = [
    CORNER.run("thrown", "left.get_plate loc=tower1", "ur.transfer source=left.exchange target=wc.trash")
] * 8


@pytest.mark.parametrize("rates", [QUIET, STORMY])
def test_nothing_is_thrown_into_a_full_chute(rates: object) -> None:
    for seed in range(3):
        lab = SimulatedLab(CORNER.stand, seed, rates)  # type: ignore[arg-type]
        try:
            state = lab.run(jobs(RUNS), limit_s=24 * 3600.0)
            assert lab.differences(state) == [], f"seed {seed}"
            assert lab.emptied > 1
        finally:
            lab.close()


def test_uncounted_it_overflows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StationState, "count", property(_count_all))
    for seed in range(2):
        crashes = CORNER.crashes(RUNS, seed)
        assert any("throws a plate into a full chute" in crash for crash in crashes), f"seed {seed}"


def _count_all(station: StationState) -> int:
    kept = 0 if station.spec.kind == "waste" else len(station.labware) + len(station.stock)
    return kept + station.expected
