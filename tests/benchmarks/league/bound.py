"""How short the cases of the jitter table can be at all: ``python -m tests.benchmarks.league.bound [NAME…]``
(needs the extra ``plan``).

Somebody who knew all durations in advance could make a schedule for them. The solver shows how long the best
such schedule takes at least. Nobody who learns the durations only as steps end can be shorter. For runs with
windows, the schedule keeps all of them; ``none`` stands where no schedule can.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

from msgspec.structs import replace

from tests.benchmarks.figures import machine
from tests.benchmarks.league.best import search
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.jitter import CASES, JITTER, SEEDS
from tests.benchmarks.league.play import draw_duration
from tests.benchmarks.league.rules import problem_of
from tests.benchmarks.league.score import play_case, times_of

STEP_S = 0.5
"""Durations are rounded down to so many seconds, so the bound is a little too low, never too high."""


def find_bound(case: Case, seed: int, seconds: float) -> float:
    """No schedule for the durations of this seed is shorter (seconds). Infinite if none keeps all windows."""
    problem = problem_of(case.cell, case.works)
    tasks = [
        replace(task, duration_s=draw_duration(seed, JITTER, task.work, task.run, task.step, task.duration_s))
        for task in problem.tasks
    ]
    hint = times_of(case, play_case(case))
    return search(replace(problem, tasks=tuple(tasks)), hint, seconds, STEP_S)[1]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.league.bound", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="parts of names of cases")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="for how many seeds of durations")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to search for each seed")
    options = parser.parse_args(arguments)
    for case in cases():
        if any(name in case.name for name in options.names) if options.names else case.name in CASES:
            bounds = [find_bound(case, seed, options.seconds) for seed in range(options.seeds)]
            each = ", ".join(f"{bound:,.0f}" if math.isfinite(bound) else "none" for bound in bounds)
            finite = [bound for bound in bounds if math.isfinite(bound)]
            mean = f"on average not below {sum(finite) / len(finite):,.0f} s" if finite else "no bound"
            print(f"{case.name}: {mean} ({each})", flush=True)
    print(machine())


if __name__ == "__main__":
    main()
