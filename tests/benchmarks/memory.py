"""What a waiting run takes in memory, and what a lab with four nodes takes."""

from __future__ import annotations

import asyncio
import gc
import random
import tracemalloc

from msgspec.structs import replace

from labos.core.decide.runs import SubmitRun
from labos.spec import find_spec
from tests.benchmarks.decision import DEAD, make_blocked_run, new_run
from tests.benchmarks.figures import Figure, Report, scratch
from tests.benchmarks.processes import LabProcess, resident_mb
from tests.benchmarks.still_lab import random_run, still_lab

MUST_RUN_KB, MUST_LAB_MB = 20.0, 300.0
NODES = (("sciclops", "sciclops"), ("pf400", "pf400"), ("ot2", "ot2_cp_gamma"), ("camera", "camera_module"))


def own_plan(rng: random.Random, number: int) -> SubmitRun:
    """The worst case: every run has a plan of its own, which shares no step with another's."""
    run = new_run(rng, number, 20)
    steps = tuple(replace(step, args={**step.args, "sample": number}) for step in run.plan.steps)
    return replace(run, plan=replace(run.plan, steps=steps), payload={"sample": number})


async def per_run(runs: int, *, own_plans: bool) -> float:
    """Bytes that a run takes in the kernel while it waits: state, scheduler and all."""
    rng = random.Random(0)
    async with still_lab(0, dead=[DEAD]) as lab:
        for number in range(50):
            await lab.submit(replace(make_blocked_run(), user=f"user{number % 20}"))
        gc.collect()
        tracemalloc.start()
        try:
            before = len(lab.state.runs.queued)
            for number in range(runs):
                await lab.submit(own_plan(rng, number) if own_plans else random_run(rng))
            gc.collect()
            taken, _ = tracemalloc.get_traced_memory()
            return taken / (len(lab.state.runs.queued) - before)
        finally:
            tracemalloc.stop()


def lab_of_nodes(nodes: tuple[tuple[str, str], ...]) -> tuple[list[tuple[str, float, float]], str]:
    """(name, RSS, PSS) in MB of the kernel and of each node after a first run; what was run."""
    with scratch("memory") as folder, LabProcess(folder / "lab", "--no-nodes") as lab:
        for driver, name in nodes:
            lab.start_node(driver, name)
        with lab.client() as client:
            run = lab.submit(client, find_spec("workflows", "cp_newplate"))
            ended = client.wait(run, timeout_s=60.0)
            found = [("kernel", *resident_mb(lab.process.pid))]
            for (_, name), process in zip(nodes, lab.nodes, strict=True):
                found.append((name, *resident_mb(process.pid)))
            return found, f"cp_newplate {ended.status}"


def measure(runs: int = 10_000, nodes: tuple[tuple[str, str], ...] = NODES) -> Report:
    shared = asyncio.run(per_run(runs, own_plans=False)) / 1024
    own = asyncio.run(per_run(runs, own_plans=True)) / 1024
    found, what = lab_of_nodes(nodes)
    rss, pss = sum(rss for _, rss, _ in found), sum(pss for _, _, pss in found)
    figures = [
        Figure(
            f"memory per waiting run, {runs:,} of them",
            f"{shared:.1f} KB",
            must=f"≤ {MUST_RUN_KB:.0f} KB",
            ok=shared <= MUST_RUN_KB,
        ),
        Figure(
            "the same, no two with an equal step",
            f"{own:.1f} KB",
            must=f"≤ {MUST_RUN_KB:.0f} KB",
            ok=own <= MUST_RUN_KB,
        ),
        Figure(
            f"lab and {len(nodes)} nodes, resident",
            f"{rss:.0f} MB",
            must=f"≤ {MUST_LAB_MB:.0f} MB",
            ok=rss <= MUST_LAB_MB,
        ),
    ]
    shares = ", ".join(f"{name} {rss:.0f} ({pss:.0f})" for name, rss, pss in found)
    notes = [f"RSS (PSS) in MB after {what}: {shares}; PSS in all {pss:.0f} MB"]
    return Report(figures, notes)


def smoke() -> Report:
    return measure(30, NODES[:2])
