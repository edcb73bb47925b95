"""Which faults and which crash points a seed tries, and how it brings them together.

A *pair* is a crash point and a fault. It is hit once for each process that died at that point with that fault
having occurred, anywhere in the lab, not more than ``NEAR_S`` virtual seconds before or after. A death counts
once for each such fault, however often it occurred in that time.
"""

from __future__ import annotations

import random
from bisect import bisect_left
from collections import Counter

import msgspec

from labos.testing.faults import CRASH_POINTS, FAULTS, LONG_S, FaultRates, Faults

NEAR_S = 10.0
POINTS_EACH = 5
FAULTS_EACH = 5
MOST_DEATHS = 3
"""At each of its points."""
MOST_FAULTS = 12
"""Of each of its faults: then a seed's day becomes calm."""

LONGEST_DELAY_S = 20.0
"""Longer than the kernel waits for an answer (5 s): some originals arrive after the question about them."""

PAIRS = [(point, fault) for point in CRASH_POINTS for fault in FAULTS]

RATES = FaultRates(
    loss=0.03,
    duplication=0.03,
    crash=0.01,
    commit_error=0.05,
    mishap=0.5,
    reordering=0.05,
    power_cut=0.3,
    both_die=0.3,
    kernel_frozen=0.01,
    node_frozen=0.01,
    clock_jump=0.01,
)
"""While nothing of the kind has happened lately."""

SLIPS = 0.1
"""How many of the seeds without slips get them nevertheless."""

DELAYED = 0.03
EAGER = {"send": 0.15, "commit": 0.25, "journal": 0.6}
"""How likely a process dies at one of the seed's points when one of its faults has just occurred: they are
visited more or less often."""
EAGEREST = 0.5
"""The same after a slip; there is one more death for these."""

WARM = 4.0
"""So many times likelier are faults when somebody has just died."""


class Plan(msgspec.Struct, frozen=True):
    """What a seed tries."""

    points: tuple[str, ...]
    faults: tuple[str, ...]


def plan(rng: random.Random) -> Plan:
    points, faults = rng.sample(CRASH_POINTS, POINTS_EACH), rng.sample(FAULTS, FAULTS_EACH)
    if "mishap" not in faults and rng.random() < SLIPS:
        faults[0] = "mishap"
    return Plan(tuple(points), tuple(faults))


class Steered(Faults):
    """Draws only what its plan says, deaths near faults and faults near deaths."""

    def __init__(self, plan: Plan, rates: FaultRates, rng: random.Random) -> None:
        super().__init__(rates, rng)
        self.plan = plan

    def chance(self, fault: str, point: str = "") -> float:
        if fault == "crash":
            rare = self._let_slip()
            if point not in self.plan.points or self.crashes[point] >= MOST_DEATHS + rare:
                return 0.0
            if rare:
                return EAGEREST
            return EAGER[point.rpartition("_")[2]] if self._lately(self.occurred) else self.rates.crash
        if fault not in self.plan.faults or self.struck[fault] >= MOST_FAULTS:
            return 0.0
        usual = super().chance(fault, point)
        return min(usual * WARM, 0.5) if self._lately(self.deaths) else usual

    def delay(self) -> float:
        if self.calm or "delay" not in self.plan.faults or self.struck["delay"] >= MOST_FAULTS:
            return super().delay()
        if self.rng.random() >= DELAYED:
            return super().delay()
        self.record("delay")
        return self.rng.uniform(LONG_S, LONGEST_DELAY_S)

    def _let_slip(self) -> bool:
        """Hands move seldom: what follows a slip is tried more often than what follows other faults."""
        return any(fault == "mishap" and self.now() - at <= NEAR_S for fault, at in self.occurred[-3:])

    def _lately(self, told: list[tuple[str, float]]) -> bool:
        return bool(told) and self.now() - told[-1][1] <= NEAR_S


def hits(faults: Faults) -> Counter[tuple[str, str]]:
    """How often each pair was hit."""
    times: dict[str, list[float]] = {}
    for fault, at in faults.occurred:
        times.setdefault(fault, []).append(at)
    found: Counter[tuple[str, str]] = Counter()
    for point, at in faults.deaths:
        for fault, when in times.items():
            next_one = bisect_left(when, at - NEAR_S)
            if next_one < len(when) and when[next_one] <= at + NEAR_S:
                found[point, fault] += 1
    return found
