"""The growth assay's own files, as its program imports them, and readings as the bench shows them."""

from __future__ import annotations

import random
import sys
from pathlib import Path
from typing import Any

from labos_drivers._growth import Stay, compute_growth
from labos_drivers._optics import BLANK_OD

APP = Path(__file__).parents[2] / "specs" / "apps" / "growth_assay"
sys.path[:0] = [path for path in [str(APP)] if path not in sys.path]

STOCK = {
    "medium": "medium",
    "cells": "cells",
    "strong": "tetracycline_64_mg_per_l",
    "weak": "tetracycline_2_mg_per_l",
}


def table(*stays: Stay, seed: int = 0, cells: bool = True) -> dict[str, Any]:
    """What a reader shows of an assay plate after these stays in an incubator."""
    import growth_layout

    noise = random.Random(seed)
    held: dict[str, dict[str, float]] = {}
    for liquid in growth_layout.LIQUIDS:
        for well, ul in growth_layout.volumes(liquid).items():
            if cells or liquid != "cells":
                held.setdefault(well, {})[STOCK[liquid]] = ul
    wells = {well: BLANK_OD + compute_growth(held[well], stays) + noise.gauss(0, 0.005) for well in held}
    return {"quantity": "absorbance", "unit": "OD", "wells": wells, "overflow": []}
