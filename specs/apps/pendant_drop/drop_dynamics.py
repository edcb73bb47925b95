"""From a series of speckle to a diffusion coefficient.

g₂(τ) = ⟨I(t) I(t+τ)⟩ / ⟨I⟩², over pixels of about one q and over time. For spheres that diffuse it is
1 + β exp(-2 D q² τ) (Siegert), so that D is the slope of the rate Γ = D q² over q². Stokes and Einstein make
a radius of it.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import curve_fit

BOLTZMANN = 1.380649e-23
Q_BINS, LAGS = 6, 24
MOST_COUNTS = 255
SATURATED_PART = 0.01
LEAST_COUNTS = 0.05
"""Photons a pixel and frame, below which there is no speckle to see."""


class Series(NamedTuple):
    """Counts by frame, row and column; seconds a frame; q (1/m) by row and column; K."""

    counts: np.ndarray
    period: float
    q: np.ndarray
    temperature: float


class Curve(NamedTuple):
    """g₂ over lags in s, for pixels of about one q, with its fit."""

    q: float
    lag: np.ndarray
    g2: np.ndarray
    deviation: np.ndarray
    contrast: float
    rate: float
    rate_error: float


class Dynamics(NamedTuple):
    """A diffusion coefficient in m²/s, and what it was found from."""

    diffusion: float
    error: float
    curves: list[Curve]


class BadSeries(ValueError):
    """A series that tells nothing: ``what`` is wrong with it in a word or two."""


def series_of(told: dict[str, Any], content: np.ndarray) -> Series:
    """A series from what the beamline told of it and the array that it left. Raises BadSeries."""
    side, frames = int(told["side"]), int(told["frames"])
    if frames < 16 or content.size != side * side * frames:
        raise BadSeries("incomplete series")
    rows, columns = np.mgrid[0:side, 0:side] - float(told["centre"])
    counts = content.reshape(frames, side, side)
    q = float(told["q_per_pixel"]) * np.hypot(rows, columns)
    return Series(counts, float(told["period"]), q, float(told["temperature"]))


def check(series: Series) -> None:
    """Raises BadSeries for one that is saturated or dark."""
    if np.mean(series.counts >= MOST_COUNTS) > SATURATED_PART:
        raise BadSeries("saturated series")
    if np.mean(series.counts) < LEAST_COUNTS:
        raise BadSeries("no number in g₂")


def g2_of(counts: np.ndarray, lags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """g₂ of pixels (columns) over frames (rows), and how much it deviates between quarters of the pixels."""
    parts = np.array_split(np.arange(counts.shape[1]), 4)
    told = np.array([[_correlate(counts[:, part], int(lag)) for lag in lags] for part in parts])
    whole = np.array([_correlate(counts, int(lag)) for lag in lags])
    return whole, np.std(told, axis=0, ddof=1) / math.sqrt(len(parts))


def _correlate(counts: np.ndarray, lag: int) -> float:
    early, late = counts[: len(counts) - lag], counts[lag:]
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.mean(early * late) / (np.mean(early) * np.mean(late)))


def dynamics_of(series: Series) -> Dynamics:
    """The diffusion coefficient. Raises BadSeries."""
    check(series)
    flat = series.counts.reshape(len(series.counts), -1).astype("float64")
    q = series.q.reshape(-1)
    edges = np.quantile(q, np.linspace(0, 1, Q_BINS + 1))
    curves = []
    for low, high in pairwise(edges):
        inside = (q >= low) & (q <= high)
        curves.append(_curve(flat[:, inside], q[inside], series.period))
    q2, rates = np.array([curve.q**2 for curve in curves]), np.array([curve.rate for curve in curves])
    weights = 1 / np.array([curve.rate_error for curve in curves]) ** 2
    diffusion = float(np.sum(weights * q2 * rates) / np.sum(weights * q2**2))
    scatter = np.sum(weights * (rates - diffusion * q2) ** 2) / (len(curves) - 1)
    error = float(np.sqrt(max(scatter, 1.0) / np.sum(weights * q2**2)))
    if not math.isfinite(diffusion):
        raise BadSeries("no number in g₂")
    return Dynamics(diffusion, error, curves)


def find_dynamics(told: dict[str, Any], content: np.ndarray) -> Dynamics | str:
    """What the beamline told and the array that it left, analysed; or what is wrong with them. For
    ``compute``: a series that tells nothing is a result, and comes again from the log."""
    try:
        return dynamics_of(series_of(told, content))
    except BadSeries as bad:
        return str(bad)


def _curve(counts: np.ndarray, q: np.ndarray, period: float) -> Curve:
    """The rate is that of the mean q²; what pixels of other q do to the curve is in the fit."""
    lags = np.arange(1, min(LAGS, len(counts) // 4) + 1)
    lag = lags * period
    g2, deviation = g2_of(counts, lags)
    if not np.all(np.isfinite(g2)):
        raise BadSeries("no number in g₂")
    sigma = np.full(len(lag), np.median(deviation) + 1e-6)
    middle = float(np.mean(q**2))
    parts = (q**2 / middle)[:, None]

    def siegert(lag: np.ndarray, contrast: float, rate: float) -> np.ndarray:
        return 1 + contrast * np.mean(np.exp(-2 * rate * parts * lag), axis=0)

    start = (max(g2[0] - 1, 0.01), 1 / (lag[len(lag) // 3]))
    try:
        found, spread = curve_fit(siegert, lag, g2, p0=start, sigma=sigma, bounds=([0, 0], [2, np.inf]))
    except RuntimeError as error:
        raise BadSeries("no fit of g₂") from error
    return Curve(
        math.sqrt(middle), lag, g2, deviation, float(found[0]), float(found[1]), float(np.sqrt(spread[1, 1]))
    )


def radius_of(diffusion: float, temperature: float, viscosity: float) -> float:
    """The hydrodynamic radius in m, by Stokes and Einstein."""
    return BOLTZMANN * temperature / (6 * math.pi * viscosity * diffusion)
