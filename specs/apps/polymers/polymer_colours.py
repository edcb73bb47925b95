"""From a reader's table of spectra to colours: CIE XYZ, L*a*b* and sRGB by the library ``colour-science``."""

from __future__ import annotations

from typing import NamedTuple

import colour
import numpy as np

OBSERVER, LIGHT = "CIE 1931 2 Degree Standard Observer", "D65"
VISIBLE = (380.0, 780.0)
SATURATED_OD = 3.5
"""Above this a reader measures its own stray light."""

Lab = tuple[float, float, float]


class Spectra(NamedTuple):
    """Optical densities of wells (rows) at wavelengths in nm (columns)."""

    nm: np.ndarray
    od: dict[str, np.ndarray]


class Judged(NamedTuple):
    """Wells by what their spectra are worth."""

    good: list[str]
    no_number: list[str]
    saturated: list[str]


def read_table(content: bytes) -> Spectra:
    """A table as Magellan exports it: UTF-16, tabs, ``*`` and the wavelengths in the first line. Raises
    ValueError for another file."""
    lines = [line.split("\t") for line in content.decode("utf-16-le").splitlines() if line.strip()]
    if not lines or lines[0][0] != "*":
        raise ValueError("the first line of the table does not begin with '*'")
    nm = np.array([float(name.removesuffix("nm")) for name in lines[0][1:]])
    od = {cells[0]: np.array([float(cell) for cell in cells[1:]]) for cells in lines[1:]}
    if wrong := [well for well, values in od.items() if len(values) != len(nm)]:
        raise ValueError(f"well {wrong[0]} has another number of values than the first line")
    return Spectra(nm, od)


def judge(spectra: Spectra, wells: list[str]) -> Judged:
    """Which spectra hold no number, and which are saturated. A well that is not in the table has none."""
    good, no_number, saturated = [], [], []
    for well in wells:
        od = spectra.od.get(well)
        if od is None or not np.all(np.isfinite(od)):
            no_number.append(well)
        elif np.max(od[_visible(spectra.nm)]) > SATURATED_OD:
            saturated.append(well)
        else:
            good.append(well)
    return Judged(good, no_number, saturated)


def xyz_of(nm: np.ndarray, od: np.ndarray) -> np.ndarray:
    """CIE XYZ (0 to 1) of white light that went through."""
    shape = colour.SpectralShape(*VISIBLE, 5)
    visible = _visible(nm)
    transmitted = colour.SpectralDistribution(10 ** -od[visible], nm[visible]).align(shape)
    observer = colour.MSDS_CMFS[OBSERVER].copy().align(shape)
    light = colour.SDS_ILLUMINANTS[LIGHT].copy().align(shape)
    return colour.sd_to_XYZ(transmitted, observer, light, method="Integration") / 100


def lab_of(nm: np.ndarray, od: np.ndarray) -> Lab:
    """CIE L*a*b* under D65."""
    white = colour.CCS_ILLUMINANTS[OBSERVER][LIGHT]
    lightness, a, b = (round(float(value), 3) for value in colour.XYZ_to_Lab(xyz_of(nm, od), white))
    return lightness, a, b


def chromaticity_of(nm: np.ndarray, od: np.ndarray) -> tuple[float, float]:
    """CIE x and y."""
    x, y = (round(float(value), 4) for value in colour.XYZ_to_xy(xyz_of(nm, od)))
    return x, y


def rgb_of(lab: Lab) -> tuple[float, float, float]:
    """What a screen shows (0 to 1); what it cannot show is cut off."""
    white = colour.CCS_ILLUMINANTS[OBSERVER][LIGHT]
    red, green, blue = np.clip(colour.XYZ_to_sRGB(colour.Lab_to_XYZ(lab, white)), 0, 1)
    return float(red), float(green), float(blue)


def difference(one: Lab, other: Lab) -> float:
    """How different two colours look: CIE 2000; 1 is just seen."""
    return round(float(colour.delta_E(np.array(one), np.array(other), method="CIE 2000")), 3)


def _visible(nm: np.ndarray) -> np.ndarray:
    return (nm >= VISIBLE[0]) & (nm <= VISIBLE[1])
