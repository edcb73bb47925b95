"""Amounts in other units, converted or refused; liquids with levels and lots, from file to well."""

from __future__ import annotations

import contextlib

import msgspec
import pytest

from labos.core.decide.lab import DeclareStation
from labos.core.decide.stock import Replenish
from labos.core.effects import Consumes, Transfers
from labos.core.ids import ModuleName, StationName
from labos.core.labware import LiquidTransferred
from labos.core.resources import ResourceConsumed
from labos.errors import SpecError
from labos.spec import SpecErrors, compile_workflow, parse_workcell, parse_workflow
from labos.spec.units import in_unit
from tests.simulation.mixes import DESCRIPTIONS
from tests.support.bench import Driver

HANDLER = ModuleName("corner/handler")
CELL = """
labos: 1
name: corner
modules: [{name: handler, model: ot2, resources: {red: 1 mL, water: {amount: 0.5, unit: l}}}]
stock: {}
"""
MIX = """
labos: 1
name: mix
steps:
  - name: mix
    module: handler
    action: run_protocol
    args: {config_path: p.yaml, destination_wells: [A1, B1], red_volumes: [300, 400], blue_volumes: [1, 2]}
"""


@pytest.mark.parametrize(
    ("value", "unit", "wanted", "found"),
    [
        (3, "", "uL", 3),
        (0.3, "mL", "uL", 300),
        ("20 mL", "", "uL", 20_000),
        ("1.5e3nL", "", "µL", 1.5),
        (2, "µL", "mL", 0.002),
        ("0.1 L", "", "mL", 100),
        (5, "g", "mg", 5000),
        ("2 m", "", "mm", 2000),
        (7, "pcs", "", 7),
        (4, "strips", "strips", 4),
    ],
)
def test_amounts_are_converted(value: float | str, unit: str, wanted: str, found: float) -> None:
    assert in_unit(value, unit, wanted, "ink") == found


@pytest.mark.parametrize(
    ("value", "unit", "wanted", "why"),
    [
        (5, "mL", "", "ink is counted in pieces; 'mL' cannot be converted to it"),
        (5, "mg", "uL", "Write one of nL, uL, mL, L"),
        ("much", "", "uL", "'much' is not an amount of ink"),
        ("-3 mL", "", "uL", "The amount of ink cannot be -3"),
        (5, "mL", "strips", "ink is counted in strips"),
    ],
)
def test_what_cannot_be_converted_is_refused(value: float | str, unit: str, wanted: str, why: str) -> None:
    with pytest.raises(SpecError) as refused:
        in_unit(value, unit, wanted, "ink")
    assert why in f"{refused.value.message} {refused.value.remedy}"


def test_the_workcell_file_converts_and_tells_the_place_of_a_fault() -> None:
    (module,) = parse_workcell(CELL, DESCRIPTIONS).workcell.modules
    assert (module.levels["red"], module.levels["water"], module.levels["tips"]) == (1000, 500_000, 960)
    with pytest.raises(SpecErrors, match=r"cell.yaml:4:.*tips is counted in pieces"):
        parse_workcell(CELL.replace("red: 1 mL", "tips: 1 mL"), DESCRIPTIONS, "cell.yaml")


def test_a_transfer_uses_up_the_liquid_and_names_its_lots() -> None:
    cell = parse_workcell(CELL, DESCRIPTIONS)
    source = parse_workflow(MIX, "mix.yaml")
    plan = compile_workflow(source, {}, cell.workcell, DESCRIPTIONS, simulate=True, bench=cell.bench).plan
    used = {e.resource: e.amount for e in plan.steps[0].effects if isinstance(e, Consumes)}
    assert used == {"tips": 8, "red": 700, "water": 0}, "there is no end of blue"
    assert {e.resource for e in plan.steps[0].effects if isinstance(e, Transfers)} >= {"red", "blue"}
    modules = tuple(msgspec.structs.replace(module, driver="driver") for module in cell.workcell.modules)
    lab = Driver(msgspec.structs.replace(cell.workcell, modules=modules))
    lab.do(DeclareStation(StationName("corner/handler.deck1"), ("bottles",)))
    lab.step(lab.submit(plan))
    lab.do(Replenish(HANDLER, "red", 700, "R2"))
    lab.step(lab.submit(plan))
    events = [entry.event for entry in lab.log]
    last = [e for e in events if isinstance(e, LiquidTransferred) and e.liquid == "red"][-1]
    assert (last.wells, last.volumes_ul, last.lots) == (("A1", "B1"), (300.0, 400.0), ("R2",))
    charged = [(e.lot, e.amount) for e in events if isinstance(e, ResourceConsumed) and e.resource == "red"]
    assert charged == [("", 700), ("", 300), ("R2", 400)]


STACKED = """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: arm, model: pf400}
  - {name: handler, model: ot2}
stock:
  left.tower1: {plate96: 20}
"""
TWICE = """
labos: 1
name: mix
steps:
  - {name: get, module: left, action: get_plate, args: {loc: tower1}}
  - {name: carry, module: arm, action: transfer, args: {source: left.exchange, target: handler.deck2}}
  - name: once
    module: handler
    action: run_protocol
    args: {config_path: p.yaml, destination_wells: [A1, B1], red_volumes: [200, 150]}
  - name: again
    module: handler
    action: run_protocol
    args: {config_path: p.yaml, destination_wells: [A1, B1], red_volumes: [100, 150]}
"""


@pytest.mark.parametrize(
    ("wells", "volumes", "why"),
    [
        ("[A1, B1]", "[100, -150]", r"mix.yaml:14:\d+: .*'again': the volume of red for B1 is -150 µL"),
        ("[A1]", "[100, 150]", r"mix.yaml:14:\d+: .*2 volumes of red for 1 well"),
        ("[A1]", "[ten]", r"mix.yaml:14:\d+: .*the volume of red for A1 is 'ten', which is not a number"),
        ("[A1, well2]", "[100, 150]", r"mix.yaml:14:\d+: .*'well2' is not a well"),
        (
            "[A1, Z99]",
            "[1, 1]",
            r"mix.yaml:\d+:\d+: .*'again': A plate96 has no well Z99; its wells are A1 to H12",
        ),
        (
            "[A1, B1]",
            "[1, 99999]",
            r"B1 of the labware would hold 100149 µL, and a well of a plate96 holds 360 µL",
        ),
        ("[A1, A01]", "[80, 81]", r"A1 of the labware would hold 361 µL"),
    ],
)
def test_what_cannot_be_poured_is_refused_when_it_is_submitted(wells: str, volumes: str, why: str) -> None:
    cell = parse_workcell(STACKED, DESCRIPTIONS)
    good = compile_workflow(
        parse_workflow(TWICE, "mix.yaml"), {}, cell.workcell, DESCRIPTIONS, simulate=True, bench=cell.bench
    )
    assert not [finding for finding in good.findings if finding.severity == "error"]
    last = TWICE.replace("[A1, B1], red_volumes: [100, 150]", f"{wells}, red_volumes: {volumes}")
    assert last != TWICE or volumes == "[100, 150]"
    with pytest.raises(SpecErrors, match=why):
        compile_workflow(
            parse_workflow(last, "mix.yaml"), {}, cell.workcell, DESCRIPTIONS, simulate=True, bench=cell.bench
        )


@pytest.mark.parametrize(
    ("drawn", "why"),
    [
        ("source_wells: [A1, B1], source_volumes: [300, 10]", ""),
        ("source_wells: [C1], source_volumes: [360]", ""),
        ("source_wells: [A1], source_volumes: [310]", r"A1 of the labware is recorded with 300 µL"),
        ("source_wells: [A1], source_volumes: [-1]", r"mix.yaml:14:\d+: .*what is drawn for A1 is -1 µL"),
        ("source_wells: [A1], source_volumes: [1, 2]", r"mix.yaml:14:\d+: .*2 volumes of what is drawn"),
        ("source_wells: [Z99], source_volumes: [1]", r"has no well Z99"),
    ],
)
def test_what_is_not_there_is_not_drawn(drawn: str, why: str) -> None:
    cell = parse_workcell(STACKED, DESCRIPTIONS)
    source = parse_workflow(TWICE.rstrip("}\n") + f", {drawn}}}\n", "mix.yaml")
    with pytest.raises(SpecErrors, match=why) if why else contextlib.nullcontext():
        compile_workflow(source, {}, cell.workcell, DESCRIPTIONS, simulate=True, bench=cell.bench)
