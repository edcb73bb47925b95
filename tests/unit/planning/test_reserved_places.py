"""A place with room for several is reserved for several at a time."""

from __future__ import annotations

import pytest

from labos.core.model import Plan, Window
from tests.support.bench import Driver, module, move, plan, station, step, take, workcell


def go_to_bank(module_name: str) -> Plan:
    """A run that starts a clock, and has to be at the bank in time."""
    in_time = (Window(0, 0.0, 30.0),)
    return plan(
        step(module_name, key="dose", duration_s=60.0),
        step("bank", take("stack", "place"), exclusive=False, duration_s=300.0, windows=in_time),
        step("bank", move("place", "trash"), exclusive=False, duration_s=10.0),
    )


def stand_at_bank(lab: Driver, stays_s: float) -> None:
    """Labware of a run stands at the bank, and is carried away next, or after so long."""
    stay = [step("cam", duration_s=stays_s)] if stays_s else []
    to_bank, away = take("stack", "place"), move("place", "trash")
    steps = [step("bank", to_bank, exclusive=False), *stay, step("bank", away, exclusive=False)]
    lab.submit(plan(*steps))
    lab.pump()
    lab.finish(lab.list_flying()[0])
    lab.pump()


@pytest.mark.parametrize(
    ("stays_s", "started"), [(0.0, ["R2#0", "R3#0"]), (3600.0, ["R2#0"])], ids=["leaves", "stays"]
)
def test_two_clocks_run_where_there_is_room_for_both(stays_s: float, started: list[str]) -> None:
    names = ("one", "other", "cam", "bank")
    places = [station("stack", "stack", 9), station("place", capacity=2), station("trash", "waste", 9)]
    lab = Driver(workcell(map(module, names), places))
    lab.stock("stack", 9)
    stand_at_bank(lab, stays_s)
    found: list[str] = []
    for name in ("one", "other"):
        lab.submit(go_to_bank(name))
        found += lab.pump()
    assert found == started
