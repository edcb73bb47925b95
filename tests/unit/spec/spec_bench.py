"""Small descriptions of instruments, and helpers, for the tests of labos.spec."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labos.core.effects import Consumes, Move, Needs, Requires, Sets, Take
from labos.core.ids import StationName
from labos.core.model import ActionSpec, Arg, Description, Station
from labos.spec import Compiled, Finding, compile_workflow, parse_workcell, parse_workflow, validate_workflow

PAPER = Path(__file__).parent / "paper"

S = StationName


def _sees(*, grip: bool = True) -> tuple[Arg, ...]:
    places = (Arg("source", "station"), Arg("target", "station"))
    grips = ("source_plate_rotation", "target_plate_rotation")
    choices = ("", "narrow", "wide")
    return (*places, *(Arg(name, "str", False, "", choices=choices) for name in grips)) if grip else places


def _volumes(name: str) -> Arg:
    return Arg(name, "list", required=False, unit="µL")


def _simple(driver: str, *models: str, **more: Any) -> Description:
    return Description(driver, "1", driver, models=models, **more)


DESCRIPTIONS: dict[str, Description] = {
    d.driver: d
    for d in (
        _simple(
            "sealer",
            "A4S_sealer",
            actions=(
                ActionSpec(
                    "seal",
                    args=(
                        Arg("time", "float", False, 3.0, ("seal_time",), "s", 0.5, 999.9),
                        Arg("temperature", "int", False, 175, unit="°C", minimum=50, maximum=200),
                    ),
                    effects=(
                        Needs(),
                        Requires("labware", "sealed", False),
                        Sets("labware", "sealed", True),
                        Consumes("foil", 1),
                    ),
                ),
            ),
            stations=(Station("default", aliases=("nest",)),),
            levels={"foil": 1000},
        ),
        _simple(
            "peeler",
            "brooks_xpeel",
            actions=(
                ActionSpec(
                    "peel",
                    effects=(Needs(), Requires("labware", "sealed", True), Sets("labware", "sealed", False)),
                ),
            ),
            stations=(Station("default"),),
        ),
        _simple(
            "arm",
            "pf400",
            manipulator=True,
            actions=(
                ActionSpec(
                    "transfer",
                    args=_sees(),
                    effects=(
                        Move(
                            S("{source}"), S("{target}"), "{source_plate_rotation}", "{target_plate_rotation}"
                        ),
                    ),
                    aliases=("move",),
                ),
            ),
            stations=(Station("gripper", "gripper"),),
        ),
        _simple(
            "stacker",
            "sciclops",
            manipulator=True,
            actions=(
                ActionSpec(
                    "get_plate",
                    args=(
                        Arg("loc", "station", aliases=("pos",)),
                        Arg("target", "station", False, "exchange"),
                    ),
                    effects=(Take(S("{loc}"), S("{target}")),),
                ),
            ),
            stations=(
                Station("tower1", "stack", 20),
                Station("tower2", "stack", 20),
                Station("exchange", "exchange"),
            ),
        ),
        _simple(
            "handler",
            "ot2",
            actions=(
                ActionSpec(
                    "run_protocol",
                    args=(
                        Arg("config_path", "file"),
                        Arg("use_existing_resources", "bool", False, False),
                        *(_volumes(f"color_{color}_volumes") for color in "ABC"),
                        Arg("destination_wells", "list", required=False),
                    ),
                    effects=(Needs(), Requires("labware", "sealed", False)),
                ),
            ),
            stations=(
                *(Station(f"deck{n}", "deck") for n in range(1, 12)),
                Station("deck1_cooler", "deck"),
            ),
        ),
        _simple(
            "cycler",
            "biometra (96well)",
            "biometra (192well)",
            actions=(
                ActionSpec("open_lid", effects=(Sets("module", "lid", "open"),)),
                ActionSpec("close_lid", effects=(Sets("module", "lid", "closed"),)),
                ActionSpec(
                    "run_program",
                    args=(Arg("program_n", "int", minimum=0),),
                    effects=(Needs(), Requires("module", "lid", "closed")),
                    duration_s=5400,
                ),
            ),
            stations=(Station("default", access={"lid": "open"}),),
            variables={"lid": "open"},
            rest={"lid": "open"},
        ),
        _simple(
            "camera",
            "camera (logitech)",
            actions=(
                ActionSpec(
                    "take_picture", args=(Arg("file_name", "str", False, "image.jpg"),), effects=(Needs(),)
                ),
            ),
            stations=(Station("plate_station"),),
        ),
        _simple("reader", "Hidex", stations=(Station("default"),)),
        _simple("barty", "RPL BARTY"),
        _simple("mir", "MiR250"),
        _simple("ur", "ur5", manipulator=True),
    )
}

WORKCELL = """\
labos: 1
name: wc1
modules:
  - {name: stack, model: sciclops}
  - {name: arm, model: pf400, regrip: wc.regrip}
  - {name: sealer, model: A4S_sealer}
  - {name: cycler, model: biometra (96well)}
  - {name: ot2, model: ot2}
  - {name: cam, model: camera (logitech)}
stations:
  wc.trash: {kind: waste, capacity: 5}
  wc.hotel: {kind: hotel, capacity: 2}
  wc.pcr: {kind: nest, accepts: [pcr96]}
  wc.regrip: {kind: nest}
  ot2.deck2: {reach: {arm: [narrow]}}
locations:
  arm:
    stack.exchange: [1, 2]
    sealer.default: [1, 2]
    cycler.default: [1, 2]
    cam.plate_station: [1, 2]
    wc.trash: [1, 2]
    wc.hotel: [1, 2]
    wc.pcr: [1, 2]
    wc.regrip: [1, 2]
stock:
  stack.tower1: {plate96: 20}
"""

BENCH = parse_workcell(WORKCELL, DESCRIPTIONS, "wc1.yaml")


def steps(text: str) -> str:
    """A workflow file; its steps begin in line 4."""
    return f"labos: 1\nname: w\nsteps:\n{text}"


def compile_steps(text: str, payload: Mapping[str, Any] | None = None, **options: Any) -> Compiled:
    source = parse_workflow(steps(text), "w.yaml")
    return compile_workflow(source, payload or {}, BENCH.workcell, DESCRIPTIONS, bench=BENCH.bench, **options)


def faults(text: str, payload: Mapping[str, Any] | None = None, **options: Any) -> list[Finding]:
    source = parse_workflow(steps(text), "w.yaml")
    return validate_workflow(
        source, payload or {}, BENCH.workcell, DESCRIPTIONS, bench=BENCH.bench, **options
    )


def where(finding: Finding) -> tuple[int, int]:
    return finding.line, finding.column
