"""Many seeds, one after the other or in several processes: what was found, and which pairs were hit.

What is known goes to a file, one line a seed; a campaign that is started again with the same file goes on
where it was.
"""

from __future__ import annotations

import logging
import multiprocessing
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import msgspec
import structlog

from tests.simulation.proof.day import Day, live
from tests.simulation.proof.steering import PAIRS

ENOUGH = 20
"""How often each pair has to be hit."""


class Tally:
    """What a campaign has seen so far."""

    def __init__(self) -> None:
        self.seeds = 0
        self.took_s = 0.0
        """In real time, without what was known already."""
        self.hits: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self.failed: list[Day] = []

    def add(self, day: Day) -> None:
        self.seeds += 1
        self.hits.update(day.hits)
        self.counts.update(day.counts)
        if day.wrong:
            self.failed.append(day)

    def least(self) -> int:
        """How often the pair was hit that was hit least often."""
        return min(self.hits[f"{point} × {fault}"] for point, fault in PAIRS)

    def table(self) -> str:
        """Hits of each pair: a line for each crash point, a column for each fault."""
        points, faults = dict.fromkeys(p for p, _ in PAIRS), dict.fromkeys(f for _, f in PAIRS)
        lines = [f"{'':24}" + "".join(f"{fault:>14}" for fault in faults)]
        for point in points:
            numbers = "".join(f"{self.hits[f'{point} × {fault}']:>14}" for fault in faults)
            lines.append(f"{point:24}{numbers}")
        return "\n".join(lines)

    def summary(self) -> str:
        told = ", ".join(f"{count} {name}" for name, count in sorted(self.counts.items()))
        return (
            f"{self.seeds} seeds in {self.took_s:.1f} s, {len(self.failed)} failed, "
            f"least pair {self.least()} hits; {told}"
        )


def replay_line(seed: int) -> str:
    """The one line that replays a seed."""
    log = f"seed-{seed}.jsonl"
    return f"python -m tests.simulation.proof --seed {seed} --save {log} && labos replay {log}"


def describe_failure(day: Day) -> str:
    """What to print of a seed that failed."""
    return "\n".join(
        [f"seed {day.seed} fails: {replay_line(day.seed)}", *(f"  {line}" for line in day.wrong)]
    )


def quiet() -> None:
    """Kernels and nodes of bad days have much to say."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))


def through(seeds: Iterable[int], processes: int = 1) -> Iterator[Day]:
    """Live through seeds, in whatever order they end."""
    if processes == 1:
        yield from map(live, seeds)
        return
    with multiprocessing.get_context("spawn").Pool(processes, quiet) as pool:
        yield from pool.imap_unordered(live, seeds, chunksize=8)


def campaign(
    seeds: range,
    known: Path | None,
    processes: int,
    tell: Callable[[Tally, Day], None],
    *,
    stop: bool = False,
) -> Tally:
    """All seeds that ``known`` does not hold yet; what it holds counts. With ``stop`` the first that
    fails is the last."""
    tally, done = Tally(), set[int]()
    if known is not None and known.exists():
        for line in known.read_bytes().splitlines():
            day = msgspec.json.decode(line, type=Day)
            if day.seed in seeds and day.seed not in done:
                done.add(day.seed)
                tally.add(day)
    began = time.monotonic()
    for day in through((seed for seed in seeds if seed not in done), processes):
        tally.add(day)
        tally.took_s = time.monotonic() - began
        if known is not None:
            with known.open("ab") as file:
                file.write(msgspec.json.encode(day) + b"\n")
        tell(tally, day)
        if stop and day.wrong:
            break
    return tally
