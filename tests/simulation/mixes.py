"""Mixes of work for the simulated lab: PCR, colour picker, generated workflows."""

from __future__ import annotations

import random
from importlib.metadata import entry_points
from typing import Any

from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.model import Description
from labos.node.node import Node
from labos.spec import compile_workflow, find_spec, load_workcell
from labos.testing.lab import Job, Stand

NODES: dict[str, type[Node]] = {e.name: e.load() for e in entry_points(group="labos.drivers")}
DESCRIPTIONS: dict[str, Description] = {name: node.describe() for name, node in NODES.items()}

PAYLOADS: dict[str, dict[str, Any]] = {
    "pcr": {"seal": {"time": 3.0}},
    "cp_newplate": {},
    "cp_mixcolor": {
        "color_A_volumes": [10.0, 20.0],
        "color_B_volumes": [30.0, 5.0],
        "color_C_volumes": [7.0, 7.0],
        "destination_wells": ["A1", "A2"],
        "use_existing_resources": False,
    },
    "cp_trashplate": {},
}

CELL = load_workcell(find_spec("workcells", "rpl"), DESCRIPTIONS)


def stand() -> Stand:
    """The RPL workcell."""
    stock = tuple((s.station, s.labware, s.count) for s in CELL.bench.stock)
    return Stand(CELL.workcell, stock, NODES)


def plan(name: str) -> SubmitRun:
    """A run of one of LabOS' own workflows."""
    compiled = compile_workflow(
        find_spec("workflows", name), PAYLOADS[name], CELL.workcell, DESCRIPTIONS, simulate=True, bench=CELL.bench
    )
    return SubmitRun(compiled.plan, "nobody", PAYLOADS[name])


PLANS = {name: plan(name) for name in PAYLOADS}


def pcr(name: str, user: str, after_s: float = 0.0) -> Job:
    from msgspec.structs import replace

    return Job(name, user, (replace(PLANS["pcr"], user=user),), after_s=after_s)


def colour_picker(name: str, user: str, mixes: int = 3, after_s: float = 0.0) -> Job:
    from msgspec.structs import replace

    names = ["cp_newplate", *["cp_mixcolor"] * mixes, "cp_trashplate"]
    runs = tuple(replace(PLANS[workflow], user=user) for workflow in names)
    closing = PLANS["cp_trashplate"].plan
    return Job(name, user, runs, StartExperiment("colour picker", user, closing), after_s=after_s)


def mix(seed: int, largest: int = 12) -> list[Job]:
    """Between 2 and ``largest`` jobs of two users, submitted over the first hour."""
    rng = random.Random(f"mix/{seed}")
    jobs: list[Job] = []
    for number in range(rng.randint(2, largest)):
        user = rng.choice(["ada", "bo"])
        after = rng.uniform(0, 3600)
        if rng.random() < 0.6:
            jobs.append(pcr(f"j{number}", user, after))
        else:
            jobs.append(colour_picker(f"j{number}", user, rng.randint(1, 3), after))
    return jobs
