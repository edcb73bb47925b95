"""What the league says can be trusted: the checker finds faults, and the best known is not beaten by luck."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.league import slab
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.check import Times, count_missed, faults, makespan
from tests.benchmarks.league.play import Player
from tests.benchmarks.league.rules import Problem, problem_of
from tests.benchmarks.league.score import Score, play_case, read_best, score, times_of
from tests.benchmarks.league.table import Keeper, row, verdicts

SMALL = (
    "one arm, 8 plates, within 120 s",
    "2 PCR + 1 picker × 3",
    "4 jobs on 4 machines, seed 0",
    "Gu2016 × 1",
)


def small(name: str) -> Case:
    return next(case for case in cases() if case.name == name)


@pytest.fixture(scope="module")
def played_once() -> tuple[Problem, Times]:
    case = small("2 PCR + 1 picker × 3")
    return problem_of(case.cell, case.works), times_of(case, play_case(case))


@pytest.mark.parametrize("name", SMALL)
def test_what_planning_does_could_have_happened_and_is_not_better_than_what_was_proven(name: str) -> None:
    found = score(small(name))
    assert found.best is not None
    assert found.best.how == "proven"
    assert found.makespan_s >= found.best.makespan_s
    assert found.missed == 0


def test_one_arm_does_as_well_as_was_proven_possible() -> None:
    assert score(small("one arm, 8 plates, within 120 s")).ratio == 1.0


@pytest.mark.slow
def test_windows_in_chains_of_three_are_near_the_best_known() -> None:
    found = score(small("48 windows in chains of three, seed 0"))
    assert found.ratio <= 1.14
    assert found.missed == 0


def test_every_case_has_a_best_known_schedule() -> None:
    assert {case.key for case in cases()} == set(read_best())


def test_what_is_known_of_what_others_have_published_is_not_worse() -> None:
    best = read_best()
    for case in cases():
        if case.published_s:
            assert best[case.key].makespan_s <= case.published_s
            assert best[case.key].missed == 0


def test_an_operation_takes_its_place_until_a_minute_after_its_end() -> None:
    """Two steps each: the place in the bank is free again only when the second has ended."""
    instance = slab.INSTANCES[-1]
    works = slab.works_of(instance)
    problem = problem_of(slab.cell_of(instance), works)
    keys = [step.key for work in works for step in work.runs[0].plan.steps]
    stays = {stay.first: stay for stay in problem.stays if stay.last is not None}
    assert len(problem.tasks) == 2 * sum(len(job.operations) for job in instance.jobs)
    for number, task in enumerate(problem.tasks):
        if not keys[number].startswith("operation"):
            continue
        kind, minutes = instance.jobs[task.work].operations[int(keys[number].split()[1]) - 1]
        last = stays[number].last
        assert last is not None
        assert (stays[number].place, task.duration_s) == (f"cell/{kind}_bank", minutes * 60.0)
        assert (problem.tasks[last].after, problem.tasks[last].duration_s) == ((number,), 60.0)
    assert {place: problem.room[f"cell/{place}_bank"] for place in instance.instruments} == dict(
        instance.instruments
    )


def test_a_step_that_was_not_carried_out_is_a_fault(played_once: tuple[Problem, Times]) -> None:
    problem, times = played_once
    left = {number: when for number, when in times.items() if number != 3}
    assert faults(problem, times) == []
    assert faults(problem, left) == ["task 3 was not carried out"]


def test_a_step_too_soon_is_a_fault(played_once: tuple[Problem, Times]) -> None:
    problem, times = played_once
    for number, task in enumerate(problem.tasks):
        if task.after:
            before = times[task.after[0]][1]
            moved = {**times, number: (before - 1.0, before - 1.0 + task.duration_s)}
            assert f"task {number} starts before task {task.after[0]} has ended" in faults(problem, moved)


def test_a_step_that_is_cut_short_is_a_fault(played_once: tuple[Problem, Times]) -> None:
    problem, times = played_once
    start, end = times[2]
    assert any(text.startswith("task 2 takes") for text in faults(problem, {**times, 2: (start, end - 1.0)}))


def test_all_at_once_is_a_fault_of_modules_and_places(played_once: tuple[Problem, Times]) -> None:
    """Each work as if it had the workcell to itself, all of them from the start."""
    problem, _ = played_once
    ends: dict[int, float] = {}
    alone: Times = {}
    for number, task in enumerate(problem.tasks):
        start = ends.get(task.work, 0.0)
        alone[number] = (start, start + task.duration_s)
        ends[task.work] = start + task.duration_s
    found = faults(problem, alone)
    assert any("rpl/sciclops is taken by" in text for text in found)
    assert any("pieces of labware at rpl/ot2_pcr_alpha.deck1_cooler" in text for text in found)
    assert not any("starts before" in text for text in found)


def test_two_that_wait_for_what_nobody_has_submitted_are_a_fault() -> None:
    """One colour picker's plate is parked where the other's run would end."""
    case = small("8 PCR + 2 picker × 5")
    problem = problem_of(case.cell, case.works)
    assert [one.place for one in problem.alone] == ["rpl/wc.parking"] * 2
    together = {number: (0.0, task.duration_s) for number, task in enumerate(problem.tasks)}
    wanted = "two works count on rpl/wc.parking at 0.0 s, and neither knows when it is free"
    assert wanted in faults(problem, together)


def test_windows_are_counted_by_the_checker_itself() -> None:
    case = small("one arm, 8 plates, within 120 s")
    problem, times = problem_of(case.cell, case.works), times_of(case, play_case(case))
    late = {n: (a + 500.0, b + 500.0) if n % 5 > 1 else (a, b) for n, (a, b) in times.items()}
    assert count_missed(problem, times) == 0
    assert count_missed(problem, late) == 8
    assert makespan(late) == makespan(times) + 500.0


def test_one_arm_keeps_its_windows_where_durations_stray() -> None:
    """A clock is not started so soon that a reader that ends late makes the follower late."""
    case = small("one arm, 8 plates, within 120 s")
    for seed in range(4):
        assert Player(case.cell, case.stock, jitter=0.1, seed=seed).play(case.works).breaches == 0


def test_the_table_says_side_by_side_what_is_known_and_what_is_reached() -> None:
    found = score(small("Gu2016 × 1"))
    late = Score(found.case, found.makespan_s, 1, found.best)
    assert row(found, None).startswith("| S-LAB | Gu2016 × 1 | 5,220 | 5,220 | ")
    assert "(1 missed)" in row(found, late)
    said = list(verdicts([found], [late]))
    assert said[0].startswith("S-LAB, online: 1.10 × reached (at worst 1.0")
    assert said[1].startswith("S-LAB, with planner: 1.03 × not reached")


def test_a_table_that_was_interrupted_goes_on_with_what_it_kept(tmp_path: Path) -> None:
    case, file = small("4 jobs on 4 machines, seed 0"), tmp_path / "kept"
    found = Keeper(file, 1.0).score(case, planner=False)
    assert file.read_text().count("\n") == 1
    file.write_text(file.read_text().replace(str(found.makespan_s), "1234.0"))
    assert Keeper(file, 1.0).score(case, planner=False).makespan_s == 1234.0, "it is not played again"
