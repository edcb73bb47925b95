"""Pictures, a table and a static page of what an experiment has found."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from drop_dynamics import Dynamics, radius_of
from matplotlib.figure import Figure
from PIL import Image

from labos.client import Experiment
from labos.client.report import ReportPage, write_report


class Drop(NamedTuple):
    """A drop that was measured."""

    well: str
    dynamics: Dynamics
    temperature: float
    frame: np.ndarray
    microscope: np.ndarray


class Summary(NamedTuple):
    """Of all drops: m²/s and m."""

    diffusion: float
    error: float
    radius: float


def summary_of(drops: Sequence[Drop], viscosity: float) -> Summary:
    """The mean diffusion coefficient, its standard error, and the radius that follows."""
    told = np.array([drop.dynamics.diffusion for drop in drops])
    errors = np.array([drop.dynamics.error for drop in drops])
    within = float(np.sqrt(np.sum(errors**2)) / len(drops))
    between = float(np.std(told, ddof=1) / np.sqrt(len(drops))) if len(drops) > 1 else 0.0
    mean = float(np.mean(told))
    temperature = float(np.mean([drop.temperature for drop in drops]))
    return Summary(mean, max(within, between), radius_of(mean, temperature, viscosity))


def write_drop_report(
    experiment: Experiment, folder: Path | None, drops: Sequence[Drop], viscosity: float
) -> ReportPage:
    """Plots, table and page."""
    found = summary_of(drops, viscosity)
    return write_report(
        experiment,
        folder or Path(f"drops-{experiment.id}"),
        "Pendant drop",
        paragraphs=[
            f"Diffusion coefficient {found.diffusion * 1e12:.3f} ± {found.error * 1e12:.3f} µm²/s; "
            f"hydrodynamic radius {found.radius * 1e9:.1f} nm."
        ],
        pictures={
            "rates.png": ("rates over q squared", draw_rates(drops)),
            "g2.png": ("intensity correlation of the first drop", draw_g2(drops[0])),
            "drop.png": (
                "the first drop under the microscope, and a frame of the detector",
                side_by_side(drops[0].microscope, drops[0].frame),
            ),
        },
        table=[
            {
                "well": drop.well,
                "diffusion_m2_per_s": drop.dynamics.diffusion,
                "error_m2_per_s": drop.dynamics.error,
                "radius_nm": radius_of(drop.dynamics.diffusion, drop.temperature, viscosity) * 1e9,
            }
            for drop in drops
        ],
        files="series and pictures",
    )


def side_by_side(microscope: np.ndarray, frame: np.ndarray) -> bytes:
    """The drop as the microscope sees it, and a frame of the detector, as a PNG."""
    shown = (255 * (frame / max(int(frame.max()), 1))).astype("uint8")
    left, right = (
        Image.fromarray(picture).resize((320, 320), Image.NEAREST) for picture in (microscope, shown)
    )
    both = Image.new("L", (650, 320), 255)
    both.paste(left, (0, 0))
    both.paste(right, (330, 0))
    file = io.BytesIO()
    both.save(file, "PNG")
    return file.getvalue()


def draw_g2(drop: Drop) -> Figure:
    """Correlations of a drop, with what was fitted."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for number, curve in enumerate(drop.dynamics.curves):
        color = f"C{number}"
        axes.errorbar(
            curve.lag * 1e6, curve.g2, curve.deviation, fmt=".", color=color, label=f"{curve.q / 1e6:.0f}"
        )
        fitted = 1 + curve.contrast * np.exp(-2 * curve.rate * curve.lag)
        axes.plot(curve.lag * 1e6, fitted, color=color)
    axes.set(xlabel="lag (µs)", ylabel="g₂", xscale="log", title=f"Well {drop.well}")
    axes.legend(title="q (1/µm)")
    return figure


def draw_rates(drops: Sequence[Drop]) -> Figure:
    """Rates over q², with a line for each drop."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for number, drop in enumerate(drops):
        curves = drop.dynamics.curves
        q2 = np.array([curve.q**2 for curve in curves])
        rates = [curve.rate for curve in curves]
        errors = [curve.rate_error for curve in curves]
        axes.errorbar(q2 / 1e12, rates, errors, fmt="o", color=f"C{number}", label=drop.well)
        axes.plot(q2 / 1e12, drop.dynamics.diffusion * q2, color=f"C{number}")
    axes.set(xlabel="q² (1/µm²)", ylabel="rate Γ (1/s)", title="The slope is the diffusion coefficient")
    axes.legend()
    return figure
