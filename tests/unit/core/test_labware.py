"""What people say of labware."""

from __future__ import annotations

from labos.core.decide.lab import DeclareStation
from labos.core.decide.labware import PlateSamples, RegisterSamples
from labos.core.ids import LabwareId, StationName
from labos.core.labware import Sample, SamplesRegistered
from tests.support.bench import Driver, full, module, station, workcell

P1 = LabwareId("P1")
WATER = (Sample("A1", "water"),)


def driver() -> Driver:
    made = Driver(workcell([module("dev")], [station("dev.nest"), station("dev.other")]))
    made.do(DeclareStation(StationName(full("dev.nest")), ("plate",)))
    return made


def test_a_sheet_is_remembered_and_replaced_only_on_purpose() -> None:
    lab = driver()
    (event,) = lab.do(RegisterSamples("d1", (PlateSamples(P1, 1, WATER),)))
    assert event == SamplesRegistered(P1, "", "d1", 1, WATER)
    assert lab.state.bench.labware[P1].samples == "d1"
    assert lab.do(RegisterSamples("d1", (PlateSamples(P1, 1, WATER),))) == []
    assert lab.reject(RegisterSamples("d2", (PlateSamples(P1, 1, WATER),))).code == "samples_known"
    assert len(lab.do(RegisterSamples("d2", (PlateSamples(P1, 1, WATER),), replace=True))) == 1


def test_all_of_a_sheet_or_nothing() -> None:
    lab = driver()
    plates = (PlateSamples(P1, 1, WATER), PlateSamples(LabwareId("P9"), 1, WATER))
    assert lab.reject(RegisterSamples("d1", plates)).code == "no_labware"
    assert lab.state.bench.labware[P1].samples == ""


def test_what_is_too_large_for_the_log_is_refused() -> None:
    lab = driver()
    many = tuple(Sample(f"A{n}", "x" * 100) for n in range(1, 1000))
    assert lab.reject(RegisterSamples("d1", (PlateSamples(P1, len(many), many),))).code == "unfit"
