"""Cases of the league with durations that stray, with and without a planner: ``python -m
tests.benchmarks.league.jitter [NAME…]`` (needs the extra ``plan``)."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial

import msgspec

from labos.planner.planner import Planner
from labos.planner.solve import solve
from tests.benchmarks.figures import machine
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.play import Player

CASES = (
    "2 PCR + 1 picker × 3",
    "4 PCR + 1 picker × 5",
    "8 unlike PCR on two cyclers, seed 0",
    "one arm, 8 plates, within 120 s",
    "48 windows in chains of three, seed 0",
    "4 jobs on 4 machines, seed 0",
    "6 jobs on 4 machines, seed 0",
)
JITTER = 0.1
SEEDS = 3
HEADINGS = ("case", "durations", "online", "planner, middle", "planner, quantile 0.8")


class Mean(msgspec.Struct, frozen=True):
    """What came of a case with several seeds: seconds on average, and windows missed in all."""

    makespan_s: float
    missed: int

    def __str__(self) -> str:
        return f"{self.makespan_s:,.0f} s, {self.missed} missed"


def mean(case: Case, jitter: float, seeds: int, seconds: float, level: float | None) -> Mean:
    """Play a case, with the planner at a quantile of durations if there is one."""
    outcomes = []
    for seed in range(seeds if jitter else 1):
        planner = None
        if level is not None:
            planner = Planner(seconds=seconds, solver=partial(solve, counted=True), level=level)
        player = Player(case.cell, case.stock, jitter=jitter, seed=seed, planner=planner, together=False)
        outcomes.append(player.play(case.works))
    total = sum(outcome.makespan_s for outcome in outcomes)
    return Mean(total / len(outcomes), sum(outcome.breaches for outcome in outcomes))


def row(case: Case, jitter: float, seeds: int, seconds: float) -> tuple[str, ...]:
    told = f"± {jitter:.0%}, {seeds} seeds" if jitter else "exact"
    return (case.name, told, *(str(mean(case, jitter, seeds, seconds, level)) for level in (None, 0.5, 0.8)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.league.jitter", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="parts of names of cases")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how often each is played")
    parser.add_argument("--seconds", type=float, default=1.0, help="how long the planner may look each time")
    options = parser.parse_args(arguments)
    print("| " + " | ".join(HEADINGS) + " |\n|" + " --- |" * len(HEADINGS))
    for case in cases():
        wanted = any(name in case.name for name in options.names) if options.names else case.name in CASES
        for jitter in (0.0, JITTER) if wanted else ():
            print("| " + " | ".join(row(case, jitter, options.seeds, options.seconds)) + " |", flush=True)
    print(machine())


if __name__ == "__main__":
    main()
