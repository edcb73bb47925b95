"""Changing a workcell that is in use: what is left out must be empty and needed by nobody."""

from __future__ import annotations

import msgspec

from labos.core.decide.lab import ApplyWorkcell, in_the_way
from labos.core.model import Workcell
from tests.support.bench import Driver, full, module, route, station, workcell

MODULES = [module("arm"), module("dev")]
STATIONS = [
    station("stack", "stack", 9),
    station("trash", "waste", 9),
    station("dev.a"),
    station("dev.b"),
    station("c"),
]


def without(*names: str) -> Workcell:
    left = [spec for spec in STATIONS if spec.name not in map(full, names)]
    cell = workcell([spec for spec in MODULES if spec.name not in map(full, names)], left)
    return msgspec.structs.replace(cell, digest=f"without {names}")


def lab() -> Driver:
    driver = Driver(workcell(MODULES, STATIONS))
    driver.stock("stack", 3)
    return driver


def test_an_empty_station_of_a_module_that_stays_goes() -> None:
    driver = lab()
    driver.do(ApplyWorkcell(without("dev.b", "c")))
    assert full("c") not in driver.state.bench.stations
    assert driver.state.bench.by_module[full("dev")] == [full("dev.a")]  # type: ignore[index]
    driver.check_log()


def test_everything_in_the_way_is_named() -> None:
    driver = lab()
    driver.stock("c", 1)
    driver.submit(route("stack", "dev.a", "trash"))
    found = in_the_way(driver.state, without("stack", "dev.a", "c"))
    assert [(r.code, r.message) for r in found] == [
        ("station_occupied", "The station c holds P1 and cannot be removed from cell."),
        ("station_occupied", "The station stack holds stock and cannot be removed from cell."),
        ("plan_in_use", "The workflow 'flow' is in use by R1 and needs dev.a."),
        ("plan_in_use", "The workflow 'flow' is in use by R1 and needs stack."),
    ]
    assert driver.refused(ApplyWorkcell(without("c"))).code == "station_occupied"


def test_what_may_hold_something_stays() -> None:
    driver = lab()
    driver.stock("dev.a", 1)
    driver.doubt(driver.start(driver.submit(route("dev.a", "c"))))
    found = in_the_way(driver.state, without("c", "dev.a"))
    assert {r.code for r in found} == {"station_occupied", "plan_in_use"}
