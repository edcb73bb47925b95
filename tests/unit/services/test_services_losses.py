"""Where the time goes: what a minute is charged to, and what a person is needed for next."""

from __future__ import annotations

from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.decide.nodes import PutBack, TakeOut
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.decide.stock import Replenish
from labos.core.ids import ModuleName, RunId, StationName
from labos.core.resources import LevelSet
from labos.services.inventory import count_inventory
from labos.services.losses import LossAccount, sum_losses
from labos.services.next_touch import list_next_touches
from labos.services.standstill import Cause
from tests.unit.services.logbook import SECOND, Logbook

FOIL = (ModuleName("rpl/sealer"), "foil")


def book() -> Logbook:
    found = Logbook()
    found.furnish()
    found.write([LevelSet(*FOIL, 10, 1000)])
    found.submit("pcr")
    found.at(10)
    return found


def seconds(found: LossAccount) -> dict[str, float]:
    return {f"{loss.cause.kind} {loss.cause.what}": loss.lost_ns / SECOND for loss in found.losses}


def test_pauses_hands_and_modules_out_of_service_are_told_apart() -> None:
    lab = book()
    lab.carry_through("R1", seconds=10, steps=1)  # 10 to 20
    lab.do(PauseRun(RunId("R1")))
    lab.at(120)
    lab.do(ResumeRun(RunId("R1")))
    lab.do(RequestAccess("rpl", "bo"))
    lab.at(150)
    lab.do(EndAccess("rpl", "bo"))
    lab.do(TakeOut(ModuleName("rpl/pf400"), "smoke"))
    lab.at(190)
    lab.do(PutBack(ModuleName("rpl/pf400")))
    lab.carry_through("R1", seconds=10, steps=1)  # 190 to 200
    found = sum_losses(lab.records)
    expected = {"person paused": 100, "planned hands in the workcell": 30, "person out of service": 40}
    assert seconds(found.runs["R1"]) == expected
    run = found.runs["R1"]
    assert (run.span_ns, run.at_work_ns, run.for_a_person_ns) == (190 * SECOND, 20 * SECOND, 170 * SECOND)
    assert run.clock_ns == found.twh.runs["R1"].clock_ns == 60 * SECOND, "nobody was asked about the smoke"
    assert found.lab.span_ns == 200 * SECOND, "it had work from the submission on"
    assert seconds(found.lab) == {**expected, "other about to start": 10}
    assert seconds(found.workcells["rpl"]) == seconds(found.lab)
    modules = {loss.cause.what: loss.cause.module for loss in run.losses}
    assert modules["out of service"] == "rpl/pf400"


def test_what_is_in_flight_goes_on_though_its_module_is_taken_out() -> None:
    lab = book()
    action = lab.start("R1", 0)
    lab.do(TakeOut(ModuleName("rpl/sciclops"), "after this one"))
    lab.at(70)
    lab.finish(action)
    assert not sum_losses(lab.records).runs["R1"].losses


def test_who_waits_for_one_that_stands_still_is_charged_with_the_same_cause() -> None:
    lab = book()
    lab.submit("pcr")
    lab.carry_through("R1", seconds=10, steps=2)  # 10 to 30: its plate stands on the liquid handler
    lab.carry_through("R2", seconds=10, steps=1)  # 30 to 40
    lab.do(TakeOut(ModuleName("rpl/ot2_pcr_alpha"), "smoke"))
    lab.at(100)
    found = sum_losses(lab.records, lab.clock.now)
    cause = Cause("person", "out of service", "rpl/ot2_pcr_alpha")
    assert {loss.cause: loss.lost_ns for loss in found.runs["R2"].losses}[cause] == 60 * SECOND
    assert {spell.run for spell in found.intervals if spell.cause == cause} == {"R1", "R2", ""}


def test_what_is_used_up_is_charged_to_its_module_before_anything_has_begun_too() -> None:
    lab = Logbook()
    lab.furnish()
    lab.write([LevelSet(*FOIL, 0, 1000)])
    lab.submit("pcr")
    lab.at(600)
    lab.do(Replenish(*FOIL, 1000, "F2"))
    lab.at(610)
    lab.carry_through("R1", seconds=10, steps=1)
    found = sum_losses(lab.records)
    assert seconds(found.lab) == {"resource foil": 600, "other about to start": 10}
    assert found.lab.losses[0].cause.module == "rpl/sealer"
    assert found.lab.losses[0].on_clock_ns == 0, "no clock runs before the first step"
    assert not found.runs["R1"].losses


def test_the_next_touches_are_what_waits_and_what_will() -> None:
    lab = book()
    lab.write([LevelSet(*FOIL, 1, 1000)])
    lab.submit("pcr")
    lab.do(TakeOut(ModuleName("rpl/biometra"), "smoke"))
    lab.carry_through("R1", seconds=10, steps=1)
    lab.do(RequestAccess("rpl", "bo"))
    now = lab.clock.now
    touches = list_next_touches(lab.state, now)
    assert [touch.kind for touch in touches] == ["access", "module", "supply"]
    assert [touch.run for touch in touches] == ["", "R1", "R2"]
    assert touches[0].at <= now < touches[1].at < touches[2].at
    assert "foil" in touches[2].what
    assert touches[1].remedy == "labos reset biometra"


def test_the_room_in_a_waste_is_looked_ahead_to() -> None:
    lab = Logbook()
    lab.furnish()
    lab.submit("cp_trashplate")
    (waste,) = count_inventory(lab.state, lab.clock.now, "2026-01-01").wastes
    assert (waste.station, waste.promised) == (StationName("rpl/wc.trash"), 1)
    assert waste.room >= 1
    assert waste.runs_out is None
