"""Changing a workcell that is in use: what is left out must be empty and needed by nobody."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.decide.lab import ApplyWorkcell, list_obstacles
from labos.core.effects import Replaces
from labos.core.ids import ModuleName, StationName
from labos.core.model import PlanStep, Workcell
from tests.support.bench import Driver, full, module, plan, route, station, workcell

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
    found = list_obstacles(driver.state, without("stack", "dev.a", "c"))
    assert [(r.code, r.message) for r in found] == [
        ("station_occupied", "The station c holds P1 and cannot be removed from cell."),
        ("station_occupied", "The station stack holds a stock of 3 and cannot be removed from cell."),
        ("plan_in_use", "The workflow 'flow' is in use by R1 and needs dev.a."),
        ("plan_in_use", "The workflow 'flow' is in use by R1 and needs stack."),
    ]
    assert driver.reject(ApplyWorkcell(without("c"))).code == "station_occupied"


def codes(driver: Driver, cell: Workcell) -> set[str]:
    return {found.code for found in list_obstacles(driver.state, cell)}


def test_what_may_hold_something_stays() -> None:
    driver = lab()
    driver.stock("dev.a", 1)
    driver.doubt(driver.start(driver.submit(route("dev.a", "c"))))
    assert codes(driver, without("c", "dev.a")) == {"uncertain", "plan_in_use"}
    refused = driver.reject(ApplyWorkcell(without("c")))
    assert refused.message == "It is not yet known what stands at c, which cannot be removed from cell."


def test_a_module_at_work_stays_and_so_does_one_that_a_queued_run_needs() -> None:
    driver = lab()
    run = driver.submit(route("stack", "dev.a", "trash"))
    assert codes(driver, without("arm")) == {"plan_in_use"}
    action = driver.start(run)
    assert codes(driver, without("arm")) == {"module_in_use", "plan_in_use"}
    assert driver.reject(ApplyWorkcell(without("dev.a"))).message == (
        "The station dev.a holds an arrival and cannot be removed from cell."
    )
    driver.finish(action)
    driver.step(run, 1)
    driver.do(ApplyWorkcell(without("dev", "dev.a", "dev.b")))
    assert full("dev") not in driver.state.modules.by_name


def test_where_an_experiment_closes_or_parks_stays() -> None:
    driver = lab()
    experiment = driver.experiment(closing=route("c", "trash"), parking=(StationName(full("dev.b")),))
    assert codes(driver, without("c")) == {"plan_in_use"}
    refused = driver.reject(ApplyWorkcell(without("dev.b")))
    assert (refused.code, refused.message) == (
        "parking_in_use",
        f"The experiment {experiment} parks at dev.b.",
    )


def test_what_a_queued_run_has_refilled_stays() -> None:
    driver = lab()
    refill = PlanStep("foil", ModuleName(full("arm")), "replace", effects=(Replaces(full("dev"), "foil"),))
    driver.submit(plan(refill))
    assert driver.reject(ApplyWorkcell(without("dev", "dev.a", "dev.b"))).code == "plan_in_use"


def change_station(name: str, **more: Any) -> Workcell:
    stations = [msgspec.structs.replace(s, **more) if s.name == full(name) else s for s in STATIONS]
    return msgspec.structs.replace(workcell(MODULES, stations), digest=f"{name} {more}")


def test_what_holds_something_neither_shrinks_below_it_nor_becomes_another_kind() -> None:
    driver = lab()
    driver.stock("c", 1)
    assert driver.reject(ApplyWorkcell(change_station("stack", capacity=2))).message == (
        "The station stack holds 3, more than the 2 of its new capacity."
    )
    assert driver.reject(ApplyWorkcell(change_station("c", kind="waste"))).message == (
        "The station c holds P1 and cannot become a waste."
    )
    driver.do(ApplyWorkcell(change_station("stack", capacity=3)))
    driver.do(ApplyWorkcell(change_station("dev.a", kind="waste")))
    driver.check_log()
