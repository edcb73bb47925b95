"""What a time window ties together: only motions up to the windowed step, and never the closing workflow."""

from __future__ import annotations

import random

from labos.core.ids import RunId
from labos.core.model import Plan, PlanStep, Window
from labos.planning.passage import find_late_step
from labos.planning.safety import Safety
from tests.support.bench import CELL, Driver, module, move, needs, plan, route, station, step, take, workcell

SOON = Window(1, 0.0, 60.0, "continue")
"""At most a minute after the second step of its run."""


def stand_in_each_others_way(measured: Plan) -> tuple[Driver, RunId]:
    """R1 stands at ``a``, and goes from there to ``dev``; its experiment throws its plate away by way of the
    gate. R2 stands in the gate, and wants to ``a``: so it has to go after R1 came to ``dev``, and before R1's
    plate leaves it."""
    lab = Driver(
        workcell(
            [module("arm"), module("dev")],
            [
                *(station("stack", "stack", 9), station("trash", "waste", 9)),
                *(station("a"), station("gate"), station("dev.nest")),
            ],
        )
    )
    lab.stock("stack", 2)
    closing = plan(step("arm", move("dev.nest", "gate")), step("arm", move("gate", "trash")), name="clear")
    first = lab.submit(measured, experiment=lab.experiment(closing=closing))
    second = lab.submit(route("stack", "gate", "a", "trash"))
    lab.step(first)
    lab.step(second)
    return lab, first


def measure(last: PlanStep) -> Plan:
    return plan(step("arm", take("stack", "a")), step("arm", move("a", "dev.nest")), last)


def test_a_window_at_the_end_of_a_run_does_not_hurry_its_closing_workflow() -> None:
    """The plate is measured in time where it stands. To clear it away has no hurry: somebody else may move
    before."""
    lab, _ = stand_in_each_others_way(measure(step("dev", needs("dev.nest"), windows=(SOON,))))
    assert find_late_step(lab.state, CELL, [], Safety()) is None
    lab.work(random.Random(1))
    assert lab.types().count("run.completed") == 2
    assert "window.breached" not in lab.types()


def test_a_motion_within_the_window_has_to_follow_at_once() -> None:
    """Here the plate itself has to leave for the gate in time, and whoever stands there cannot go before."""
    lab, run = stand_in_each_others_way(measure(step("arm", move("dev.nest", "gate"), windows=(SOON,))))
    assert find_late_step(lab.state, CELL, [], Safety()) == (run, 2)
