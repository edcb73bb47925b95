"""The campaign by hand.

python -m tests.simulation.proof --range 0:20000 --known proof.jsonl --processes 2
python -m tests.simulation.proof --seed 17 --save seed-17.jsonl
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from tests.simulation.proof.campaign import Tally, campaign, describe_failure, quiet, replay_line
from tests.simulation.proof.day import Day, live

EVERY_S = 30.0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation.proof")
    parser.add_argument("--range", default="0:200", metavar="A:B", help="seeds A to B - 1")
    parser.add_argument("--seed", type=int, help="one seed only")
    parser.add_argument("--save", type=Path, help="with --seed: keep its log")
    parser.add_argument("--known", type=Path, help="file of what is known already; goes on from there")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--stop", action="store_true", help="end with the first seed that fails")
    asked = parser.parse_args()
    quiet()
    if asked.seed is not None:
        return one(asked.seed, asked.save)
    began, printed = time.monotonic(), 0.0

    def tell(tally: Tally, day: Day) -> None:
        nonlocal printed
        if day.wrong:
            print(describe_failure(day), flush=True)
        if time.monotonic() - printed > EVERY_S:
            printed = time.monotonic()
            print(f"{printed - began:7.0f} s  seed {day.seed}: {tally.summary()}", flush=True)

    tally = campaign(seeds_of(asked.range), asked.known, asked.processes, tell, stop=asked.stop)
    print(tally.table())
    print(tally.summary())
    for day in tally.failed:
        print(f"seed {day.seed}: {replay_line(day.seed)}")
    return 1 if tally.failed else 0


def one(seed: int, save: Path | None) -> int:
    day = live(seed, save)
    print(f"seed {seed}: {day.hash} {day.counts}")
    for line in day.wrong:
        print(f"  {line}")
    return 1 if day.wrong else 0


def seeds_of(text: str) -> range:
    """``A:B`` as a range."""
    first, _, end = text.partition(":")
    return range(int(first), int(end))


if __name__ == "__main__":
    sys.exit(main())
