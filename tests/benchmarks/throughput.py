"""Durable actions a second with 64 in flight.

The limit is a bare loop (bare.py): the same journals, store and bus, group commit by the same writer
thread, sealed records of the same kinds, and nothing else: no rules, no plan, no fold, no checks.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

from tests.benchmarks.bare import BareLoop, bare_loop
from tests.benchmarks.figures import Figure, Report, median, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab

MUST = 0.7


async def bare_rate(loop: BareLoop, modules: int, actions: int) -> float:
    began = time.perf_counter()
    await asyncio.gather(*(loop.client(number, actions) for number in range(modules)))
    return modules * actions / (time.perf_counter() - began)


async def our_rate(lab: IdleLab, actions: int) -> float:
    wanted = lab.ends.actions + lab.modules * actions
    began = time.perf_counter()
    for module in range(lab.modules):
        lab.submit(module, actions)
    await lab.ends.until(lambda: lab.ends.actions >= wanted, 120.0)
    return lab.modules * actions / (time.perf_counter() - began)


async def measure_in(folder: Path, rounds: int, modules: int, actions: int, processes: int) -> Report:
    ratios, ours, limits, commits = [], [], [], []
    async with idle_lab(folder, modules, processes) as lab, bare_loop(folder, lab.bus) as loop:
        lab.keep_plans(actions)
        await bare_rate(loop, modules, 2)
        await our_rate(lab, 2)
        for _ in range(rounds):
            limits.append(await bare_rate(loop, modules, actions))
            lab.ends.batches.clear()
            ours.append(await our_rate(lab, actions))
            commits.append(len(lab.ends.batches) / (modules * actions))
            ratios.append(ours[-1] / limits[-1])
    ratio = median(ratios)
    figure = Figure(
        f"durable actions/s, {modules} in flight, node journals on",
        f"{median(ours):.0f}/s",
        f"{median(limits):.0f}/s (bare loop)",
        times(ratio),
        f"≥ {MUST} ×",
        ratio >= MUST,
    )
    notes = [
        f"ratios of {rounds} rounds of {modules} × {actions}: {spread(ratios)}",
        f"{processes} node process(es); commits per action {median(commits):.3f}",
    ]
    return Report([figure], notes)


def measure(rounds: int = 11, modules: int = 64, actions: int = 60, processes: int = 1) -> Report:
    with scratch("throughput") as folder:
        return asyncio.run(measure_in(folder, rounds, modules, actions, processes))


def smoke() -> Report:
    return measure(1, 3, 2)
