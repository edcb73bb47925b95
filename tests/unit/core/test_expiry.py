"""Packs past their date are not used; a person takes them out, or a workflow has it done."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.days import day_of
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.stock import Replenish
from labos.core.effects import Replaces
from labos.core.ids import InterventionId, ModuleName, RunId
from labos.core.model import PlanStep
from labos.core.resources import LevelSet, ResourceReplenished
from labos.core.waits import Wait
from tests.support.bench import Driver, consumes, full, plan, small, small_cell, step

DEV = ModuleName(full("dev"))
DAY_S = 24 * 3600.0


def today(lab: Driver, days: float = 0.0) -> str:
    return day_of(lab.now + int(days * DAY_S * 1e9))


def make_stocked(*packs: tuple[str, float, float]) -> Driver:
    """A device with packs (lot, amount, days that it is still good)."""
    lab = small()
    lab.set_level(LevelSet(DEV, "foil", 0, 100))
    for lot, amount, days in packs:
        lab.do(Replenish(DEV, "foil", amount, lot, today(lab, days)))
    return lab


def make_sealing(lab: Driver, amount: float = 2) -> RunId:
    return lab.submit(plan(step("dev", consumes("foil", amount)), step("dev", consumes("foil", amount))))


def test_a_pack_is_good_through_its_day_and_no_longer() -> None:
    lab = make_stocked(("A", 10, 0))
    run = make_sealing(lab)
    lab.step(run)
    lab.wait(DAY_S)
    found = lab.check_start(run, 1)
    assert isinstance(found, Wait)
    assert (found.code, found.blocked) == ("expired", True)
    assert found.reason.sentence == f"foil of dev has expired (lot A, on {today(lab, -1)})"
    assert found.reason.remedy.endswith("labos replenish dev foil --lot LOT --instead")
    assert lab.reject(lab.start_command(run, 1)).code == "expired"
    lab.do(Replenish(DEV, "foil", 0, "B", today(lab, 30), True, today(lab)))
    assert [(lot.name, lot.left) for lot in lab.state.resources.levels[f"{DEV}:foil"].lots] == [("B", 100)]
    assert lab.pump() == [f"{run}#1"], "it is woken"
    lab.check_log()


def test_a_run_is_not_let_in_that_would_come_to_an_old_pack_half_way() -> None:
    lab = make_stocked(("A", 3, 30), ("B", 10, -1))
    assert isinstance(lab.check_start(make_sealing(lab, 1)), tuple), "the fresh one is enough"
    found = lab.check_start(make_sealing(lab, 2))
    assert isinstance(found, Wait)
    assert (found.code, found.names[2]) == ("expired", "B")


def test_a_workcell_may_let_them_be_used() -> None:
    lab = make_stocked(("A", 10, -1))
    run = make_sealing(lab)
    assert isinstance(lab.check_start(run), Wait)
    cell = small_cell()
    modules = tuple(msgspec.structs.replace(module, expired="warn") for module in cell.modules)
    lab.do(ApplyWorkcell(msgspec.structs.replace(cell, digest="lenient", modules=modules)))
    assert isinstance(lab.check_start(run), tuple)


def test_who_waits_for_a_fresh_pack_is_named() -> None:
    lab = make_stocked(("A", 10, 0))
    run = make_sealing(lab)
    lab.step(run)
    fresh = Replenish(DEV, "foil", 0, "B", "", True)
    (in_time,) = lab.do(msgspec.structs.replace(fresh, today=today(lab)))
    assert isinstance(in_time, ResourceReplenished)
    assert (in_time.awaited, in_time.instead, in_time.amount) == ((), True, 100)
    lab.do(Replenish(DEV, "foil", 5, "C", today(lab, -2), True))
    (late,) = lab.do(msgspec.structs.replace(fresh, today=today(lab)))
    assert isinstance(late, ResourceReplenished)
    assert late.awaited == (run,)


def test_a_pack_is_not_taken_out_while_it_is_being_used() -> None:
    lab = make_stocked(("A", 10, 30))
    lab.start(make_sealing(lab))
    assert lab.reject(Replenish(DEV, "foil", 0, "B", "", True)).code == "in_use"


@pytest.mark.parametrize("choice", ["done", "not_done"])
def test_what_a_person_replaces_is_full(choice: str) -> None:
    lab = make_stocked(("A", 1, 30))
    by_hand = PlanStep("new roll", full("arm"), "replace", effects=(Replaces(full("dev"), "foil", "B"),))  # type: ignore[arg-type]
    by_hand = msgspec.structs.replace(by_hand, by_person=True)
    run = lab.submit(plan(by_hand, step("dev", consumes("foil", 5))))
    assert isinstance(lab.check_start(run), tuple), "it fills up itself what it uses"
    lab.start(run)
    lab.do(ResolveIntervention(InterventionId("I1"), choice, "ada"))
    level = lab.state.resources.levels[f"{DEV}:foil"]
    assert (level.level, level.lots[-1].name) == ((100, "B") if choice == "done" else (1, "A"))
    lab.check_log()
