"""Pictures, a table and a static page of what an experiment has found."""

from __future__ import annotations

import csv
import html
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from drop_dynamics import Dynamics, radius_of
from matplotlib.figure import Figure
from PIL import Image


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


def write_report(folder: Path, drops: Sequence[Drop], viscosity: float, where: str) -> Path:
    """Write ``g2.png``, ``rates.png``, ``drop.png``, ``drops.csv`` and ``index.html``; returns the page."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "drops.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["well", "diffusion_m2_per_s", "error_m2_per_s", "radius_nm"])
        for drop in drops:
            radius = radius_of(drop.dynamics.diffusion, drop.temperature, viscosity)
            table.writerow([drop.well, drop.dynamics.diffusion, drop.dynamics.error, radius * 1e9])
    draw_g2(drops[0]).savefig(folder / "g2.png", dpi=110)
    draw_rates(drops).savefig(folder / "rates.png", dpi=110)
    write_pictures(folder / "drop.png", drops[0].microscope, drops[0].frame)
    page = folder / "index.html"
    page.write_text(_page(drops, summary_of(drops, viscosity), where), "utf-8")
    return page


def write_pictures(path: Path, microscope: np.ndarray, frame: np.ndarray) -> None:
    """The drop as the microscope sees it, and a frame of the detector, beside each other."""
    shown = (255 * (frame / max(int(frame.max()), 1))).astype("uint8")
    left, right = (
        Image.fromarray(picture).resize((320, 320), Image.NEAREST) for picture in (microscope, shown)
    )
    both = Image.new("L", (650, 320), 255)
    both.paste(left, (0, 0))
    both.paste(right, (330, 0))
    both.save(path)


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


def _page(drops: Sequence[Drop], found: Summary, where: str) -> str:
    rows = "\n".join(
        f"<tr><td>{html.escape(drop.well)}</td><td>{drop.dynamics.diffusion * 1e12:.3f}</td>"
        f"<td>{drop.dynamics.error * 1e12:.3f}</td></tr>"
        for drop in drops
    )
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Pendant drop</title>
<style>body{{font-family:sans-serif;max-width:50em;margin:2em auto}}img{{max-width:100%}}
td,th{{padding:.2em .6em;text-align:right}}</style>
<h1>Pendant drop</h1>
<p>Diffusion coefficient {found.diffusion * 1e12:.3f} ± {found.error * 1e12:.3f} µm²/s; hydrodynamic radius
{found.radius * 1e9:.1f} nm.</p>
<img src="rates.png" alt="rates over q squared">
<img src="g2.png" alt="intensity correlation of the first drop">
<img src="drop.png" alt="the first drop under the microscope, and a frame of the detector">
<table><tr><th>well</th><th>D (µm²/s)</th><th>±</th></tr>
{rows}
</table>
<p>The numbers: <a href="drops.csv">drops.csv</a>. The data: {html.escape(where)}</p>
</html>
"""
