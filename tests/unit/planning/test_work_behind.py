"""Of the steps of one run that may start, the one goes first behind which most of the run is left."""

from __future__ import annotations

from labos.core.decide.suggestions import SuggestOrder
from labos.core.model import Plan
from labos.core.suggestions import Suggested
from tests.support.bench import SECOND, Driver, elsewhere, module, move, plan, station, step, take, workcell


def lab() -> Driver:
    cell = workcell(
        [module("arm"), module("dev"), module("cam")],
        [station("stack", "stack", 9), station("trash", "waste", 9), station("x"), station("y")],
    )
    driver = Driver(cell)
    driver.stock("stack", 4)
    return driver


def two_branches(*before: str) -> Plan:
    """The branch that is written later takes longer; both need the arm for their first steps."""
    first = [step(name) for name in before]
    after = (len(first) - 1,) if first else ()
    begin = len(first)
    return plan(
        *first,
        step("arm", take("stack", "x"), key="short", after=after),
        step("arm", move("x", "trash"), key="short out", after=(begin,)),
        step("arm", take("stack", "y"), key="long", after=after),
        step("dev", key="work", after=(begin + 2,), duration_s=600.0),
        step("arm", move("y", "trash"), key="long out", after=(begin + 3,)),
        parallel=True,
    )


def test_a_run_is_let_in_with_its_longest_branch() -> None:
    driver = lab()
    driver.submit(two_branches())
    assert driver.pump() == ["R1#2"]


def test_a_run_inside_goes_on_with_its_longest_branch() -> None:
    driver = lab()
    run = driver.submit(two_branches("cam"))
    assert driver.pump() == ["R1#0"]
    driver.finish(driver.list_flying()[0])
    assert driver.pump() == ["R1#3"], run


def test_another_run_that_came_first_goes_first_however_little_of_it_is_left() -> None:
    driver = lab()
    first = driver.submit(plan(step("cam"), step("arm", take("stack", "x")), step("arm", move("x", "trash"))))
    driver.submit(two_branches("dev"))
    assert driver.pump() == ["R1#0", "R2#0"]
    for action in driver.list_flying():
        driver.finish(action)
    assert driver.pump() == [f"{first}#1"]


def test_all_first_steps_of_a_run_go_before_those_of_the_next_run() -> None:
    driver = lab()
    both = plan(step("cam", duration_s=600.0), step("dev"), parallel=True)
    driver.submit(both)
    driver.submit(both)
    assert driver.pump() == ["R1#0", "R1#1"]


def test_an_order_for_another_workcell_makes_no_difference_to_that() -> None:
    driver = lab()
    other = workcell([module("cam"), module("dev")], [station("x")])
    driver.furnish(elsewhere("other", other))
    there = driver.submit(elsewhere("other", plan(step("cam"))))
    until = driver.now + 3600 * SECOND
    steps = (Suggested(there, 0, driver.now),)
    driver.do(SuggestOrder("other", "planner", until, steps, driver.state.position))
    both = plan(step("cam", duration_s=600.0), step("dev"), parallel=True)
    first, second = driver.submit(both), driver.submit(both)
    started = [each for each in driver.pump() if not each.startswith(there)]
    assert started == [f"{first}#0", f"{first}#1"], second
