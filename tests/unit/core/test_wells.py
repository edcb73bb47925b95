"""Liquid goes only into wells that the plate has, and not more than they hold."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from labos.core.decide.labware import PlateSamples, RegisterSamples
from labos.core.effects import Draws, Transfers
from labos.core.ids import LabwareId, RunId
from labos.core.labware import LiquidDrawn, LiquidTransferred, Sample
from labos.core.model import LabwareSpec, WellGrid
from labos.core.runs import RunFailed
from labos.core.wells import normalise_well, parse_well, row_name
from tests.support.bench import Driver, needs, plan, route, small_cell, step

PLATE = LabwareSpec("plate", 127.76, 85.48, 14.0, WellGrid(8, 12, 9.0, 14.38, 11.24, 360.0))
LID = LabwareSpec("lid", 127.76, 85.48, 9.0)


def bench(*kinds: LabwareSpec) -> Driver:
    """A plate on a device."""
    lab = Driver(msgspec.structs.replace(small_cell(), labware=kinds or (PLATE,)))
    lab.stock("stack", 1)
    lab.step(lab.submit(route("stack", "dev.n1")))
    return lab


def pour(lab: Driver, *doses: tuple[Any, Any], result: Any = None) -> RunId:
    """A run that works something out, and pours into the plate."""
    effects = [Transfers(f"ink{number}", *lists) for number, lists in enumerate(doses)]
    run = lab.submit(plan(step("cam"), step("dev", needs("dev.n1"), *effects), name="pour", feeds=(0,)))
    lab.step(run, 0, result)
    return run


def read_volumes(lab: Driver) -> dict[str, float]:
    return lab.state.bench.labware[LabwareId("P1")].volumes_ul


def failure(lab: Driver, run: RunId) -> str:
    """Why the run failed when its pouring was to start; nothing was asked of the device."""
    events = lab.do(lab.start_command(run, 1))
    assert not lab.list_flying()
    (failed,) = [event for event in events if isinstance(event, RunFailed)]
    assert failed.kind == "experiment"
    return failed.why


def test_what_went_into_wells_is_in_them() -> None:
    lab = bench()
    lab.step(pour(lab, (["A1", "b02"], [100, 50]), (["A1"], [10.5])), 1)
    lab.step(pour(lab, (["A1"], [1])), 1)
    assert read_volumes(lab) == {"A1": 111.5, "B2": 50.0}
    given = sum(sum(e.event.volumes_ul) for e in lab.log if isinstance(e.event, LiquidTransferred))
    assert given == sum(read_volumes(lab).values()), "nothing is lost, and nothing comes from nowhere"
    lab.check_log()


@pytest.mark.parametrize(
    ("doses", "why"),
    [
        ([(["Z99"], [5])], "a plate has no well Z99; its wells are A1 to H12"),
        ([(["A13"], [5])], "a plate has no well A13"),
        ([(["A1"], [99_999])], "A1 of P1 would hold 99999 µL, and a well of a plate holds 360 µL"),
        ([(["A1"], [200]), (["A1"], [161])], "A1 of P1 would hold 361 µL"),
    ],
)
def test_what_does_not_fit_is_not_poured(doses: list[tuple[Any, Any]], why: str) -> None:
    lab = bench()
    assert why in failure(lab, pour(lab, *doses))
    assert read_volumes(lab) == {}


@pytest.mark.parametrize(
    ("volumes", "why"),
    [
        ([-10], "the volume of ink0 for A1 is -10 µL"),
        (["ten"], "the volume of ink0 for A1 is 'ten', which is not a number"),
        ([True], "which is not a number"),
        ([1, 2], "2 volumes of ink0 for 1 well"),
    ],
)
def test_volumes_that_an_earlier_step_worked_out_wrongly_are_not_poured(volumes: Any, why: str) -> None:
    lab = bench()
    run = pour(lab, (["A1"], {"$result": [0, "volumes"]}), result={"volumes": volumes})
    assert why in failure(lab, run)


def test_a_plate_fills_up() -> None:
    lab = bench()
    for _ in range(3):
        lab.step(pour(lab, (["H12"], [120])), 1)
    assert "would hold 360.5 µL" in failure(lab, pour(lab, (["H12"], [0.5])))


def test_what_failed_half_way_may_be_in_the_well() -> None:
    lab = bench()
    run = pour(lab, (["A1"], [300]))
    lab.fail(lab.start(run, 1), "partial")
    assert read_volumes(lab) == {"A1": 300.0}
    assert "would hold 400 µL" in failure(lab, pour(lab, (["A1"], [100])))


def draw(lab: Driver, *effects: Any) -> RunId:
    """A run that works something out, and then pours and draws."""
    steps = (step("cam"), step("dev", needs("dev.n1"), *effects))
    run = lab.submit(plan(*steps, name="draw", feeds=(0,)))
    lab.step(run)
    return run


def test_what_is_drawn_is_in_the_wells_no_more() -> None:
    lab = bench()
    lab.step(draw(lab, Transfers("ink", ["A1", "A2"], [100, 50]), Draws(["a01"], [30])), 1)
    assert read_volumes(lab) == {"A1": 70.0, "A2": 50.0}
    lab.step(draw(lab, Draws(["A1", "A2"], [70, 10])), 1)
    assert read_volumes(lab) == {"A1": 0.0, "A2": 40.0}
    moved = [e.event for e in lab.log if isinstance(e.event, LiquidTransferred | LiquidDrawn)]
    total = sum(sum(e.volumes_ul) * (1 if isinstance(e, LiquidTransferred) else -1) for e in moved)
    assert total == sum(read_volumes(lab).values())
    lab.check_log()


@pytest.mark.parametrize(
    ("effects", "why"),
    [
        ([Draws(["A1"], [101])], "A1 of P1 is recorded with 100 µL, and 101 µL would be drawn"),
        ([Draws(["A1", "A1"], [60, 60])], "120 µL would be drawn"),
        ([Draws(["B1"], [361])], "361 µL would be drawn out of B1 of P1, and a well of a plate holds 360 µL"),
        ([Draws(["Z99"], [1])], "a plate has no well Z99"),
        ([Draws(["A1"], [-1])], "the volume of what is drawn for A1 is -1 µL"),
        ([Draws(["A1"], [1, 2])], "2 volumes of what is drawn for 1 well"),
    ],
)
def test_a_well_gives_no_more_than_it_holds(effects: list[Any], why: str) -> None:
    lab = bench()
    lab.step(pour(lab, (["A1"], [100])), 1)
    assert why in failure(lab, draw(lab, *effects))
    assert read_volumes(lab) == {"A1": 100.0}


def test_what_was_poured_in_the_same_action_can_be_drawn() -> None:
    lab = bench()
    lab.step(draw(lab, Transfers("ink", ["A1"], [300]), Draws(["A1"], [250])), 1)
    assert read_volumes(lab) == {"A1": 50.0}
    lab.step(draw(lab, Transfers("ink", ["A1"], [340]), Draws(["A1"], [30])), 1)
    assert read_volumes(lab) == {"A1": 360.0}


def test_a_well_of_which_nothing_is_known_gives_what_fits_into_it() -> None:
    lab = bench()
    lab.step(draw(lab, Draws(["A1"], [360])), 1)
    assert read_volumes(lab) == {}


def test_what_was_drawn_half_way_may_still_be_in_the_well() -> None:
    lab = bench()
    lab.step(pour(lab, (["A1"], [300])), 1)
    lab.fail(lab.start(draw(lab, Draws(["A1"], [200])), 1), "partial")
    assert read_volumes(lab) == {"A1": 300.0}
    assert "would hold 400 µL" in failure(lab, pour(lab, (["A1"], [100])))


def test_a_sheet_says_what_the_wells_hold_now() -> None:
    lab = bench()
    samples = (Sample("A1", "S1", 350.0), Sample("A2", "S2"))
    lab.do(RegisterSamples("f" * 64, (PlateSamples(LabwareId("P1"), 2, samples),)))
    assert read_volumes(lab) == {"A1": 350.0}
    assert "would hold 361 µL" in failure(lab, pour(lab, (["A1"], [11])))


def test_what_has_no_wells_takes_no_liquid() -> None:
    lab = bench(msgspec.structs.replace(LID, name="plate"))
    assert "P1 is a plate, which has no wells" in failure(lab, pour(lab, (["A1"], [1])))


def test_of_a_type_that_nobody_described_only_the_lists_are_looked_at() -> None:
    lab = bench(LID)
    lab.step(pour(lab, (["Z99"], [5000])), 1)
    assert read_volumes(lab) == {"Z99": 5000.0}


def test_names_of_wells() -> None:
    assert [row_name(row) for row in (0, 7, 25, 26, 31)] == ["A", "H", "Z", "AA", "AF"]
    assert all(parse_well(f"{row_name(row)}1") == (row, 0) for row in range(48))
    assert normalise_well(" h012 ") == "H12"


def test_wells_are_in_order_row_by_row() -> None:
    wells = ["A10", "B1", "AA1", "A2", "A1", "H12"]
    assert sorted(wells, key=parse_well) == ["A1", "A2", "A10", "B1", "H12", "AA1"]
