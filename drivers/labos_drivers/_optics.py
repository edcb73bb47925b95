"""What simulated instruments measure of liquids: dyes absorb light, by the law of Beer and Lambert.

Light passes through a well from above. So the absorbance of a dye depends on its amount per area of the well,
not on its dilution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

Color = tuple[float, float, float]
Contents = Mapping[str, float]
"""Of a well: µL by liquid."""

WELL_UL = 275.0
"""So much of a dye alone shows its full strength."""

ABSORBS: dict[str, Color] = {
    "color_A": (0.1, 0.9, 0.7),
    "color_B": (0.8, 0.1, 0.9),
    "color_C": (0.9, 0.7, 0.1),
    "color_D": (0.6, 0.6, 0.6),
    "red": (0.05, 0.85, 0.75),
    "green": (0.8, 0.1, 0.7),
    "blue": (0.85, 0.6, 0.05),
}
"""The optical density of a full well of a dye for red, green and blue light; all other liquids are clear."""

BANDS_NM: Color = (620.0, 540.0, 450.0)
WIDTH_NM = 45.0
BLANK_OD = 0.04


def color_of(contents: Contents) -> Color:
    """The colour of a well as red, green and blue (0 to 255)."""
    red, green, blue = (255 * 10**-density for density in _density(contents))
    return red, green, blue


def absorbance_of(contents: Contents, nm: float) -> float:
    """The optical density of a well at a wavelength (nm)."""
    bands = zip(_density(contents), BANDS_NM, strict=True)
    return BLANK_OD + sum(part * math.exp(-(((nm - middle) / WIDTH_NM) ** 2)) for part, middle in bands)


def _density(contents: Contents) -> Color:
    red, green, blue = (
        sum(ABSORBS[liquid][channel] * ul / WELL_UL for liquid, ul in contents.items() if liquid in ABSORBS)
        for channel in range(3)
    )
    return red, green, blue
