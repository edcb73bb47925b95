"""Pictures, a table and a static page of what an experiment has found."""

from __future__ import annotations

import csv
import html
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from polymer_colours import Lab, rgb_of
from polymer_recommender import Recipe


class Sample(NamedTuple):
    """A polymer that was made and measured."""

    batch: int
    well: str
    recipe: Recipe
    lab: Lab
    xy: tuple[float, float]
    difference: float
    nm: np.ndarray
    od: np.ndarray


def write_report(folder: Path, samples: Sequence[Sample], target: Lab, tolerance: float, where: str) -> Path:
    """Write ``spectra.png``, ``convergence.png``, ``samples.csv`` and ``index.html``; returns the page."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_table(folder / "samples.csv", samples)
    draw_spectra(samples).savefig(folder / "spectra.png", dpi=110)
    draw_convergence(samples, target, tolerance).savefig(folder / "convergence.png", dpi=110)
    page = folder / "index.html"
    page.write_text(_page(samples, target, tolerance, where), "utf-8")
    return page


def _write_table(path: Path, samples: Sequence[Sample]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(
            [
                "batch",
                "well",
                "share_A",
                "share_B",
                "share_C",
                "chain_length",
                "L",
                "a",
                "b",
                "x",
                "y",
                "difference_CIE2000",
            ]
        )
        for sample in samples:
            table.writerow(
                [sample.batch, sample.well, *sample.recipe, *sample.lab, *sample.xy, sample.difference]
            )


def draw_spectra(samples: Sequence[Sample]) -> Figure:
    """Spectra, each in the colour that it makes."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for sample in samples:
        axes.plot(sample.nm, sample.od, color=rgb_of(sample.lab), linewidth=1)
    axes.set(xlabel="wavelength (nm)", ylabel="optical density", title="Spectra, each in its own colour")
    return figure


def draw_convergence(samples: Sequence[Sample], target: Lab, tolerance: float) -> Figure:
    """How different from the target each sample is, and the nearest beside the target."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 1))
    order = np.arange(1, len(samples) + 1)
    differences = np.array([sample.difference for sample in samples])
    left.scatter(order, differences, c=[rgb_of(sample.lab) for sample in samples], s=30)
    left.step(order, np.minimum.accumulate(differences), where="post", color="black", label="nearest so far")
    left.axhline(tolerance, linestyle=":", color="grey", label="tolerance")
    left.set(xlabel="sample", ylabel="difference to the target (CIE 2000)", yscale="log")
    left.legend()
    nearest = min(samples, key=lambda sample: sample.difference)
    for height, (name, lab) in enumerate((("nearest", nearest.lab), ("target", target))):
        right.axhspan(height, height + 1, color=rgb_of(lab))
        right.text(0.5, height + 0.5, name, ha="center", va="center", color="white")
    right.set(xticks=[], yticks=[], ylim=(0, 2))
    return figure


def _page(samples: Sequence[Sample], target: Lab, tolerance: float, where: str) -> str:
    nearest = min(samples, key=lambda sample: sample.difference)
    rows = "\n".join(_row(sample) for sample in samples)
    a, b, c, length = nearest.recipe
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Electrochromic polymers</title>
<style>body{{font-family:sans-serif;max-width:50em;margin:2em auto}}img{{max-width:100%}}
td,th{{padding:.2em .6em;text-align:right}}</style>
<h1>Electrochromic polymers</h1>
<p>Target L*a*b* {target}; nearest {nearest.lab} in well {nearest.well} of batch {nearest.batch}:
a difference of {nearest.difference:.2f} (CIE 2000), tolerance {tolerance:g}. Recipe: {a:.3f}, {b:.3f} and
{c:.3f} of the monomers A, B and C, {length:g} units in a chain.</p>
<img src="convergence.png" alt="difference to the target, sample by sample">
<img src="spectra.png" alt="spectra">
<table><tr><th></th><th>batch</th><th>well</th><th>A</th><th>B</th><th>C</th><th>units</th><th>difference</th></tr>
{rows}
</table>
<p>The numbers: <a href="samples.csv">samples.csv</a>. The data: {html.escape(where)}</p>
</html>
"""


def _row(sample: Sample) -> str:
    red, green, blue = (round(255 * value) for value in rgb_of(sample.lab))
    shares = "".join(f"<td>{share:.3f}</td>" for share in sample.recipe[:3])
    return (
        f'<tr><td style="background:rgb({red},{green},{blue})">&emsp;</td><td>{sample.batch}</td>'
        f"<td>{html.escape(sample.well)}</td>{shares}<td>{sample.recipe.length:g}</td>"
        f"<td>{sample.difference:.2f}</td></tr>"
    )
