"""Which way round labware lies: it follows the grip and the nests, and where A1 must lie in one
corner the bench breaks if the rule is off."""

from __future__ import annotations

import pytest

from labos.core import binding
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.spec import compile_workflow, find_spec, parse_workcell, parse_workflow, validate_workflow
from labos.spec.bench import BenchFile, Stock
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import DESCRIPTIONS, NODES

CELL = parse_workcell(
    find_spec("workcells", "rpl")
    .read_text(encoding="utf-8")
    .replace(
        "stations:\n",
        "stations:\n  hidex.default: {a1: 90}\n",
        1,
    )
    .replace("camera_module.plate_station: {", "camera_module.plate_station: {rotation: 180, "),
    DESCRIPTIONS,
)
STOCK = (Stock(StationName("rpl/sciclops.tower1"), "plate96", 20),)


def carry(name: str, source: str, target: str, *grips: str) -> str:
    turned = f", source_plate_rotation: {grips[0]}, target_plate_rotation: {grips[1]}" if grips else ""
    return (
        f"- {{name: {name}, module: pf400, action: transfer, "
        f"args: {{source: {source}, target: {target}{turned}}}}}\n"
    )


GET = "- {name: get, module: sciclops, action: get_plate, args: {loc: tower1}}\n"
CAMERA, READER = "camera_module.plate_station", "hidex.default"
READ = """\
- {name: shut, module: hidex, action: close_lid}
- {name: read, module: hidex, action: run_assay, args: {assay_name: od}}
- {name: open, module: hidex, action: open_lid}
"""
AWAY = carry("away", READER, "wc.trash")
TURNED = GET + carry("in", "sciclops.exchange", READER, "narrow", "wide") + READ + AWAY
BY_CAMERA = (
    GET
    + carry("look", "sciclops.exchange", CAMERA)
    + carry("in", CAMERA, READER, "narrow", "wide")
    + READ
    + carry("out", READER, "wc.output", "wide", "narrow")
)
PARK = GET + carry("park", "sciclops.exchange", "wc.parking")
FETCH = carry("in", "wc.parking", READER) + READ + AWAY
"""A run on its own does not know how its plate was parked."""


def compile_run(text: str) -> SubmitRun:
    source = parse_workflow(f"labos: 1\nname: turn {len(text)}\nsteps:\n{text}", "turns.yaml")
    found = compile_workflow(source, {}, CELL.workcell, DESCRIPTIONS, simulate=True, bench=BenchFile(STOCK))
    return SubmitRun(found.plan, "ada")


def live_through(seed: int, jobs: list[Job], rates: FaultRates = QUIET) -> tuple[LabState, SimulatedLab]:
    stock = tuple((s.station, s.labware, s.count) for s in STOCK)
    lab = SimulatedLab(Stand(CELL.workcell, stock, NODES), seed, rates)
    lab.world.lie(READER, only=90)
    lab.world.lie(CAMERA, frame=180)
    return lab.run_for(jobs, 24 * 3600.0), lab


@pytest.mark.parametrize("rates", [QUIET, STORMY], ids=["quiet", "stormy"])
def test_the_log_knows_which_way_round_plates_lie(rates: FaultRates) -> None:
    for seed in range(3):
        jobs = [Job(f"j{n}", "ada", (compile_run(TURNED),), after_s=300.0 * n) for n in range(3)]
        state, lab = live_through(seed, jobs, rates)
        try:
            assert not state.runs.active
            assert lab.differences(state) == []
        finally:
            lab.close()


def messages(text: str) -> list[str]:
    source = parse_workflow(f"labos: 1\nname: w\nsteps:\n{text}", "turns.yaml")
    found = validate_workflow(source, {}, CELL.workcell, DESCRIPTIONS, bench=BenchFile(STOCK))
    return [finding.message for finding in found]


def test_what_would_lie_the_wrong_way_is_refused_on_paper() -> None:
    wrong = (
        "Step 'in': The labware would lie turned by {} degrees at hidex.default, which takes it turned by 90."
    )
    assert messages(TURNED) == []
    assert messages(TURNED.replace("wide", "narrow")) == [wrong.format(0)]
    there_and_back = GET + carry("look", "sciclops.exchange", CAMERA) + carry("in", CAMERA, READER)
    assert messages(there_and_back) == [wrong.format(0)]
    assert messages(BY_CAMERA) == []


def make_parked_and_read() -> list[Job]:
    return [Job("parked", "ada", (compile_run(PARK), compile_run(FETCH)), StartExperiment("turn", "ada"))]


@pytest.mark.slow
def test_what_is_known_only_then_waits_and_says_why() -> None:
    state, lab = live_through(0, make_parked_and_read())
    try:
        assert lab.world.crashes() == []
        (run,) = (*state.runs.active.values(), *state.runs.queued.values())
        found = binding.bind(state, run, state.runs.plan_of(run).steps[0])
        assert isinstance(found, Wait)
        assert (
            found.reason.sentence
            == "P1 would lie turned by 0 degrees at hidex.default, which takes it turned by 90"
        )
    finally:
        lab.close()


def test_without_the_rule_plates_are_set_crosswise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding, "check_rotation", lambda *_: None)
    _, lab = live_through(0, make_parked_and_read())
    try:
        (crash, *_) = lab.world.crashes()
        assert crash.facts["what"] == "sets a plate crosswise into its nest"
    finally:
        lab.close()
