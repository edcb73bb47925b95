"""Diffusion coefficients from simulated speckle against Stokes and Einstein."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drop_dynamics import BadSeries, check, dynamics_of, g2_of, radius_of, series_of
from pendant_drop import HERE, Wanted, read_wanted

from labos.errors import BadInput
from tests.apps.simulated import beamline, series

TRUTH = {"silica_30": 8.178e-12, "silica_50": 4.9065e-12, "silica_100": 2.4533e-12}
"""m²/s in water at 25 °C: k T / (6 π η R), worked out by hand."""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("particle", TRUTH)
def test_the_diffusion_coefficient_is_found_within_eight_percent(particle: str, seed: int) -> None:
    found = dynamics_of(series("water", particle, seed=seed))
    assert found.diffusion == pytest.approx(TRUTH[particle], rel=0.08)
    assert abs(found.diffusion - TRUTH[particle]) < 5 * found.error
    radius = radius_of(found.diffusion, 298.15, 0.89e-3)
    assert radius == pytest.approx(float(particle.rpartition("_")[2]) * 1e-9, rel=0.08)
    assert {round(curve.contrast, 1) for curve in found.curves} <= {0.3, 0.4}


def test_a_thicker_liquid_is_slower() -> None:
    water = dynamics_of(series("water", "silica_100", period=2e-5))
    thick = dynamics_of(series("glycerol_50", "silica_100", period=1e-4))
    assert water.diffusion / thick.diffusion == pytest.approx(5.0 / 0.89, rel=0.15)


def test_rates_go_with_the_square_of_q() -> None:
    found = dynamics_of(series("water", "silica_100", seed=4))
    slope, _ = np.polyfit(np.log([c.q for c in found.curves]), np.log([c.rate for c in found.curves]), 1)
    assert slope == pytest.approx(2.0, abs=0.15)


def test_what_does_not_move_is_not_taken_for_what_diffuses() -> None:
    still = np.tile(np.random.default_rng(0).poisson(20, (1, 500)), (64, 1)).astype(float)
    g2, _ = g2_of(still, np.arange(1, 16))
    assert np.ptp(g2) < 1e-9


@pytest.mark.parametrize(
    ("photons", "why"), [(0.0, "no number in g₂"), (beamline.PHOTONS, "saturated series")]
)
def test_a_dark_or_saturated_series_is_told(photons: float, why: str) -> None:
    with pytest.raises(BadSeries, match=why):
        check(series("water", "silica_50", photons=photons))


def test_a_series_that_is_not_whole_is_told() -> None:
    told = {
        "side": 40,
        "frames": 256,
        "centre": -12.0,
        "q_per_pixel": 1e6,
        "period": 2e-5,
        "temperature": 298,
    }
    with pytest.raises(BadSeries, match="incomplete series"):
        series_of(told, np.zeros(100, "uint8"))
    assert series_of(told, np.zeros(256 * 1600, "uint8")).counts.shape == (256, 40, 40)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("liquid_1: water", "missing 2 required"),
        ("[1]", "is not a table"),
        ("liquid_1: water\nliquid_2: s\nviscosity: 0", "above 0"),
        ("liquid_1: water\nliquid_2: s\nviscosity: 1\nwell: A1", "'well' is unknown"),
        ("liquid_1: water\nliquid_2: s\nviscosity: 1\nwells: []", "`wells` is empty"),
        ("liquid_1: water\nliquid_2: s\nviscosity: 1\nno_drop: shrug", "`no_drop: shrug` is unknown"),
    ],
)
def test_a_bad_payload_is_refused_with_its_reason(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "payload.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=why):
        read_wanted(path)


def test_the_packaged_payload_is_good() -> None:
    wanted = Wanted("water", "silica_50", 0.89e-3, ["A1", "A2", "A3"])
    assert read_wanted(HERE / "payloads" / "silica_50.yaml") == wanted
