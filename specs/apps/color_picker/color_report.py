"""The pictures, the table and the page with which the color picker ends."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from color_solvers import Mixture
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labos.client import Experiment
from labos.client.plate_reading import Color
from labos.client.report import ReportPage, write_report


class Sample(NamedTuple):
    """A mixture that was made and seen; ``mixed_at`` in UTC nanoseconds."""

    well: str
    mixture: Mixture
    color: Color
    distance: float
    mixed_at: int


def write_picker_report(
    experiment: Experiment, folder: Path | None, samples: Sequence[Sample], target: Color, picture: bytes
) -> ReportPage:
    """Plots, table and page; the last picture of the plate is among them."""
    nearest = min(samples, key=lambda sample: sample.distance)
    a, b, c = nearest.mixture
    return write_report(
        experiment,
        folder or Path(f"color-{experiment.id}"),
        "Color picker",
        paragraphs=[
            f"Target {_shown(target)}; nearest {_shown(nearest.color)} in well {nearest.well}, a distance of "
            f"{nearest.distance:.2f}: {a:g}, {b:g} and {c:g} µL of the three dyes. {len(samples)} samples."
        ],
        pictures={
            "distance.png": ("distance to the target, sample by sample", draw_distance(samples, target)),
            "plate.jpg": ("the plate at the end", picture),
        },
        table=[
            {
                "well": sample.well,
                **{f"dye_{name}_ul": ul for name, ul in zip("ABC", sample.mixture, strict=True)},
                **dict(zip(("red", "green", "blue"), sample.color, strict=True)),
                "distance": sample.distance,
            }
            for sample in samples
        ],
        files="pictures and samples",
    )


def draw_distance(samples: Sequence[Sample], target: Color) -> Figure:
    """How far from the target each sample is, in its own colour, and the nearest beside the target."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 1))
    draw_samples(left, samples)
    nearest = min(samples, key=lambda sample: sample.distance)
    for height, (name, color) in enumerate((("nearest", nearest.color), ("target", target))):
        right.axhspan(height, height + 1, color=_of_screen(color))
        right.text(0.5, height + 0.5, name, ha="center", va="center", color="white")
    right.set(xticks=[], yticks=[], ylim=(0, 2))
    return figure


def draw_samples(axes: Axes, samples: Sequence[Sample]) -> None:
    """One dot for each, in its own colour."""
    order = np.arange(1, len(samples) + 1)
    distances = np.array([sample.distance for sample in samples])
    axes.scatter(order, distances, c=[_of_screen(sample.color) for sample in samples], s=30)
    axes.step(order, np.minimum.accumulate(distances), where="post", color="black", label="nearest so far")
    axes.set(xlabel="sample", ylabel="distance to the target (RGB)", yscale="log")
    axes.legend()


def _of_screen(color: Color) -> tuple[float, ...]:
    return tuple(min(max(part / 255, 0.0), 1.0) for part in color)


def _shown(color: Color) -> str:
    return "(" + ", ".join(f"{part:.0f}" for part in color) + ")"
