"""Which mixtures to try next: four solvers behind one protocol."""

from __future__ import annotations

import itertools
import random  # noqa: TID251 - an application brings its own randomness, from a seed
import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from threadpoolctl import threadpool_limits

from labos.client.plate_reading import Color
from labos.errors import BadInput

LEAST_UL, MOST_UL = 20.0, 90.0
"""Of each dye: the least that a pipette of 300 µL takes, and so much that three fit into a well."""


class Mixture(NamedTuple):
    """µL of each dye in a well."""

    a: float
    b: float
    c: float


def distance(one: Color, other: Color) -> float:
    """Euclidean, in red, green and blue."""
    return round(sum((a - b) ** 2 for a, b in zip(one, other, strict=True)) ** 0.5, 2)


class Solver(Protocol):
    """Proposes mixtures, and learns which colours they had."""

    def ask(self, count: int) -> list[Mixture]:
        """So many mixtures to try next."""
        ...

    def tell(self, mixtures: Sequence[Mixture], colors: Sequence[Color]) -> None:
        """Which colours mixtures had that have been tried, as far as they could be read."""
        ...


class RandomSolver:
    """Anywhere. It learns nothing: what others have to beat."""

    def __init__(self, target: Color, seed: int = 0) -> None:
        self.target, self._random = target, random.Random(seed)

    def ask(self, count: int) -> list[Mixture]:
        return [_mixture([self._random.random() for _ in range(3)]) for _ in range(count)]

    def tell(self, mixtures: Sequence[Mixture], colors: Sequence[Color]) -> None:
        """Nothing is learned."""


class GridSolver:
    """The points of a grid in a random order, and then those of finer ones."""

    COARSEST = 5

    def __init__(self, target: Color, seed: int = 0) -> None:
        self.target, self._random = target, random.Random(seed)
        self._levels, self._left = self.COARSEST, list[tuple[float, ...]]()

    def ask(self, count: int) -> list[Mixture]:
        return [_mixture(self._next()) for _ in range(count)]

    def tell(self, mixtures: Sequence[Mixture], colors: Sequence[Color]) -> None:
        """Nothing is learned."""

    def _next(self) -> tuple[float, ...]:
        if not self._left:
            steps = [number / (self._levels - 1) for number in range(self._levels)]
            self._left = list(itertools.product(steps, repeat=3))
            self._random.shuffle(self._left)
            self._levels = 2 * self._levels - 1
        return self._left.pop()


class EvolutionarySolver:
    """That of the paper's application: a third are means of two parents, a third have some amounts of a
    parent changed, the rest are new. Parents are the best so far; how many, ``PARENTS`` says."""

    PARENTS, CHANGE = 6, 0.15

    def __init__(self, target: Color, seed: int = 0) -> None:
        self.target, self._random = target, random.Random(seed)
        self._best: list[tuple[float, tuple[float, ...]]] = []

    def ask(self, count: int) -> list[Mixture]:
        return [_mixture(self._child()) for _ in range(count)]

    def tell(self, mixtures: Sequence[Mixture], colors: Sequence[Color]) -> None:
        pairs = zip(mixtures, colors, strict=True)
        tried = [(distance(color, self.target), _point(mixture)) for mixture, color in pairs]
        self._best = sorted([*self._best, *tried])[: self.PARENTS]

    def _child(self) -> Sequence[float]:
        kind = self._random.randrange(3)
        if len(self._best) < 2 or kind == 2:
            return [self._random.random() for _ in range(3)]
        if kind == 0:
            (_, one), (_, other) = self._random.sample(self._best, 2)
            return [(x + y) / 2 for x, y in zip(one, other, strict=True)]
        _, parent = self._random.choice(self._best)
        return [self._changed(x) if self._random.random() > 0.5 else x for x in parent]

    def _changed(self, share: float) -> float:
        return min(max(share + self._random.gauss(0.0, self.CHANGE), 0.0), 1.0)


class BayesianSolver:
    """A Gaussian process (scikit-learn) for each channel of the colour; the next mixtures are those that are
    expected to come nearest to the target. What a channel does is smooth, what a distance does is not."""

    FIRST = 6
    """So many are random, before there is something to learn from."""
    CANDIDATES, DRAWS, SPACING = 1000, 32, 0.01
    """Mixtures that are thought of, draws of their colours, and how far two of a batch are apart at least (of
    the range of a dye)."""

    def __init__(self, target: Color, seed: int = 0) -> None:
        self.target, self._random, self._seed = np.array(target), np.random.default_rng(seed), seed
        self._known: list[tuple[float, ...]] = []
        self._seen: list[Color] = []

    def ask(self, count: int) -> list[Mixture]:
        if len(self._known) < self.FIRST:
            return [_mixture(point) for point in self._random.uniform(size=(count, 3))]
        candidates = np.vstack([self._anywhere(), self._near_best()])
        with threadpool_limits(1):  # more threads are slower with so few numbers
            gains = self._gains(candidates)
        chosen: list[np.ndarray] = []
        for number in np.argsort(-gains, kind="stable"):
            point = candidates[number]
            if all(np.max(np.abs(point - other)) >= self.SPACING for other in chosen):
                chosen.append(point)
            if len(chosen) == count:
                break
        return [_mixture(point) for point in chosen]

    def tell(self, mixtures: Sequence[Mixture], colors: Sequence[Color]) -> None:
        self._known += map(_point, mixtures)
        self._seen += colors

    def _gains(self, points: np.ndarray) -> np.ndarray:
        """The expected improvement of each, over draws from what is believed of its colour."""
        known, seen = np.array(self._known), np.array(self._seen)
        drawn = np.zeros((self.DRAWS, len(points), 3))
        for channel in range(3):
            mean, deviation = self._fit(known, seen[:, channel]).predict(points, return_std=True)
            drawn[:, :, channel] = self._random.normal(mean, deviation, (self.DRAWS, len(points)))
        best = np.min(np.linalg.norm(seen - self.target, axis=1))
        apart = np.linalg.norm(drawn - self.target, axis=2)
        # Where nothing is gained in any draw, what is expected nearest comes first.
        return np.mean(np.maximum(best - apart, 0.0), axis=0) - 1e-6 * np.mean(apart, axis=0)

    def _fit(self, known: np.ndarray, values: np.ndarray) -> GaussianProcessRegressor:
        kernel = ConstantKernel(2.0, (0.1, 100)) * RBF([1.0] * 3, (0.1, 20)) + WhiteKernel(1e-3, (1e-6, 1e-1))
        model = GaussianProcessRegressor(kernel, normalize_y=True, random_state=self._seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a bound is reached, and meant
            return model.fit(known, values)

    def _anywhere(self) -> np.ndarray:
        return self._random.uniform(size=(self.CANDIDATES // 2, 3))

    def _near_best(self) -> np.ndarray:
        apart = np.linalg.norm(np.array(self._seen) - self.target, axis=1)
        best = np.array(self._known)[np.argsort(apart)[:3]]
        step = self._random.choice([0.02, 0.05, 0.15], (self.CANDIDATES // 2, 1))
        near = best[self._random.integers(len(best), size=self.CANDIDATES // 2)]
        return np.clip(near + step * self._random.normal(size=near.shape), 0, 1)


SOLVERS: dict[str, Callable[[Color, int], Solver]] = {
    "evolutionary": EvolutionarySolver,
    "bayesian": BayesianSolver,
    "grid": GridSolver,
    "random": RandomSolver,
}


def solver_of(name: str, target: Color, seed: int) -> Solver:
    """Raises BadInput."""
    if name not in SOLVERS:
        raise BadInput(f"`solver: {name}` is unknown.", remedy=f"Known are {', '.join(SOLVERS)}.")
    return SOLVERS[name](target, seed)


def _mixture(shares: Sequence[float]) -> Mixture:
    return Mixture(*(round(LEAST_UL + float(share) * (MOST_UL - LEAST_UL), 1) for share in shares))


def _point(mixture: Mixture) -> tuple[float, ...]:
    return tuple((ul - LEAST_UL) / (MOST_UL - LEAST_UL) for ul in mixture)
