"""Looks for the best schedule of each case: ``python -m tests.benchmarks.league.best [NAME…]``.

Run by hand, with the extra ``plan``. It goes on from what ``best.json`` knows, or from what planning does,
and keeps what is better, with how it is known: proven, or found in so many seconds, with the bound below
which nothing can be.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import msgspec

from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.check import Times, count_missed, faults, makespan
from tests.benchmarks.league.rules import Problem, problem_of
from tests.benchmarks.league.score import BEST, Known, play_case, read_best, times_of

STEP_S = 5


def search(
    problem: Problem, hint: Times, seconds: float, step_s: float = STEP_S
) -> tuple[Times | None, float]:
    """The best schedule that keeps all windows found in so many seconds, and the least that any can take
    (infinite if none keeps all windows). In both, durations are rounded down to ``step_s``, and windows are
    rounded up."""
    from ortools.sat.python import cp_model

    model = cp_model.CpModel()
    horizon = int(makespan(hint) * 2 / step_s)
    tasks = problem.tasks
    length = [math.floor(task.duration_s / step_s + 1e-9) for task in tasks]
    begin = [model.new_int_var(0, horizon, f"s{number}") for number in range(len(tasks))]
    end = [start + takes for start, takes in zip(begin, length, strict=True)]
    whole = model.new_int_var(0, horizon, "makespan")
    using: dict[str, list[cp_model.IntervalVar]] = {}
    for number, task in enumerate(tasks):
        model.add(whole >= end[number])
        model.add_hint(begin[number], round(hint[number][0] / step_s))
        interval = model.new_fixed_size_interval_var(begin[number], length[number], f"i{number}")
        for name in task.takes:
            using.setdefault(name, []).append(interval)
        for before in task.after:
            model.add(begin[number] >= end[before])
        for clock in task.clocks:
            model.add(begin[number] >= end[clock.anchor] + math.floor(clock.wait_s / step_s + 1e-9))
            if clock.within_s is not None:
                model.add(begin[number] <= end[clock.anchor] + math.ceil(clock.within_s / step_s - 1e-9))
    for intervals in using.values():
        model.add_no_overlap(intervals)
    standing: dict[str, list[cp_model.IntervalVar]] = {}
    for number, stay in enumerate(problem.stays):
        size = model.new_int_var(0, horizon * 2, f"stay{number}")
        until = end[stay.last] if stay.last is not None else whole
        interval = model.new_interval_var(begin[stay.first], size, until, f"at{number}")
        standing.setdefault(stay.place, []).append(interval)
    for place, intervals in standing.items():
        room = problem.room[place]
        if room == 1:
            model.add_no_overlap(intervals)
        elif len(intervals) > room:
            model.add_cumulative(intervals, [1] * len(intervals), room)
    going: dict[str, list[cp_model.IntervalVar]] = {}
    for number, alone in enumerate(problem.alone):
        size = model.new_int_var(0, horizon, f"work{number}")
        interval = model.new_interval_var(begin[alone.first], size, end[alone.last], f"of{number}")
        going.setdefault(alone.place, []).append(interval)
    for intervals in going.values():
        model.add_no_overlap(intervals)
    for one, other in _alike(problem):
        model.add(begin[one] <= begin[other])
    model.minimize(whole)
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = seconds
    solver.parameters.num_workers = 2
    status = solver.solve(model)
    bound = solver.best_objective_bound * step_s
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return None, math.inf if status == cp_model.INFEASIBLE else bound
    starts = [solver.value(start) * step_s for start in begin]
    return {n: (float(s), s + tasks[n].duration_s) for n, s in enumerate(starts)}, bound


def _alike(problem: Problem) -> list[tuple[int, int]]:
    """First tasks of works that are alike: which of them goes first makes no difference."""
    works: dict[int, list[int]] = {}
    for number, task in enumerate(problem.tasks):
        works.setdefault(task.work, []).append(number)
    found: list[tuple[int, int]] = []
    last: dict[str, int] = {}
    for numbers in works.values():
        base = numbers[0]
        tasks = [problem.tasks[number] for number in numbers]
        look = repr(
            [
                (
                    t.duration_s,
                    sorted(t.takes),
                    [a - base for a in t.after],
                    [(c.anchor - base, c.wait_s, c.within_s) for c in t.clocks],
                    sorted(s.place for s in problem.stays if s.first == n),
                )
                for n, t in zip(numbers, tasks, strict=True)
            ]
        )
        if look in last:
            found.append((last[look], base))
        last[look] = base
    return found


def improve(case: Case, seconds: float) -> Known:
    """The best that is known of a case now."""
    problem = problem_of(case.cell, case.works)
    assert all(task.duration_s % STEP_S == 0 for task in problem.tasks)
    hint = times_of(case, play_case(case))
    before = read_best().get(case.key)
    found, bound = search(problem, hint, seconds)
    if found is None:
        return before or Known(
            makespan(hint) - case.rest_s,
            count_missed(problem, hint),
            f"online, nothing found in {seconds:.0f} s",
        )
    assert not faults(problem, found), faults(problem, found)
    assert not count_missed(problem, found)
    length, bound = makespan(found) - case.rest_s, bound - case.rest_s
    how = "proven" if length <= bound else f"found in {seconds:.0f} s, none is below {bound:,.0f} s"
    if before is not None and (before.makespan_s, "proven" not in before.how) <= (length, how != "proven"):
        return before
    return Known(length, 0, how)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.league.best", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="parts of names of cases; all if none")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to look for each")
    options = parser.parse_args()
    for case in cases():
        wanted = not options.names or any(name in case.name for name in options.names)
        if case.best or not wanted:
            continue
        now = improve(case, options.seconds)
        print(f"{case.name}: {now.makespan_s:,.0f} s, {now.how}", flush=True)
        Path(BEST).write_bytes(
            msgspec.json.format(msgspec.json.encode({**read_best(), case.key: now})) + b"\n"
        )


if __name__ == "__main__":
    main()
