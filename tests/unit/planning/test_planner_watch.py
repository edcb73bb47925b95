"""When a planner looks again: when runs come or go, when steps are late, and ever more seldom at night."""

from __future__ import annotations

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.suggestions import SuggestOrder
from labos.core.suggestions import Suggested
from labos.planner.problem import MOST_WINDOWED, choose_runs, problem_of
from labos.planner.watch import DRIFT_S, MOST_DOUBLINGS, CellWatch, list_waiting
from tests.support.bench import Driver
from tests.unit.planning.test_suggested import dose_and_read, make_lab, visit


def look(watch: CellWatch, lab: Driver, *, finds: bool = True) -> bool:
    """Whether it looks now; what it then suggests, if it ``finds`` anything, is that everybody starts at
    once."""
    waiting = list_waiting(lab.state, "cell")
    if not watch.is_due(lab.state, "cell", waiting, lab.now):
        return False
    steps = tuple(Suggested(run.id, 0, lab.now) for run in waiting)
    order = SuggestOrder("cell", "planner", lab.now + 10**15, steps) if finds else None
    watch.note(lab.state, "cell", waiting, order, lab.now)
    return True


def test_it_looks_when_runs_come_and_not_without_a_reason() -> None:
    lab, _ = make_lab(visit("dev"), visit("other"))
    watch = CellWatch()
    assert look(watch, lab)
    assert not look(watch, lab)
    lab.submit(visit("dev"))
    assert look(watch, lab)


def test_a_run_that_starts_as_planned_is_no_reason_and_one_that_goes_before_its_time_is() -> None:
    lab, (first, second) = make_lab(visit("dev"), visit("other"))
    watch, waiting = CellWatch(), list_waiting(lab.state, "cell")
    steps = tuple(Suggested(run.id, 0, lab.now + 10**12 * n) for n, run in enumerate(waiting))
    watch.note(lab.state, "cell", waiting, SuggestOrder("cell", "planner", 10**20, steps), lab.now)
    assert f"{first}#0" in lab.pump()
    assert not watch.is_due(lab.state, "cell", list_waiting(lab.state, "cell"), lab.now)
    lab.do(CancelRun(second, "ada"))
    assert watch.is_due(lab.state, "cell", list_waiting(lab.state, "cell"), lab.now)


def test_where_windows_are_kept_fewer_runs_are_looked_at() -> None:
    lab, _ = make_lab(*[dose_and_read()] * (MOST_WINDOWED + 5))
    waiting = list_waiting(lab.state, "cell")
    chosen = choose_runs(lab.state, "cell", waiting)
    assert len(chosen) == MOST_WINDOWED, "with the one inside"
    assert len(problem_of(lab.state, chosen, lab.now).line) == MOST_WINDOWED - 1


def test_what_stands_still_over_night_is_looked_at_ever_more_seldom() -> None:
    lab, _ = make_lab(visit("dev"), visit("other"))
    watch = CellWatch()
    looks = 0
    for _ in range(12 * 3600 // 30):
        looks += look(watch, lab)
        lab.wait(30.0)
    most = 2 + MOST_DOUBLINGS + 12 * 3600 / (DRIFT_S * 2**MOST_DOUBLINGS)
    assert 2 + MOST_DOUBLINGS <= looks <= most
    lab.submit(visit("dev"))
    assert look(watch, lab)


def test_a_search_that_found_nothing_is_repeated() -> None:
    """As on a busy computer."""
    lab, _ = make_lab(visit("dev"), visit("other"))
    watch = CellWatch()
    assert look(watch, lab, finds=False)
    assert not look(watch, lab)
    lab.wait(DRIFT_S + 1)
    assert look(watch, lab, finds=False)
    lab.wait(DRIFT_S + 1)
    assert not look(watch, lab), "it waits twice as long now"
    lab.wait(DRIFT_S)
    assert look(watch, lab)


def test_a_problem_has_the_steps_to_come_with_what_they_take() -> None:
    lab, (first, second) = make_lab(visit("dev"), visit("other"))
    problem = problem_of(lab.state, choose_runs(lab.state, "cell", list_waiting(lab.state, "cell")), lab.now)
    steps = [(task.run, task.step) for task in problem.tasks]
    assert steps[1:] == [(run, step) for run in (first, second) for step in range(4)]
    assert problem.tasks[0].runs, "the clock ticks"
    reaches = next(task for task in problem.tasks if (task.run, task.step) == (first, 1))
    assert [key.rpartition(".")[2].rpartition("/")[2] for key in reaches.takes] == ["arm", "dev"]
    assert reaches.duration_s == 10.0
    lab.wait(5.0)
    again = problem_of(lab.state, choose_runs(lab.state, "cell", list_waiting(lab.state, "cell")), lab.now)
    assert again.tasks[0].duration_s == problem.tasks[0].duration_s - 5.0
