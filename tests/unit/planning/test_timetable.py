"""When steps run that have the bench to themselves."""

from __future__ import annotations

import msgspec

from labos.core.effects import Consumes
from labos.core.model import Plan, PlanStep, Window
from labos.planning.timetable import count_taken, make_timetable, sum_consumption
from tests.support.bench import plan, step, take


def make_lasting(what: PlanStep, seconds: float, *windows: Window) -> PlanStep:
    return msgspec.structs.replace(what, duration_s=seconds, windows=windows)


def starts(what: Plan) -> list[float]:
    return [slot.start_s for slot in make_timetable(what).slots]


def test_one_after_the_other() -> None:
    table = make_timetable(
        plan(make_lasting(step("a"), 5), make_lasting(step("b"), 7), make_lasting(step("a"), 1))
    )
    assert [(slot.start_s, slot.end_s, slot.held_by) for slot in table.slots] == [
        (0, 5, None),
        (5, 12, 0),
        (12, 13, 1),
    ]
    assert (table.critical, table.total_s) == ((0, 1, 2), 13)
    assert table.busy_s == {"cell/a": 6, "cell/b": 7}


def test_the_longer_of_two_branches_is_critical() -> None:
    table = make_timetable(
        plan(
            make_lasting(step("a"), 5),
            make_lasting(step("b"), 7),
            make_lasting(step("c", after=(0, 1)), 1),
            parallel=True,
        )
    )
    assert (table.critical, table.total_s) == ((1, 2), 8)


def test_a_module_does_one_thing_at_a_time_but_answers_questions_meanwhile() -> None:
    busy = [
        make_lasting(step("a"), 5),
        make_lasting(step("a"), 5),
        make_lasting(step("a", exclusive=False), 5),
    ]
    assert starts(plan(*busy, parallel=True)) == [0, 5, 0]


def test_waiting_counts_and_a_window_that_cannot_be_met_is_told() -> None:
    table = make_timetable(
        plan(
            make_lasting(step("a"), 5),
            make_lasting(step("b"), 7, Window(0, wait_s=60)),
            make_lasting(step("c"), 1, Window(0, within_s=30)),
        )
    )
    assert [slot.start_s for slot in table.slots] == [0, 65, 72]
    assert table.slots[2].late_s == 72 - 5 - 30
    assert table.critical == (0, 1, 2)


def test_steps_that_are_written_after_what_waits_for_them() -> None:
    assert starts(
        plan(make_lasting(step("a", after=(1,)), 1), make_lasting(step("b"), 4), parallel=True)
    ) == [4, 0]


def test_what_is_used_up() -> None:
    what = plan(
        step("arm", take("stack", "n")),
        step("dev", Consumes("foil", 1)),
        step("dev", Consumes("foil", 0.5), Consumes("ink", 2)),
    )
    assert sum_consumption(what) == {("cell/dev", "foil"): 1.5, ("cell/dev", "ink"): 2}
    assert count_taken(what) == {"cell/stack": 1}


def test_a_long_plan_is_laid_out() -> None:
    table = make_timetable(plan(*(make_lasting(step("a"), 1) for _ in range(2000))))
    assert (table.total_s, len(table.critical)) == (2000, 2000)


def test_windows_anchored_at_other_runs_are_not_known() -> None:
    other = Window(None, wait_s=60, of="grow", of_step="Incubate")
    assert starts(plan(make_lasting(step("a"), 5), make_lasting(step("b"), 1, other))) == [0, 5]
