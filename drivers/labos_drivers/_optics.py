"""What simulated instruments see of liquids: dyes absorb light, by Beer's law to first order."""

from __future__ import annotations

import math
from collections.abc import Mapping

Color = tuple[float, float, float]
Contents = Mapping[str, float]
"""Of a well: µL by liquid."""

WELL_UL = 275.0
"""A well filled as high as this shows a dye's full strength."""

ABSORBS: dict[str, Color] = {
    "color_A": (0.1, 0.9, 0.7),
    "color_B": (0.8, 0.1, 0.9),
    "color_C": (0.9, 0.7, 0.1),
    "color_D": (0.6, 0.6, 0.6),
    "red": (0.05, 0.85, 0.75),
    "green": (0.8, 0.1, 0.7),
    "blue": (0.85, 0.6, 0.05),
}
"""How much of red, green and blue light a full well of a dye swallows; all others are clear."""

BANDS_NM: Color = (620.0, 540.0, 450.0)
WIDTH_NM = 45.0
BLANK_OD = 0.04


def color_of(contents: Contents) -> Color:
    """Red, green and blue (0 to 255) of a well."""
    left = [max(1.0 - swallowed, 0.0) for swallowed in _swallowed(contents)]
    return 255 * left[0], 255 * left[1], 255 * left[2]


def absorbance_of(contents: Contents, nm: float) -> float:
    """The optical density of a well at a wavelength (nm)."""
    bands = zip(_swallowed(contents), BANDS_NM, strict=True)
    return BLANK_OD + sum(part * math.exp(-(((nm - middle) / WIDTH_NM) ** 2)) for part, middle in bands)


def _swallowed(contents: Contents) -> Color:
    red, green, blue = (
        sum(ABSORBS[liquid][channel] * ul / WELL_UL for liquid, ul in contents.items() if liquid in ABSORBS)
        for channel in range(3)
    )
    return red, green, blue
