"""Varies the best of the mixtures that were tried last."""

from __future__ import annotations

import math
import random

Mixture = tuple[float, float, float]
Color = list[float]

WELL_UL, LEAST_UL = 275.0, 20.0


class EvolutionaryColorSolver:
    tried: list[Mixture] = []

    @classmethod
    def run_iteration(
        cls,
        target_color: Color,
        current_plate: list[Color] | None,
        *,
        pop_size: int,
        out_dim: tuple[int, int],
        return_volumes: bool,
    ) -> list[Mixture]:
        """Volumes in µL of the three colours, for each well."""
        rng = random.Random(repr(current_plate))
        if current_plate is None:
            parts = [tuple(rng.uniform(0.1, 1) for _ in range(3)) for _ in range(pop_size)]
        else:
            best, _ = cls._find_best_color(current_plate, target_color, None)
            parts = [tuple(max(v * rng.gauss(1, 0.25), 1) for v in cls.tried[best]) for _ in range(pop_size)]
        cls.tried = [fill_up(part) for part in parts]
        return cls.tried

    @classmethod
    def _find_best_color(
        cls, colors: list[Color], target_color: Color, cur_best_color: Color | None
    ) -> tuple[int, list[float]]:
        diffs = [cls._color_diff(color, target_color) for color in colors]
        return diffs.index(min(diffs)), diffs

    @staticmethod
    def _color_diff(color: Color, target_color: Color) -> float:
        return math.dist(color, target_color)


def fill_up(parts: tuple[float, ...]) -> Mixture:
    """A full well, with as much of each as a pipette takes at least."""
    free = WELL_UL - 3 * LEAST_UL
    a, b, c = (round(LEAST_UL + free * part / sum(parts), 1) for part in parts)
    return a, b, c
