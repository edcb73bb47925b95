"""The pictures and the page with which an assay ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from growth_analysis import Column, Curve, summarise
from growth_layout import DRUG
from matplotlib.figure import Figure

from labos.client import Experiment
from labos.client.report import ReportPage, write_report

NO_DOSE = 0.03
"""Where wells without a drug are drawn: a logarithmic axis has no zero (mg/L)."""


def draw(
    first: Sequence[Mapping[str, float]], last: Sequence[Mapping[str, float]], curve: Curve, drug: str
) -> Figure:
    """Blank-adjusted OD590 at T0 and T12 with error bars, and the fitted curve."""
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for readings, name, colour in ((first, "T0", "#7a8794"), (last, "T12", "#1f5fa8")):
        columns = _over_plates(readings)
        axes.errorbar(
            [max(column.dose, NO_DOSE) for column in columns],
            [column.mean for column in columns],
            yerr=[column.error for column in columns],
            fmt="o",
            capsize=3,
            label=name,
            color=colour,
        )
    start = float(np.mean([column.mean for column in _over_plates(first)]))
    x = np.geomspace(NO_DOSE, 40.0, 200)
    axes.plot(x, [start + curve.at(dose) for dose in x], color="#1f5fa8", linewidth=1)
    axes.axvline(curve.ic50, color="#b5482a", linestyle="--", linewidth=1)
    axes.annotate(
        f"IC50 {curve.ic50:.2f} mg/L",
        (curve.ic50, 1.0),
        xytext=(6, 0),
        textcoords="offset points",
        color="#b5482a",
    )
    axes.set_xscale("log")
    axes.set_xlabel(f"{drug} (mg/L; no drug at the left)")
    axes.set_ylabel("blank-adjusted OD590")
    axes.set_title("Growth of E. coli, mean and standard error")
    axes.legend()
    return figure


def _over_plates(readings: Sequence[Mapping[str, float]]) -> list[Column]:
    """Each column's mean over the plates; its error is the mean of theirs."""
    each = [summarise(wells) for wells in readings]
    return [
        Column(same[0].dose, float(np.mean([c.mean for c in same])), float(np.mean([c.error for c in same])))
        for same in zip(*each, strict=True)
    ]


def write_growth_report(
    experiment: Experiment,
    folder: Path,
    first: Sequence[Mapping[str, float]],
    last: Sequence[Mapping[str, float]],
    curve: Curve,
) -> ReportPage:
    """The picture, the fit, and a table of the doses (means and standard errors)."""
    columns = zip(_over_plates(first), _over_plates(last), strict=True)
    return write_report(
        experiment,
        folder,
        "Growth assay",
        paragraphs=[
            f"{len(first)} plates. IC50 {curve.ic50:.3f} ± {curve.ic50_error:.3f} mg/L, "
            f"Hill coefficient {curve.hill:.2f}."
        ],
        pictures={"growth.png": ("dose-response curve", draw(first, last, curve, DRUG))},
        table=[
            {
                "mg_per_l": before.dose,
                "OD590_at_T0": before.mean,
                "error_at_T0": before.error,
                "OD590_at_T12": after.mean,
                "error_at_T12": after.error,
            }
            for before, after in columns
        ],
        files="the reader's tables",
    )
