"""A planner's search knows set-ups and due dates: what it finds is good because of them."""

from __future__ import annotations

import pytest

from labos.core.ids import RunId
from labos.core.model import Plan
from labos.core.setups import Setup
from labos.planner.planner import Planner
from labos.planner.problem import SetupCosts, problem_of
from labos.planner.rehearsal import OrderRehearsal
from labos.planner.solve import solve
from tests.support.bench import SECOND, Driver, module, plan, step, workcell
from tests.unit.planning.test_planner import Fixed, chosen, find_order

WORK_S, CHANGE_S = 300.0, 600.0
MINUTE = 60 * SECOND


def does(protocol: str, duration_s: float = WORK_S) -> Plan:
    one = step("dev", key="do", args={"protocol": protocol}, duration_s=duration_s)
    return plan(one, name=f"do {protocol} {duration_s}")


def bench(change_s: float = CHANGE_S) -> Driver:
    setup = Setup("protocol", change_s) if change_s else None
    return Driver(workcell([module("dev", setup=setup)], []))


def makespan(lab: Driver, planner: Planner | None) -> float:
    """How long all takes (seconds), with the order that a planner suggests."""
    order = find_order(planner, lab) if planner is not None else None
    rehearsal = OrderRehearsal(lab.state, "cell", lab.now, 0.5, chosen(lab))
    return (max(rehearsal.go(order).plays[0].ends.values()) - lab.now) / SECOND


def test_runs_of_several_users_are_put_in_order_by_what_has_to_be_set_up() -> None:
    """The lab takes the users' runs in turn and changes the protocol each time; the planner does so once."""
    pytest.importorskip("ortools")
    lab = bench()
    for _ in range(4):
        lab.submit(does("a"), user="ada")
        lab.submit(does("b"), user="bob")
    assert makespan(lab, None) == 8 * (WORK_S + CHANGE_S)
    assert makespan(lab, Planner(seconds=2.0)) == 8 * WORK_S + 2 * CHANGE_S


def test_what_a_change_costs_depends_on_what_was_before() -> None:
    pytest.importorskip("ortools")
    lab = bench()
    lab.finish(lab.start(lab.submit(does("b"))))
    for protocol in "aba":
        lab.submit(does(protocol), user=protocol)
    problem = problem_of(lab.state, chosen(lab), lab.now)
    to_a, to_b = (CHANGE_S, 0.0, CHANGE_S), (0.0, CHANGE_S, 0.0)
    assert problem.setups == (SetupCosts((0, 1, 2), to_a, (to_b, to_a, to_b)),)
    found = solve(problem, 2.0)
    assert found is not None
    assert found.makespan_s == 3 * WORK_S + CHANGE_S
    assert found.starts_s[1] == 0.0, "it goes first, as the module is set up for it"


def test_a_set_up_under_way_is_part_of_what_is_left_of_an_action() -> None:
    lab = bench()
    lab.start(lab.submit(does("a")))
    lab.wait(100.0)
    lab.submit(does("a"))
    problem = problem_of(lab.state, chosen(lab), lab.now)
    assert [task.duration_s for task in problem.tasks] == [WORK_S + CHANGE_S - 100.0, WORK_S]
    assert problem.setups == (SetupCosts((1,), (0.0,), ((0.0,),)),)


def due_lab(other: str) -> tuple[Driver, RunId, RunId]:
    """A long run that is due soon, and a short one of another user, or of the same."""
    lab = bench(0.0)
    long = lab.submit(does("a", 3000.0), user="ada", due_at=lab.now + 50 * MINUTE)
    return lab, long, lab.submit(does("b", 60.0), user=other)


def test_no_order_makes_a_run_late_for_another_of_the_same_user() -> None:
    """The short run first would be better for the mean of both ends."""
    lab, long, short = due_lab("ada")
    assert find_order(Planner(solver=Fixed(short, long)), lab) is None


def test_nobody_else_waits_for_a_due_date() -> None:
    lab, long, short = due_lab("bob")
    order = find_order(Planner(solver=Fixed(short, long)), lab)
    assert order is not None
    assert order.steps[0].run == short


def test_a_search_finds_the_order_in_which_due_dates_are_kept() -> None:
    """Three runs of one user; only in one order none is late, though it is not that of their lengths."""
    pytest.importorskip("ortools")
    lab = bench(0.0)
    dues = {600.0: 50, 1200.0: 40, 1800.0: 60}
    runs = [lab.submit(does("a", s), due_at=lab.now + due * MINUTE) for s, due in dues.items()]
    problem = problem_of(lab.state, chosen(lab), lab.now)
    assert set(problem.own_due_s) == {2400.0, 3000.0, 3600.0}
    found = solve(problem, 2.0)
    assert found is not None
    late = [
        task.run
        for task, start in zip(problem.tasks, found.starts_s, strict=True)
        if start + task.duration_s > dues[task.duration_s] * 60.0
    ]
    assert late == [], runs
