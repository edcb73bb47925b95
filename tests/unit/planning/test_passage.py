"""What a time window ties together: only motions up to the windowed step, and never the closing workflow."""

from __future__ import annotations

import random

from labos.core.ids import RunId
from labos.core.model import Plan, PlanStep, Window
from labos.planning.passage import find_late_step
from labos.planning.safety import Safety
from tests.support.bench import (
    CELL,
    SECOND,
    Driver,
    module,
    move,
    needs,
    plan,
    route,
    station,
    step,
    take,
    workcell,
)

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


def chain(*machines: str) -> Plan:
    """A plate's way over machines: from each to the next within a minute. Its first clock starts at the first
    of them."""
    places = [f"{machine}.nest" for machine in machines]
    steps = [step("arm", take("stack", places[0]))]
    for number, (place, onward) in enumerate(zip(places, [*places[1:], "trash"], strict=True)):
        windows = (Window(2 * number - 1, 0.0, 60.0, "continue"),) if number else ()
        steps.append(step(place.partition(".")[0], needs(place), duration_s=30.0, windows=windows))
        steps.append(step("arm", move(place, onward), duration_s=5.0))
    return plan(*steps, name="-".join(machines))


def test_windows_of_which_each_starts_with_the_end_of_the_one_before_are_one_way() -> None:
    """R1 waits on its first machine, and its clocks run from there on until it is on m3. A plate that waits
    on m3, and has to go to m1, would be in its way, and R1 in that of the other: whoever goes on
    first would be late, if it had to go its way before the other moves."""
    names = ("m1", "m2", "m3")
    lab = Driver(
        workcell(
            [module("arm"), *map(module, names)],
            [
                *(station("stack", "stack", 9), station("trash", "waste", 9)),
                *(station(f"{name}.nest", claim=True) for name in names),
            ],
        )
    )
    lab.stock("stack", 2)
    first = lab.submit(chain("m1", "m2", "m3"))
    second = lab.submit(chain("m3", "m1"))
    lab.step(first)
    safety = Safety()
    assert safety.list_trapped(lab.state, lab.run(second), 0, only_asking=True) == [], (
        "both can come to their ends"
    )
    assert find_late_step(lab.state, CELL, [], safety) is None
    assert find_late_step(lab.state, CELL, [(second, 0)], safety) is not None
    assert lab.pump() == ["R1#1"]
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(second), lab.now)
    assert wait.until == lab.now + 4 * SECOND, "then m1 is free when R2 comes from m3"
    lab.now = wait.until
    assert lab.pump() == ["R2#0"], "once R1 goes on, the plan has R2 leave m3 in time"
    lab.work(random.Random(1))
    assert lab.types().count("run.completed") == 2
    assert "window.breached" not in lab.types()
