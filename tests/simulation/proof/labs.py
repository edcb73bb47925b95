"""Small labs: a few modules of the RPL workcell, and one to three runs over them."""

from __future__ import annotations

import random
from functools import cache

from labos.core.decide.runs import SubmitRun
from labos.testing.lab import Job, Meddle, make_cancellers
from tests.simulation.corners import Corner

TOP = """
labos: 1
name: cell
modules:
  - {name: stacker, model: sciclops}
  - {name: pf400, model: pf400}
"""

MORE = {
    "sealing": """
  - {name: sealer, model: A4S_sealer}
  - {name: peeler, model: brooks_xpeel}
""",
    "dosing": """
  - {name: sealer, model: A4S_sealer}
  - {name: ot2, model: ot2}
""",
    "cycling": """
  - {name: cycler, model: biometra}
""",
    "watched": """
  - {name: sealer, model: A4S_sealer}
  - {name: eye, model: camera}
""",
}

STATIONS = """
stations:
  wc.output: {kind: hotel, capacity: 10}
  wc.bench: {}
  wc.trash: {kind: waste, capacity: 10}
"""

WATCHED = """
stations:
  stacker.exchange: {observer: eye}
  stacker.tower1: {observer: eye}
  sealer.default: {observer: eye}
  wc.bench: {observer: eye}
  wc.output: {kind: hotel, capacity: 10, observer: eye}
"""

STOCK = """
stock:
  stacker.tower1: {plate96: 6}
"""

STOPS = {
    "sealing": {"sealer.default": ["sealer.seal time=3.0 temperature=175"], "wc.bench": []},
    "dosing": {
        "ot2.deck1": ["ot2.run_protocol config_path=p.yaml"],
        "sealer.default": ["sealer.seal time=3.0 temperature=175"],
        "wc.bench": [],
    },
    "cycling": {
        "cycler.default": ["cycler.close_lid", "cycler.run_program program_n=3", "cycler.open_lid"],
        "wc.bench": [],
    },
    "watched": {"sealer.default": ["sealer.seal time=3.0 temperature=175"], "wc.bench": []},
}
"""Where plates go, and what is done to them there."""

ROUTES = 6
"""How many routes each workcell has."""


@cache
def cell(kind: str) -> Corner:
    """One of four workcells; only in ``watched`` does somebody look after each motion."""
    stations = WATCHED if kind == "watched" else STATIONS
    return Corner(TOP + MORE[kind].lstrip("\n") + stations.lstrip("\n") + STOCK.lstrip("\n"))


@cache
def route(kind: str, number: int) -> SubmitRun:
    """A plate out of the tower, to one or two stations, and away."""
    rng = random.Random(f"proof/{kind}/{number}")
    steps, place = ["stacker.get_plate loc=tower1"], "stacker.exchange"
    stops = list(STOPS[kind])
    rng.shuffle(stops)
    for stop in stops[: rng.randint(1, 2)]:
        steps += [f"pf400.transfer source={place} target={stop}", *STOPS[kind][stop]]
        place = stop
    away = ["wc.output"] if kind == "watched" else ["wc.output", "wc.trash"]
    steps.append(f"pf400.transfer source={place} target={rng.choice(away)}")
    # Who is cancelled with its plate under a lid leaves it open for the others.
    way_out = ["cycler.open_lid"] if kind == "cycling" else []
    return cell(kind).run(f"{kind} {number}", *steps, on_cancel=way_out)


def jobs(rng: random.Random, kind: str) -> list[Job]:
    """One to three runs, submitted within a minute."""
    count = rng.choice((2, 3) if kind == "watched" else (1, 1, 2, 2, 3))
    runs = [route(kind, rng.randrange(ROUTES)) for _ in range(count)]
    return [Job(f"j{n}", run.user, (run,), after_s=rng.uniform(0, 60)) for n, run in enumerate(runs)]


def meddles(rng: random.Random, work: list[Job]) -> list[Meddle]:
    """Now and then somebody cancels a run when one of its steps has begun."""
    chosen = [job for job in work if rng.random() < 0.25]
    return make_cancellers({f"{job.name}/0": rng.randrange(len(job.runs[0].plan.steps)) for job in chosen})
