"""Of equal runs inside, the one that is furthest behind goes first."""

from __future__ import annotations

from labos.core.model import Plan
from labos.planning.own_order import EQUALLY_OLD_S
from tests.support.bench import Driver, module, plan, station, step, workcell


def twice(name: str = "flow") -> Plan:
    """A run comes in by the arm, and needs the device twice."""
    return plan(step("arm"), step("dev"), step("cam"), step("dev"), name=name)


def find_who_gets_the_device(*plans: Plan, apart_s: float = 0.0) -> str:
    """Three runs are inside. The first one has been at the device once, and the second one leaves it now: the
    step that follows."""
    lab = Driver(workcell([module("arm"), module("dev"), module("cam")], [station("x")]))
    for each in plans:
        lab.submit(each)
        lab.wait(apart_s)
    lab.pump()
    started: list[str] = []
    for name in ("arm", "arm", "arm", "dev", "cam", "dev"):
        action = next(a.id for a in lab.state.actions.open.values() if a.module.endswith(name))
        lab.finish(action)
        started = lab.pump()
    (found,) = [each for each in started if each in ("R1#3", "R3#1")]
    return found


def test_the_equal_run_that_is_furthest_behind_goes_first() -> None:
    assert find_who_gets_the_device(twice(), twice(), twice()) == "R3#1"


def test_a_run_of_another_plan_goes_by_age() -> None:
    assert find_who_gets_the_device(twice(), twice(), twice("other")) == "R1#3"


def test_a_run_that_is_older_goes_first() -> None:
    apart_s = EQUALLY_OLD_S
    assert find_who_gets_the_device(twice(), twice(), twice(), apart_s=apart_s) == "R1#3"
