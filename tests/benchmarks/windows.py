"""How many windows are breached, and how many of these could have been kept.

Whole labs in virtual time, without disk and bus: real decisions, real planning, durations as they are
declared. A breach is counted as avoidable if somebody keeps more of the run's windows by letting one run
after the other have the lab to itself (``tests/simulation/clocked.py``). With durations that stray by a
tenth, breaches are counted for comparison: then nobody can promise anything.
"""

from __future__ import annotations

import time

import msgspec

from tests.benchmarks.figures import Figure, Report, times
from tests.simulation.clocked import careless, judge

STRAY = 0.1


class Count(msgspec.Struct):
    """What became of some instances."""

    instances: int = 0
    windows: int = 0
    breached: int = 0
    avoidable: int = 0
    hit: int = 0
    plays: int = 0
    starts: int = 0
    seconds: float = 0.0


def count(seeds: range, stray: float = 0.0, *, reserved: bool = True) -> Count:
    """Carry out the instances of some seeds; ``reserved``: room is kept for windows."""
    found = Count()
    for seed in seeds:
        began = time.process_time()
        told = judge(seed, stray) if reserved else judge(seed, stray, careless)
        found.seconds += time.process_time() - began
        found.instances += 1
        found.windows += told.windows
        found.breached += len(told.breached)
        found.avoidable += len(told.avoidable)
        found.hit += bool(told.avoidable)
        found.plays += told.plays
        found.starts += told.starts
    return found


def measure(instances: int = 1000) -> Report:
    kept, without = count(range(instances)), count(range(instances), reserved=False)
    strayed = count(range(instances // 4), STRAY)
    figures = [
        Figure(
            f"windows breached that could be kept, of {kept.windows:,} in {kept.instances:,} labs",
            f"{kept.avoidable} in {kept.hit} labs",
            f"{without.avoidable} in {without.hit} labs",
            times(kept.avoidable / max(without.avoidable, 1)),
            "0",
            kept.avoidable == 0,
        ),
        Figure("windows breached in all", str(kept.breached), str(without.breached)),
    ]
    notes = [
        "limit: the same with nothing reserved and nothing rehearsed",
        f"{kept.plays / max(kept.starts, 1):.1f} rehearsals a start, "
        f"{kept.seconds / max(kept.instances, 1) * 1e3:.0f} ms of the processor a lab, "
        f"{without.seconds / max(without.instances, 1) * 1e3:.0f} ms without",
        f"durations that stray by {STRAY:.0%}: {strayed.breached} of {strayed.windows} breached, "
        f"{strayed.avoidable} of them could be kept if nothing strayed",
    ]
    return Report(figures, notes)


def smoke() -> Report:
    return measure(8)
