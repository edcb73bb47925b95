"""The growth of bacteria in wells; only the simulated bench knows this model.

Cells grow by a logistic law while their plate is in an incubator. A drug reduces their final amount by Hill's
law. ``IC50_MG_PER_L`` is the true value, with which the result of an analysis of readings is compared.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

IC50_MG_PER_L = {"tetracycline": 0.9}
"""The concentration that halves the growth of E. coli, by drug. Near its usual inhibitory concentration."""

HILL = 1.8
CELLS_OD = 0.1
"""The optical density at 590 nm of the suspension that is pipetted."""

GAIN_OD = 1.1
"""What a well without a drug gains until its medium is used up."""

RATE_PER_H = 1.0
HALFWAY_H = 5.0
"""When half of it has grown, at the best temperature."""

BEST_C, WIDTH_C = 37.0, 9.0
NAMED_DRUG = re.compile(r"(?P<drug>[a-z]+)_(?P<mg_per_l>[0-9.]+)_mg_per_l")

Stay = tuple[float, float]
"""Hours in an incubator, and its temperature (°C)."""


def compute_growth(contents: Mapping[str, float], stays: Iterable[Stay]) -> float:
    """The optical density at 590 nm that cells add to a well with these contents (µL by liquid)."""
    total = sum(contents.values())
    cells = contents.get("cells", 0.0)
    if not cells or not total:
        return 0.0
    inoculum = CELLS_OD * cells / total
    hours = sum(hours * math.exp(-(((celsius - BEST_C) / WIDTH_C) ** 2)) for hours, celsius in stays)
    before, now = _logistic(0.0), _logistic(hours)
    return inoculum + GAIN_OD * _find_remaining_part(contents, total) * (now - before) / (1.0 - before)


def _logistic(hours: float) -> float:
    return 1.0 / (1.0 + math.exp(-RATE_PER_H * (hours - HALFWAY_H)))


def _find_remaining_part(contents: Mapping[str, float], total: float) -> float:
    """The part of the growth that remains despite the drugs in a well (0 to 1)."""
    left = 1.0
    for liquid, ul in contents.items():
        if (drug := NAMED_DRUG.fullmatch(liquid)) and drug["drug"] in IC50_MG_PER_L:
            dose = float(drug["mg_per_l"]) * ul / total
            left /= 1.0 + (dose / IC50_MG_PER_L[drug["drug"]]) ** HILL
    return left
