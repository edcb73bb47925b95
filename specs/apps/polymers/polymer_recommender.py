"""Which polymers to make next: Gaussian processes of scikit-learn learn colours from recipes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from threadpoolctl import threadpool_limits

LENGTHS = (5.0, 60.0)
SPACING = 0.02
"""Two recipes of one batch differ by at least this much."""

CANDIDATES, DRAWS = 1500, 32
Lab = tuple[float, float, float]


class Recipe(NamedTuple):
    """Shares of the three monomers, which add up to 1, and units in a chain."""

    a: float
    b: float
    c: float
    length: float


class Recommender:
    """Learns each coordinate of the colour, and proposes what is expected to come nearer to the target.
    ``differ`` says how different two colours are."""

    def __init__(self, target: Lab, differ: Callable[[Lab, Lab], float], seed: int = 0) -> None:
        self.target, self._differ = target, differ
        self._random = np.random.default_rng(seed)
        self._seed = seed
        self.recipes: list[Recipe] = []
        self.colours: list[Lab] = []

    def ask(self, count: int) -> list[Recipe]:
        """So many recipes to make next."""
        if len(self.recipes) < 4:
            return [_recipe(point) for point in self._anywhere(count)]
        candidates = np.vstack([self._anywhere(CANDIDATES // 2), self._near_best(CANDIDATES // 2)])
        with threadpool_limits(1):  # more threads are slower with so few numbers
            gains = self._gains(candidates)
        chosen: list[np.ndarray] = []
        for number in np.argsort(-gains, kind="stable"):
            point = candidates[number]
            if all(np.max(np.abs(point - other)) >= SPACING for other in chosen):
                chosen.append(point)
            if len(chosen) == count:
                break
        return [_recipe(point) for point in chosen]

    def tell(self, recipes: Sequence[Recipe], colours: Sequence[Lab]) -> None:
        """What colours recipes have made."""
        self.recipes += recipes
        self.colours += colours

    @property
    def nearest(self) -> float:
        """How different the best colour so far is from the target."""
        return min((self._differ(seen, self.target) for seen in self.colours), default=float("inf"))

    def _gains(self, candidates: np.ndarray) -> np.ndarray:
        """The expected improvement of each, over draws from what is believed of its colour. Distance is that
        in L*a*b*, which is quick, and not far from what is seen."""
        known = np.array([_point(recipe) for recipe in self.recipes])
        seen, target = np.array(self.colours), np.array(self.target)
        drawn = np.zeros((DRAWS, len(candidates), 3))
        for axis in range(3):
            mean, deviation = _fit(known, seen[:, axis], self._seed).predict(candidates, return_std=True)
            drawn[:, :, axis] = self._random.normal(mean, deviation, (DRAWS, len(candidates)))
        best = np.min(np.linalg.norm(seen - target, axis=1))
        return np.mean(np.maximum(best - np.linalg.norm(drawn - target, axis=2), 0.0), axis=0)

    def _anywhere(self, count: int) -> np.ndarray:
        shares = self._random.dirichlet((1, 1, 1), count)
        return np.column_stack([shares[:, 0], shares[:, 1], self._random.uniform(0, 1, count)])

    def _near_best(self, count: int) -> np.ndarray:
        order = np.argsort([self._differ(seen, self.target) for seen in self.colours])[:3]
        best = np.array([_point(self.recipes[number]) for number in order])
        step = self._random.choice([0.01, 0.03, 0.1], (count, 1))
        points = best[self._random.integers(len(best), size=count)] + step * self._random.normal(
            size=(count, 3)
        )
        points = np.clip(points, 0, 1)
        total = points[:, :2].sum(axis=1, keepdims=True)
        points[:, :2] /= np.maximum(total, 1.0)
        return points


def _fit(known: np.ndarray, values: np.ndarray, seed: int) -> GaussianProcessRegressor:
    kernel = ConstantKernel(2.0, (0.1, 100)) * RBF([0.4, 0.4, 0.6], (0.05, 10)) + WhiteKernel(
        1e-4, (1e-6, 1e-1)
    )
    model = GaussianProcessRegressor(kernel, normalize_y=True, random_state=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a bound is reached, and meant
        return model.fit(known, values)


def _point(recipe: Recipe) -> np.ndarray:
    low, high = np.log(LENGTHS)
    return np.array([recipe.a, recipe.b, (np.log(recipe.length) - low) / (high - low)])


def _recipe(point: np.ndarray) -> Recipe:
    low, high = np.log(LENGTHS)
    a, b = round(float(point[0]), 3), round(float(point[1]), 3)
    length = round(float(np.exp(low + float(point[2]) * (high - low))), 1)
    return Recipe(a, b, round(max(1.0 - a - b, 0.0), 3), length)
