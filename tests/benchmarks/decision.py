"""What a completed step costs to decide upon, with few and with many runs waiting.

A turn of the real kernel over a log in memory: the result is decided and folded, planning proposes
what may start now, each start is decided, folded and sealed, and the invariants are checked. The
oldest waiting runs need a module that is dead.
"""

from __future__ import annotations

import asyncio
import gc
import random
from collections.abc import Sequence

import msgspec
from msgspec.structs import replace

from labos.core.decide.runs import SubmitRun
from tests.benchmarks.figures import Figure, Report, median, microseconds, percentile, spread, times
from tests.benchmarks.still_lab import StillLab, random_run, still_lab, workflow

MUST = 1.5
FEW, MANY = 10, 10_000
DEAD = "hidex"
BLOCKED = 5


class Work(msgspec.Struct):
    """What was measured with one length of the queue."""

    turns: list[float] = []
    events: int = 0
    evaluations: int = 0
    refusals: int = 0
    active: int = 0
    classes: int = 0


def make_blocked_run() -> SubmitRun:
    """A generated route that needs the dead module."""
    for number in range(1, 40):
        run = workflow(number)
        if any(
            step.module.endswith(f"/{DEAD}") or f"{DEAD}." in str(step.effects) for step in run.plan.steps
        ):
            return run
    raise AssertionError(f"no route needs {DEAD}")


def new_run(rng: random.Random, number: int, users: int) -> SubmitRun:
    """A run with a payload of its own; a different payload is a different plan of the same shape."""
    run = random_run(rng, users)
    first = run.plan.steps[0]
    steps = (replace(first, args={**first.args, "note": f"sample {number % 500}"}), *run.plan.steps[1:])
    return replace(run, plan=replace(run.plan, steps=steps), payload={"sample": number})


async def fill(lab: StillLab, rng: random.Random, queued: int, users: int) -> None:
    number = 0
    while len(lab.state.runs.queued) < queued:
        number += 1
        await lab.submit(new_run(rng, lab.state.runs.named, users))


async def turns(lab: StillLab, rng: random.Random, queued: int, users: int, count: int, work: Work) -> None:
    """Let so many steps complete; the queue is kept at its length in between."""
    state, scheduler = lab.state, lab.kernel.scheduler
    for _ in range(count):
        events, evaluations = state.position, scheduler.evaluations
        refusals = scheduler.refusals
        work.turns.append(await lab.finish_one())
        work.events += state.position - events
        work.evaluations += scheduler.evaluations - evaluations
        work.refusals += scheduler.refusals - refusals
        work.active += len(state.runs.active)
        await lab.tidy()
        await fill(lab, rng, queued, users)
    work.classes = len(state.runs.queue)


async def measure_all(sizes: Sequence[int], rounds: int, count: int, users: int) -> list[Work]:
    """Rounds of turns in labs that differ in nothing but the length of their queues."""
    works = [Work() for _ in sizes]
    for seed in range(rounds):
        for size, work in zip(sizes, works, strict=True):
            rng = random.Random(f"decision/{seed}")
            async with still_lab(seed, dead=[DEAD]) as lab:
                for _ in range(BLOCKED):
                    await lab.submit(replace(make_blocked_run(), user=f"user{rng.randrange(users)}"))
                await fill(lab, rng, size, users)
                warm = Work()
                await turns(lab, rng, size, users, count // 4, warm)
                gc.collect()
                gc.freeze()
                await turns(lab, rng, size, users, count, work)
                gc.unfreeze()
    return works


def measure(few: int = FEW, many: int = MANY, rounds: int = 3, count: int = 400, users: int = 20) -> Report:
    short, long = asyncio.run(measure_all((few, many), rounds, count, users))
    per_round = [
        median(long.turns[at : at + count]) / median(short.turns[at : at + count])
        for at in range(0, rounds * count, count)
    ]
    ratio = median(per_round)
    figure = Figure(
        f"decision after a completed step, {few:,} and {many:,} runs waiting, p50",
        microseconds(median(long.turns)),
        microseconds(median(short.turns)),
        times(ratio),
        f"≤ {MUST} ×",
        ratio <= MUST,
    )
    means = [sum(work.turns) / len(work.turns) for work in (short, long)]
    mean = Figure(
        "the same, mean",
        microseconds(means[1]),
        microseconds(means[0]),
        times(means[1] / means[0]),
        f"≤ {MUST} ×",
        means[1] <= MUST * means[0],
    )
    counted = Figure(
        "evaluations per event",
        f"{long.evaluations / long.events:.2f}",
        f"{short.evaluations / short.events:.2f}",
        times((long.evaluations / long.events) / max(short.evaluations / short.events, 1e-9)),
    )
    notes = [f"ratios of {rounds} rounds of {count} turns: {spread(per_round)}"]
    for name, work in ((few, short), (many, long)):
        count = len(work.turns)
        notes.append(
            f"{name:,} waiting: p99 {microseconds(percentile(work.turns, 0.99))}; {work.classes} classes, "
            f"{work.active / count:.1f} runs inside, {work.events / count:.1f} events and "
            f"{work.evaluations / count:.1f} evaluations per turn, {work.refusals} refusals"
        )
    return Report([figure, mean, counted], notes)


def smoke() -> Report:
    return measure(3, 30, 1, 8)
