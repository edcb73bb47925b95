"""A run that could start by all that the log says, and does not."""

from __future__ import annotations

from labos.services.waits import KEPT, KEPT_NS, list_reasons, list_unknown_reasons
from tests.support.bench import Driver, module, plan, step, workcell

CELL = workcell([module("mill"), module("saw")], [])


def test_what_does_not_start_while_something_moves_is_kept_back_by_the_labs_order() -> None:
    lab = Driver(CELL)
    first = lab.submit(plan(step("mill")))
    lab.start(first)
    second = lab.submit(plan(step("saw")))
    run, soon, later = lab.run(second), lab.now + KEPT_NS // 10, lab.now + 2 * KEPT_NS
    assert list_reasons(lab.state, run, lab.now) == []
    assert list_unknown_reasons(lab.state, run, soon) == [], "it is about to start"
    assert [reason.why for reason in list_unknown_reasons(lab.state, run, later)] == [KEPT]
    assert list_unknown_reasons(lab.state, lab.run(first), later) == [], "its step is under way"


def test_where_nothing_moves_nobody_is_kept_back() -> None:
    lab = Driver(CELL)
    run = lab.run(lab.submit(plan(step("saw"))))
    assert list_unknown_reasons(lab.state, run, lab.now + 2 * KEPT_NS) == []
