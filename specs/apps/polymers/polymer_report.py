"""Pictures, a table and a static page of what an experiment has found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from polymer_colours import Lab, rgb_of
from polymer_recommender import Recipe

from labos.client import Experiment
from labos.client.report import ReportPage, write_report


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


def write_polymer_report(
    experiment: Experiment, folder: Path | None, samples: Sequence[Sample], target: Lab, tolerance: float
) -> ReportPage:
    """Plots, table and page."""
    nearest = min(samples, key=lambda sample: sample.difference)
    a, b, c, length = nearest.recipe
    return write_report(
        experiment,
        folder or Path(f"polymers-{experiment.id}"),
        "Electrochromic polymers",
        paragraphs=[
            f"Target L*a*b* {target}; nearest {nearest.lab} in well {nearest.well} of batch {nearest.batch}: "
            f"a difference of {nearest.difference:.2f} (CIE 2000), tolerance {tolerance:g}. Recipe: {a:.3f}, "
            f"{b:.3f} and {c:.3f} of the monomers A, B and C, {length:g} units in a chain."
        ],
        pictures={
            "convergence.png": (
                "difference to the target, sample by sample",
                draw_convergence(samples, target, tolerance),
            ),
            "spectra.png": ("spectra", draw_spectra(samples)),
        },
        table=[_row(sample) for sample in samples],
        files="the reader's tables",
    )


def _row(sample: Sample) -> dict[str, object]:
    shares = zip(("share_A", "share_B", "share_C", "chain_length"), sample.recipe, strict=True)
    return {
        "batch": sample.batch,
        "well": sample.well,
        **dict(shares),
        **dict(zip("Lab", sample.lab, strict=True)),
        **dict(zip("xy", sample.xy, strict=True)),
        "difference_CIE2000": sample.difference,
    }


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
