"""One safety decision with twelve actors in the workcell.

Actors are PCRs and generated routes inside it, as many as safety lets in, and experiments that have
parked a plate between their runs: each of them has to keep its way to the waste.
"""

from __future__ import annotations

import asyncio
import random
import time

import yaml
from msgspec.structs import replace

from labos.core.decide.experiments import StartExperiment
from labos.core.ids import ExperimentId
from labos.core.model import Workcell
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.safety import Safety
from labos.planning.scheduler import Scheduler
from labos.spec import find_spec, load_workcell
from tests.benchmarks.figures import Figure, Report, median, milliseconds, percentile, scratch
from tests.benchmarks.still_lab import StillLab, random_run, still_lab
from tests.simulation.mixes import DESCRIPTIONS, PLANS

MUST_S = 0.002


def with_shelves(shelves: int) -> Workcell:
    """The RPL workcell where so many plates may be parked: the packaged one has a place for one."""
    told = yaml.safe_load(find_spec("workcells", "rpl").read_text())
    pose = told["locations"]["pf400"]["wc.parking"]
    told["stations"]["wc.parking"] = {"shelves": shelves}
    told["locations"]["pf400"]["wc.parking"] = {"first": pose, "step": [28, 0, 0, 0, 0, 0]}
    with scratch("safety") as folder:
        path = folder / "rpl.yaml"
        path.write_text(yaml.safe_dump(told))
        return load_workcell(path, DESCRIPTIONS).workcell


class TimedSafety(Safety):
    """Notes what each decision cost and how many runs were inside then."""

    def __init__(self) -> None:
        super().__init__()
        self.taken: list[tuple[int, float, bool]] = []

    def list_trapped(
        self,
        state: LabState,
        run: RunState,
        step: int,
        *,
        only_asking: bool = False,
        is_blocked: bool | None = None,
    ) -> list[str]:
        began = time.thread_time()
        trapped = super().list_trapped(state, run, step, only_asking=only_asking, is_blocked=is_blocked)
        took = time.thread_time() - began
        actors = len(self.list_actors(state, state.runs.plan_of(run).workcell))
        self.taken.append((actors + (run.status == "queued"), took, bool(trapped)))
        return trapped


def make_timed_scheduler() -> Scheduler:
    scheduler = Scheduler()
    scheduler.safety = TimedSafety()
    return scheduler


async def park(lab: StillLab, plates: int) -> None:
    """So many experiments, each with a plate that waits in the parking hotel."""
    closing = PLANS["cp_trashplate"].plan
    for number in range(plates):
        lab.tell(StartExperiment("colour picker", f"user{number % 2}", closing))
        experiment = ExperimentId(f"E{lab.state.experiments.named}")
        await lab.submit(replace(PLANS["cp_newplate"], experiment=experiment))
        while lab.list_flying():
            await lab.finish_one()


async def work(lab: StillLab, waiting: int, ends: int) -> None:
    """Let actions end; there are always so many more runs that want to come in."""
    rng = random.Random(lab.rng.random())
    for _ in range(ends):
        while len(lab.state.runs.queued) < waiting:
            await lab.submit(random_run(rng, users=2))
        if not lab.list_flying():
            break
        await lab.finish_one()
        await lab.tidy()


async def measure_all(seeds: int, wanted: int, parked: int, ends: int) -> Report:
    taken: list[tuple[int, float, bool]] = []
    searches = interleavings = 0
    cell = with_shelves(parked)
    for seed in range(seeds):
        async with still_lab(seed, plan_with=make_timed_scheduler, cell=cell) as lab:
            await park(lab, parked)
            safety = lab.kernel.scheduler.safety
            assert isinstance(safety, TimedSafety)
            safety.taken.clear()
            searches -= safety.searches
            await work(lab, 4, ends)
            taken += safety.taken
            searches += safety.searches
            interleavings += safety.interleavings
    most = max(count for count, _, _ in taken)
    full = [took for count, took, _ in taken if count >= min(wanted, most)]
    p50 = median(full)
    figure = Figure(
        f"one safety decision, {min(wanted, most)} or more actors inside, p50 (p99)",
        f"{milliseconds(p50)} ({milliseconds(percentile(full, 0.99))})",
        must=f"≤ {MUST_S * 1e3:.0f} ms",
        ok=p50 <= MUST_S,
    )
    notes = [
        f"{len(full)} of {len(taken)} decisions had so many inside (at most {most}, {parked} of them parked "
        f"plates); longest {milliseconds(max(full))}; refused {sum(trapped for _, _, trapped in taken)}",
        f"searches per decision {searches / len(taken):.2f}, with interleavings {interleavings}",
    ]
    return Report([figure], notes)


def measure(seeds: int = 5, wanted: int = 12, parked: int = 7, ends: int = 400) -> Report:
    return asyncio.run(measure_all(seeds, wanted, parked, ends))


def smoke() -> Report:
    return measure(1, 4, 2, 12)
