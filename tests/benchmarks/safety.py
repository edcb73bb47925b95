"""One safety decision with twelve runs inside the workcell."""

from __future__ import annotations

import asyncio
import random
import time

from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.safety import Safety
from labos.planning.scheduler import Scheduler
from tests.benchmarks.figures import Figure, Report, median, milliseconds, percentile
from tests.benchmarks.still_lab import StillLab, random_run, still_lab

MUST_S = 0.002


class TimedSafety(Safety):
    """Notes what each decision cost and how many runs were inside then."""

    def __init__(self) -> None:
        super().__init__()
        self.taken: list[tuple[int, float, bool]] = []

    def traps(self, state: LabState, run: RunState, step: int, *, only_asking: bool = False) -> list[str]:
        began = time.perf_counter()
        trapped = super().traps(state, run, step, only_asking=only_asking)
        took = time.perf_counter() - began
        inside = len(state.runs.active) + (run.status == "queued")
        self.taken.append((inside, took, bool(trapped)))
        return trapped


def timed() -> Scheduler:
    scheduler = Scheduler()
    scheduler.safety = TimedSafety()
    return scheduler


async def work(lab: StillLab, inside: int, ends: int) -> None:
    """Keep so many runs inside or waiting, and let actions end."""
    rng = random.Random(lab.rng.random())
    for _ in range(ends):
        while len(lab.state.runs.active) + len(lab.state.runs.queued) < inside:
            await lab.submit(random_run(rng, users=2))
        if not lab.flying():
            break
        await lab.finish_one()
        await lab.tidy()


async def measure_all(seeds: int, inside: int, ends: int) -> Report:
    taken: list[tuple[int, float, bool]] = []
    searches = interleavings = most = 0
    for seed in range(seeds):
        async with still_lab(seed, plan_with=timed) as lab:
            await work(lab, inside, ends)
            safety = lab.kernel.scheduler.safety
            assert isinstance(safety, TimedSafety)
            taken += safety.taken
            searches += safety.searches
            interleavings += safety.interleavings
    most = max(count for count, _, _ in taken)
    full = [took for count, took, _ in taken if count >= min(inside, most) - 1]
    refused = sum(trapped for _, _, trapped in taken)
    p50 = median(full)
    figure = Figure(
        f"one safety decision, {inside} runs inside, p50 (p99)",
        f"{milliseconds(p50)} ({milliseconds(percentile(full, 0.99))})",
        must=f"≤ {MUST_S * 1e3:.0f} ms",
        ok=p50 <= MUST_S,
    )
    notes = [
        f"{len(full)} of {len(taken)} decisions had {min(inside, most) - 1} or more runs inside "
        f"(at most {most}); longest {milliseconds(max(full))}; refused {refused}",
        f"searches per decision {searches / len(taken):.2f}, with interleavings {interleavings}",
    ]
    return Report([figure], notes)


def measure(seeds: int = 5, inside: int = 12, ends: int = 400) -> Report:
    return asyncio.run(measure_all(seeds, inside, ends))


def smoke() -> Report:
    return measure(1, 4, 12)
