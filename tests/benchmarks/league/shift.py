"""A virtual shift of eight hours in the RPL workcell, with and without a planner: ``python -m
tests.benchmarks.league.shift`` (needs the extra ``plan``).

Three people submit PCR, colour picker and growth assays as the day goes on; a plate of growth has to be read
soon after it was pipetted. In the middle of the day somebody comes with an urgent PCR. Durations stray. The
lab has the settings of a new one: it looks for an order of its own.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Iterator, Sequence
from functools import partial
from statistics import mean, median

import msgspec
from msgspec.structs import replace

from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.ids import RunId, StationName
from labos.planner.planner import Planner
from labos.planner.solve import solve
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.spec import compile_workflow, parse_workflow
from tests.benchmarks.figures import machine
from tests.benchmarks.league.cases import RPL_STOCK, with_durations
from tests.benchmarks.league.play import Outcome, Player, Work
from tests.simulation.mixes import CELL, DESCRIPTIONS, PLANS

HOUR_S = 3600.0
SHIFT_S = 8 * HOUR_S
JITTER = 0.1
SEEDS = 3
URGENT = 10

GROWTH = """
labos: 1
name: growth
steps:
  - {name: Get plate, module: sciclops, action: get_plate, args: {loc: tower3}}
  - {name: To OT-2, module: pf400, action: transfer, args: {source: sciclops.exchange, target: ot2_growth_beta.deck2}}
  - {name: Pipette, module: ot2_growth_beta, action: run_protocol, args: {protocol: growth.py}}
  - {name: Open reader, module: hidex, action: open_lid}
  - {name: To reader, module: pf400, action: transfer, args: {source: ot2_growth_beta.deck2, target: hidex.default}}
  - {name: Close reader, module: hidex, action: close_lid}
  - name: Read
    module: hidex
    action: read_plate
    args: {assay_name: growth}
    within: {after: Pipette, at_most: 150}
  - {name: Open again, module: hidex, action: open_lid}
  - {name: To waste, module: pf400, action: transfer, args: {source: hidex.default, target: wc.trash}}
"""  # noqa: E501


class Result(msgspec.Struct, frozen=True):
    """What came of a shift: runs that ended in it, how long runs waited for their first step (the middle and
    the mean of all, and the urgent one), the mean time from a run's submission to its end, when the last one
    ended (all in seconds), and windows missed."""

    ended: int
    runs: int
    waited_s: float
    mean_waited_s: float
    urgent_s: float
    mean_took_s: float
    over_s: float
    missed: int


def growth() -> SubmitRun:
    parsed = parse_workflow(GROWTH, "growth.yaml")
    found = compile_workflow(parsed, {}, CELL.workcell, DESCRIPTIONS, bench=CELL.bench, simulate=True)
    return with_durations(SubmitRun(found.plan, "cy"), {"Pipette": 420.0, "Read": 300.0})


def works(seed: int) -> list[Work]:
    """Who comes when."""
    rng = random.Random(f"shift/{seed}")
    pcr = with_durations(replace(PLANS["pcr"], user="ada"), {"Cycle": 1800.0, "Mix reactions": 600.0})
    found: list[Work] = []
    for burst in range(4):  # PCR come in threes
        at = HOUR_S * (1.6 * burst + rng.uniform(0.0, 0.5))
        found += [Work((pcr,), after_s=at + 60.0 * number) for number in range(3)]
    start = StartExperiment("colour picker", "bo", PLANS["cp_trashplate"].plan)
    for number in range(4):  # a well holds seven mixes
        names = ["cp_newplate", *["cp_mixcolor"] * rng.randint(4, 7), "cp_trashplate"]
        runs = tuple(replace(PLANS[name], user="bo") for name in names)
        found.append(Work(runs, start, HOUR_S * (1.5 * number + rng.uniform(0.0, 0.5))))
    plate = growth()
    found += [Work((plate,), after_s=HOUR_S * rng.uniform(0.0, 6.5)) for _ in range(20)]
    urgent = replace(pcr, user="dee", priority=URGENT)
    return [*found, Work((urgent,), after_s=HOUR_S * 3.7)]


def play(seed: int, seconds: float, *, by_age: bool = False) -> Result:
    """Play a shift with a planner that may look for so many seconds each time, counted by work done; without
    one if that is 0. With ``by_age``, the lab looks for no order of its own."""
    done = works(seed)
    planned = None
    if seconds:
        planned = Planner(seconds=seconds, solver=partial(solve, counted=True), searches=not by_age)
    outcome = Player(
        CELL.workcell,
        {**RPL_STOCK, StationName("rpl/sciclops.tower3"): ("plate96", 20)},
        Scheduler if by_age else make_searching_scheduler,
        jitter=JITTER,
        seed=seed,
        planner=planned,
        together=False,
    ).play(done)
    submitted = dict(_list_submitted(outcome, done))
    ends = _ends(outcome)
    waits = {run: start - submitted[run] for run, start in _find_starts(outcome).items()}
    urgent = next(run for run, (work, _) in outcome.works.items() if work == len(done) - 1)
    return Result(
        sum(end <= SHIFT_S for end in ends.values()),
        len(ends),
        median(waits.values()),
        mean(waits.values()),
        waits[urgent],
        mean(ends[run] - at for run, at in submitted.items()),
        max(ends.values()),
        outcome.breaches,
    )


def _ends(outcome: Outcome) -> dict[RunId, float]:
    ends: dict[RunId, float] = {}
    for step in outcome.steps:
        ends[step.run] = max(ends.get(step.run, 0.0), step.end_s)
    return ends


def _find_starts(outcome: Outcome) -> dict[RunId, float]:
    starts: dict[RunId, float] = {}
    for step in outcome.steps:
        starts[step.run] = min(starts.get(step.run, step.start_s), step.start_s)
    return starts


def _list_submitted(outcome: Outcome, done: Sequence[Work]) -> Iterator[tuple[RunId, float]]:
    """When each run was submitted."""
    ends, names = _ends(outcome), {place: run for run, place in outcome.works.items()}
    for (work, index), run in names.items():
        yield run, ends[names[work, index - 1]] if index else done[work].after_s


HEADINGS = (
    "seed",
    "",
    "ended in 8 h",
    "wait, median",
    "wait, mean",
    "urgent waited",
    "submission to end, mean",
    "all over after",
    "windows missed",
)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.league.shift", description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how many shifts are played")
    parser.add_argument("--seconds", type=float, default=1.0, help="how long the planner may look each time")
    by_age = "the lab looks for no order of its own, as with LABOS_ORDER=age"
    parser.add_argument("--by-age", action="store_true", help=by_age)
    options = parser.parse_args(arguments)
    print("| " + " | ".join(HEADINGS) + " |\n|" + " --- |" * len(HEADINGS))
    for seed in range(options.seeds):
        for seconds in (0.0, options.seconds):
            r = play(seed, seconds, by_age=options.by_age)
            cells = (
                str(seed),
                "planner" if seconds else "online",
                f"{r.ended} of {r.runs}",
                f"{r.waited_s:,.0f} s",
                f"{r.mean_waited_s:,.0f} s",
                f"{r.urgent_s:,.0f} s",
                f"{r.mean_took_s:,.0f} s",
                f"{r.over_s:,.0f} s",
                str(r.missed),
            )
            print("| " + " | ".join(cells) + " |", flush=True)
    print(machine())


if __name__ == "__main__":
    main()
