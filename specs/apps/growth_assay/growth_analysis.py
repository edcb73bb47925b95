"""From two readings of a plate to a dose–response curve."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from growth_layout import BLANKS, COLUMNS, REPLICATES, doses
from scipy.optimize import curve_fit

from labos.errors import LabosError


class BadReading(LabosError):
    """A table of the reader that cannot be used."""


class Column(NamedTuple):
    """The replicates of one dose (mg/L): mean and standard error of the blank-adjusted OD590."""

    dose: float
    mean: float
    error: float


class Curve(NamedTuple):
    """What was fitted: ``top / (1 + (dose / ic50) ** hill)``; ``ic50_error`` is one standard error (mg/L)."""

    ic50: float
    ic50_error: float
    hill: float
    top: float

    def at(self, dose: float) -> float:
        return float(_response(dose, self.top, math.log(self.ic50), self.hill))


def check(table: Any, where: str) -> dict[str, float]:
    """The optical density of each well. Raises BadReading for a well without one: not read, not a number, or
    so dark that the reader overflowed."""
    wells = table.get("wells") if isinstance(table, Mapping) else None
    if not isinstance(wells, Mapping):
        raise BadReading(f"{where}: the reader gave no table of wells.", remedy="Read the plate again.")
    expected = [f"{row}{column}" for row in REPLICATES + BLANKS for column in COLUMNS]
    bad = [well for well in expected if not _is_number(wells.get(well))]
    if bad:
        shown = ", ".join(bad[:5]) + (" …" if len(bad) > 5 else "")
        raise BadReading(
            f"{where}: {len(bad)} of {len(expected)} wells have no value: {shown}.",
            remedy="Look at the plate for what overflows the reader, then read it again.",
        )
    return {well: float(wells[well]) for well in expected}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def adjusted(wells: Mapping[str, float]) -> dict[int, list[float]]:
    """The replicates of each column, less the mean of the column's blanks."""
    found = {}
    for column in COLUMNS:
        blank = sum(wells[f"{row}{column}"] for row in BLANKS) / len(BLANKS)
        found[column] = [wells[f"{row}{column}"] - blank for row in REPLICATES]
    return found


def summarise(wells: Mapping[str, float]) -> list[Column]:
    """Each column of one reading."""
    told = doses()
    return [
        Column(told[column], float(np.mean(values)), float(np.std(values, ddof=1) / math.sqrt(len(values))))
        for column, values in adjusted(wells).items()
    ]


def fit(first: Sequence[Mapping[str, float]], last: Sequence[Mapping[str, float]]) -> Curve:
    """The curve through what all wells of some plates have grown from their first to their last reading.
    Raises BadReading where nothing has grown, or no curve fits."""
    told, x, y = doses(), list[float](), list[float]()
    for before, after in zip(map(adjusted, first), map(adjusted, last), strict=True):
        for column in COLUMNS:
            x += [told[column]] * len(REPLICATES)
            y += [late - early for early, late in zip(before[column], after[column], strict=True)]
    undrugged = [grown for dose, grown in zip(x, y, strict=True) if dose == 0]
    top = float(np.mean(undrugged))
    if top < 0.1:
        raise BadReading(
            f"Cells without a drug have gained an optical density of {top:.3f} only: nothing has grown.",
            remedy="Look at the incubator's temperature, and at the cells.",
        )
    try:
        best, spread = curve_fit(
            _response,
            np.array(x),
            np.array(y),
            p0=(top, 0.0, 1.0),
            bounds=((0.0, math.log(1e-3), 0.2), (10.0, math.log(1e3), 8.0)),
        )
    except RuntimeError as error:
        raise BadReading(f"No dose–response curve fits: {error}.", remedy="Look at the plot.") from None
    ic50 = math.exp(best[1])
    return Curve(ic50, ic50 * math.sqrt(float(spread[1][1])), float(best[2]), float(best[0]))


def _response(dose: Any, top: float, log_ic50: float, hill: float) -> Any:
    return top / (1.0 + (np.asarray(dose) / math.exp(log_ic50)) ** hill)
