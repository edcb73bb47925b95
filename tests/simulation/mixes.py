"""Mixes of work for the simulated lab: PCR, colour picker, generated workflows."""

from __future__ import annotations

import random
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from msgspec.structs import replace

from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.model import Description
from labos.node.node import Node
from labos.spec import compile_workflow, find_spec, load_workcell, parse_workflow
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


FILES: list[bytes] = []
"""What the workflows pin: blobs of a lab that runs them."""


def plan(name: str) -> SubmitRun:
    """A run of one of LabOS' own workflows."""
    compiled = compile_workflow(
        find_spec("workflows", name),
        PAYLOADS[name],
        CELL.workcell,
        DESCRIPTIONS,
        simulate=True,
        bench=CELL.bench,
    )
    FILES.extend(compiled.files.values())
    return SubmitRun(compiled.plan, "nobody", PAYLOADS[name])


PLANS = {name: plan(name) for name in PAYLOADS}


def pcr(name: str, user: str, after_s: float = 0.0) -> Job:
    return Job(name, user, (replace(PLANS["pcr"], user=user),), after_s=after_s)


def colour_picker(name: str, user: str, mixes: int = 3, after_s: float = 0.0) -> Job:
    names = ["cp_newplate", *["cp_mixcolor"] * mixes, "cp_trashplate"]
    runs = tuple(replace(PLANS[workflow], user=user) for workflow in names)
    closing = PLANS["cp_trashplate"].plan
    return Job(name, user, runs, StartExperiment("colour picker", user, closing), after_s=after_s)


def on(module: str, action: str, args: str = "") -> str:
    """A step of a generated workflow."""
    return f"  - {{module: {module}, action: {action}{f', args: {{{args}}}' if args else ''}}}"


PLACES = {
    "ot2_pcr_alpha.deck1_cooler": on("ot2_pcr_alpha", "run_protocol", "config_path: p.yaml"),
    "ot2_growth_beta.deck2": on("ot2_growth_beta", "run_protocol", "config_path: p.yaml"),
    "ot2_cp_gamma.deck2": on("ot2_cp_gamma", "run_protocol", "config_path: p.yaml"),
    "sealer.default": on("sealer", "seal", "time: 3.0, temperature: 175"),
    "peeler.default": on("peeler", "peel"),
    "camera_module.plate_station": on("camera_module", "take_picture", "file_name: a.jpg"),
    "biometra.default": "\n".join(
        (
            on("biometra", "close_lid"),
            on("biometra", "run_program", "program_n: 3"),
            on("biometra", "open_lid"),
        )
    ),
    "hidex.default": "",
}


@cache
def route(seed: int) -> SubmitRun:
    """A generated workflow: a plate's way over three to seven stations, some of them twice."""
    rng = random.Random(f"route/{seed}")
    place, sealed = "sciclops.exchange", False
    lines = [
        f"name: route {seed}",
        "flowdef:",
        "  - {module: sciclops, action: get_plate, args: {loc: tower1}}",
    ]
    for _ in range(rng.randint(3, 7)):
        choices = [p for p in PLACES if p != place and not (sealed and "ot2" in p)]
        choices = [p for p in choices if p != ("sealer.default" if sealed else "peeler.default")]
        target = rng.choice(choices)
        lines.append(f"  - {{module: pf400, action: transfer, args: {{source: {place}, target: {target}}}}}")
        if PLACES[target]:
            lines.append(PLACES[target])
        sealed = target == "sealer.default" or (sealed and target != "peeler.default")
        place = target
    end = rng.choice(["wc.trash", "wc.output"])
    lines.append(f"  - {{module: pf400, action: transfer, args: {{source: {place}, target: {end}}}}}")
    named = [line.replace("- {", f"- {{name: s{i}, ") for i, line in enumerate("\n".join(lines).split("\n"))]
    source = parse_workflow("\n".join(named), f"route{seed}.yaml")
    compiled = compile_workflow(source, {}, CELL.workcell, DESCRIPTIONS, simulate=True, bench=CELL.bench)
    return SubmitRun(compiled.plan, "nobody")


def make_generated(name: str, user: str, seed: int, after_s: float = 0.0) -> Job:
    return Job(name, user, (replace(route(seed), user=user),), after_s=after_s)


def identical(count: int) -> list[Job]:
    """So many PCRs at once."""
    return [pcr(f"j{number}", "ada") for number in range(count)]


@cache
def make_timed(number: int, on_breach: str = "continue", within: str = "4 min") -> SubmitRun:
    """A plate is dosed on a liquid handler and has to be read soon after."""
    handler = ["ot2_pcr_alpha", "ot2_growth_beta", "ot2_cp_gamma"][number % 3]
    place = f"{handler}.deck1_cooler" if handler == "ot2_pcr_alpha" else f"{handler}.deck2"
    window = f"within: {{after: Dose, at_most: {within}, on_breach: {on_breach}}}"
    text = f"""
labos: 1
name: timed on {handler}, {on_breach}
steps:
  - {{name: Get, module: sciclops, action: get_plate, args: {{loc: tower1}}}}
  - {{name: In, module: pf400, action: transfer, args: {{source: sciclops.exchange, target: {place}}}}}
  - {{name: Dose, module: {handler}, action: run_protocol, args: {{config_path: p.yaml}}}}
  - {{name: Over, module: pf400, action: transfer, args: {{source: {place}, target: hidex.default}}}}
  - {{name: Shut, module: hidex, action: close_lid}}
  - {{name: Read, module: hidex, action: run_assay, args: {{assay_name: od}}, {window}}}
  - {{name: Open, module: hidex, action: open_lid}}
  - {{name: Away, module: pf400, action: transfer, args: {{source: hidex.default, target: wc.trash}}}}
"""
    return compile_text(text)


@cache
def make_slow_reading() -> SubmitRun:
    """A plate that is read twice in no hurry: it keeps the reader for more than ten minutes."""
    return compile_text("""
labos: 1
name: reading
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - {name: In, module: pf400, action: transfer, args: {source: sciclops.exchange, target: hidex.default}}
  - {name: Shut, module: hidex, action: close_lid}
  - {name: Read, module: hidex, action: run_assay, args: {assay_name: od}}
  - {name: Again, module: hidex, action: run_assay, args: {assay_name: od}}
  - {name: Open, module: hidex, action: open_lid}
  - {name: Away, module: pf400, action: transfer, args: {source: hidex.default, target: wc.trash}}
""")


def compile_text(text: str) -> SubmitRun:
    source = parse_workflow(text, "mix.yaml")
    compiled = compile_workflow(source, {}, CELL.workcell, DESCRIPTIONS, simulate=True, bench=CELL.bench)
    return SubmitRun(compiled.plan, "nobody")


def make_hurried(seed: int, on_breach: str = "continue") -> list[Job]:
    """Plates that have to be read in time, among others that use the same reader and arm."""
    rng = random.Random(f"hurried/{seed}")
    jobs: list[Job] = []
    for number in range(rng.randint(8, 12)):
        user, after = rng.choice(["ada", "bo"]), rng.uniform(0, 3600)
        kind = rng.random()
        name = f"j{number}"
        if kind < 0.4:
            run = make_timed(rng.randrange(3), on_breach)
        elif kind < 0.8:
            run = make_slow_reading()
        else:
            run = route(rng.randrange(40))
        jobs.append(Job(name, user, (replace(run, user=user),), after_s=after))
    return jobs


def make_dosed_and_read(name: str, user: str, after_s: float = 0.0) -> Job:
    """An experiment whose second run has to read in time what its first one dosed."""
    dose = compile_text("""
labos: 1
name: dose
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - {name: In, module: pf400, action: transfer, args: {source: sciclops.exchange, target: ot2_cp_gamma.deck2}}
  - {name: Dose, module: ot2_cp_gamma, action: run_protocol, args: {config_path: p.yaml}}
""")
    read = compile_text("""
labos: 1
name: read
steps:
  - name: Over
    module: pf400
    action: transfer
    args: {source: ot2_cp_gamma.deck2, target: hidex.default}
    wait: {of: dose, after: Dose, at_least: 20 min}
  - {name: Shut, module: hidex, action: close_lid}
  - name: Read
    module: hidex
    action: run_assay
    args: {assay_name: od}
    within: {of: dose, after: Dose, at_most: 24 min}
  - {name: Open, module: hidex, action: open_lid}
  - {name: Away, module: pf400, action: transfer, args: {source: hidex.default, target: wc.trash}}
""")
    runs = tuple(replace(run, user=user) for run in (dose, read))
    return Job(name, user, runs, StartExperiment("dose and read", user), after_s=after_s)


def mix(seed: int, largest: int = 12) -> list[Job]:
    """Between 2 and ``largest`` jobs of two users, submitted over the first hour."""
    rng = random.Random(f"mix/{seed}")
    jobs: list[Job] = []
    for number in range(rng.randint(2, largest)):
        user = rng.choice(["ada", "bo"])
        after = rng.uniform(0, 3600)
        kind = rng.random()
        if kind < 0.4:
            jobs.append(pcr(f"j{number}", user, after))
        elif kind < 0.75:
            jobs.append(make_generated(f"j{number}", user, rng.randrange(40), after))
        else:
            jobs.append(colour_picker(f"j{number}", user, rng.randint(1, 3), after))
    return jobs
