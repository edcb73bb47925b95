"""What a simulated synthesis makes, and what a simulated reader measures: copolymers that absorb light.

A copolymer of three monomers has an absorption band at the energy of its gap. The gap is the mean of those of
its monomers, weighted by their shares. It is narrower where different monomers alternate, and wider for short
chains (1/n, after Kuhn). Where donors and acceptors alternate, a second band appears at a higher energy. All
numbers are invented.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from labos.node import World

MONOMERS = ("monomer_A", "monomer_B", "monomer_C")
GAPS_EV = (2.95, 2.20, 1.75)
"""Of a long chain of one monomer alone."""

BOWING_EV, SHORTER_EV = 0.30, 1.2
SECOND_EV, SECOND_PART = 1.05, 0.55
WIDTH_EV, MIXED_WIDTH_EV = 0.17, 0.10
OD_BY_UL = 0.02
BLANK_OD = 0.04
EV_NM = 1239.84


class Polymer(NamedTuple):
    """The content of a well: the µL of each monomer's solution, and the number of units in a chain."""

    volumes_ul: tuple[float, float, float]
    length: float


def find_polymers(world: World, plate: str) -> dict[str, Polymer]:
    """The polymers on a plate by well. If several were made in a well, the last one counts."""
    made: dict[str, Polymer] = {}
    for motion in world.motions("synthesise"):
        if not plate or motion.plate != plate:
            continue
        facts = motion.facts
        volumes = [facts.get("volumes", {}).get(monomer) or () for monomer in MONOMERS]
        lengths = facts.get("lengths") or ()
        for number, well in enumerate(facts.get("wells") or ()):
            a, b, c = (_value_at(doses, number, 0.0) for doses in volumes)
            made[well] = Polymer((a, b, c), _value_at(lengths, number, 20.0))
    return made


def gap_ev(polymer: Polymer) -> float:
    """The energy of the first band (eV)."""
    a, b, c = _shares(polymer)
    alone = sum(share * gap for share, gap in zip((a, b, c), GAPS_EV, strict=True))
    return alone - BOWING_EV * 4 * (a * b + b * c + a * c) / 3 + SHORTER_EV / max(polymer.length, 1.0)


def absorbance_of(polymer: Polymer, nm: float) -> float:
    """The optical density of a well at a wavelength (nm)."""
    total = sum(polymer.volumes_ul)
    if total <= 0:
        return BLANK_OD
    a, b, c = _shares(polymer)
    gap, width = gap_ev(polymer), WIDTH_EV + MIXED_WIDTH_EV * 3 * (a * b + b * c + a * c)
    first = _band(nm, gap, width)
    second = SECOND_PART * 4 * a * c * _band(nm, gap + SECOND_EV, 1.3 * width)
    return BLANK_OD + OD_BY_UL * total * (first + second)


def find_bubbles(world: World, plate: str) -> set[str]:
    """The wells with a bubble. The motion of the reader's carrier removes bubbles, so a second reading finds
    none."""
    found: set[str] = set()
    for motion in world.motions():
        if motion.plate == plate and motion.verb == "bubble":
            found.add(str(motion.facts["well"]))
        elif motion.plate == plate and motion.verb == "read":
            found.clear()
    return found


def add_noise(od: float, draw: Callable[[float, float], float], most_od: float) -> float:
    """The optical density that a reader reports: with noise, and at most the highest one that it measures."""
    return min(od + draw(0.0, 0.003 + 0.002 * od), most_od)


def _shares(polymer: Polymer) -> tuple[float, float, float]:
    total = sum(polymer.volumes_ul) or 1.0
    a, b, c = (volume / total for volume in polymer.volumes_ul)
    return a, b, c


def _band(nm: float, middle_ev: float, width_ev: float) -> float:
    return math.exp(-(((EV_NM / nm - middle_ev) / width_ev) ** 2) / 2)


def _value_at(values: Sequence[float], number: int, other: float) -> float:
    return float(values[number]) if number < len(values) else other
