"""Cases of the league with durations that stray, with and without a planner: ``python -m
tests.benchmarks.league.jitter [NAME…] [--keep FILE]`` (needs the extra ``plan``).

The lab has the settings of a new one: it looks for an order of its own. The planner's seconds are counted.
What was played is written to the file that is kept at once: a table that was interrupted goes on where it
was.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import msgspec

from labos.planner.planner import Planner
from labos.planner.solve import solve
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from tests.benchmarks.figures import machine
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.play import Player
from tests.benchmarks.league.score import END_WEIGHT

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
LEVELS = (None, 0.5, 0.8)
HEADINGS = ("case", "durations", "online", "planner, middle", "planner, quantile 0.8")


class Setting(msgspec.Struct, frozen=True):
    """What is played: a case with the durations of a seed, and a planner that looks for so many seconds each
    time at a quantile of durations (``level``; None: without a planner)."""

    case: str
    jitter: float
    seed: int
    level: float | None
    seconds: float


class Kept(msgspec.Struct, frozen=True):
    """One line of the file that is kept."""

    played: Setting
    makespan_s: float
    missed: int


class Keeper:
    """Plays cases, but for those that the file has. It does not say which planning it is of: begin a new one
    where planning has changed."""

    def __init__(self, file: Path | None, *, by_age: bool = False, together: bool = True) -> None:
        self.file, self.by_age, self.together = file, by_age, together
        lines = file.read_text().splitlines() if file is not None and file.exists() else []
        self._kept = {kept.played: kept for kept in (msgspec.json.decode(line, type=Kept) for line in lines)}

    def play(self, case: Case, setting: Setting) -> Kept:
        if setting not in self._kept:
            kept = self._kept[setting] = self._play(case, setting)
            if self.file is not None:
                with self.file.open("a") as out:
                    out.write(msgspec.json.encode(kept).decode() + "\n")
        return self._kept[setting]

    def _play(self, case: Case, setting: Setting) -> Kept:
        planner = None
        if setting.level is not None:
            planner = Planner(
                seconds=setting.seconds,
                solver=partial(solve, counted=True),
                level=setting.level,
                end_weight=END_WEIGHT,
                searches=not self.by_age,
            )
        outcome = Player(
            case.cell,
            case.stock,
            Scheduler if self.by_age else make_searching_scheduler,
            jitter=setting.jitter,
            seed=setting.seed,
            planner=planner,
            together=self.together,
        ).play(case.works)
        return Kept(setting, outcome.makespan_s, outcome.breaches)


def cell(plays: Sequence[Kept]) -> str:
    """The mean of several plays, and the windows missed in all of them."""
    mean = sum(kept.makespan_s for kept in plays) / len(plays)
    return f"{mean:,.0f} s, {sum(kept.missed for kept in plays)} missed"


def row(keeper: Keeper, case: Case, jitter: float, seeds: int, seconds: float) -> tuple[str, ...]:
    told = f"± {jitter:.0%}, {seeds} seeds" if jitter else "exact"
    plays = [
        [
            keeper.play(case, Setting(case.name, jitter, seed, level, seconds if level is not None else 0.0))
            for level in LEVELS
        ]
        for seed in range(seeds if jitter else 1)
    ]
    return (case.name, told, *map(cell, zip(*plays, strict=True)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.league.jitter", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="parts of names of cases")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how often each is played")
    parser.add_argument(
        "--seconds", type=float, default=1.0, help="how long the planner may look each time, counted"
    )
    by_age = "the lab looks for no order of its own, as with LABOS_ORDER=age"
    parser.add_argument("--by-age", action="store_true", help=by_age)
    one_by_one = "runs are submitted one after the other: the first starts before the next is known"
    parser.add_argument("--one-by-one", action="store_true", help=one_by_one)
    parser.add_argument(
        "--keep", type=Path, metavar="FILE", help="write each result there at once; play none twice"
    )
    options = parser.parse_args(arguments)
    keeper = Keeper(options.keep, by_age=options.by_age, together=not options.one_by_one)
    print("| " + " | ".join(HEADINGS) + " |\n|" + " --- |" * len(HEADINGS))
    for case in cases():
        wanted = any(name in case.name for name in options.names) if options.names else case.name in CASES
        for jitter in (0.0, JITTER) if wanted else ():
            print(
                "| " + " | ".join(row(keeper, case, jitter, options.seeds, options.seconds)) + " |",
                flush=True,
            )
    print(machine())


if __name__ == "__main__":
    main()
