"""Whether an outcome could have happened at all: said by somebody who knows nothing of planning.

What was carried out is held against the plans and the workcell: every step once and as long as it takes, in
its order; nothing taken by two at once; nowhere more labware than there is room for. Windows that were
missed are counted.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise

from tests.benchmarks.league.rules import Problem

Times = dict[int, tuple[float, float]]
"""From when to when each task was carried out (seconds), by its number."""

SLACK_S = 1e-6


def faults(problem: Problem, times: Times) -> list[str]:
    """What is wrong with a schedule, in sentences; nothing if it could have happened."""
    missing = [
        f"task {number} was not carried out" for number in range(len(problem.tasks)) if number not in times
    ]
    return missing or [
        *_order(problem, times),
        *_list_taken_twice(problem, times),
        *_list_crowded(problem, times),
        *_together(problem, times),
    ]


def count_missed(problem: Problem, times: Times) -> int:
    """How many windows a task started too late for."""
    return sum(
        clock.within_s is not None and times[number][0] > times[clock.anchor][1] + clock.within_s + SLACK_S
        for number, task in enumerate(problem.tasks)
        for clock in task.clocks
    )


def makespan(times: Times) -> float:
    """When the last task ends."""
    return max(end for _, end in times.values())


def _order(problem: Problem, times: Times) -> list[str]:
    found: list[str] = []
    for number, task in enumerate(problem.tasks):
        start, end = times[number]
        if start < -SLACK_S or abs(end - start - task.duration_s) > SLACK_S:
            found.append(f"task {number} takes {end - start} s from {start} s; it takes {task.duration_s} s")
        found += [
            f"task {number} starts before task {before} has ended"
            for before in task.after
            if times[before][1] > start + SLACK_S
        ]
        found += [
            f"task {number} does not wait {clock.wait_s} s after task {clock.anchor}"
            for clock in task.clocks
            if start < times[clock.anchor][1] + clock.wait_s - SLACK_S
        ]
    return found


def _list_taken_twice(problem: Problem, times: Times) -> list[str]:
    using: defaultdict[str, list[int]] = defaultdict(list)
    for number, task in enumerate(problem.tasks):
        for name in task.takes:
            using[name].append(number)
    found: list[str] = []
    for name, numbers in using.items():
        for one, other in pairwise(sorted(numbers, key=lambda number: times[number])):
            if times[one][1] > times[other][0] + SLACK_S:
                found.append(f"{name} is taken by tasks {one} and {other} at {times[other][0]} s")
    return found


def _list_crowded(problem: Problem, times: Times) -> list[str]:
    changes: defaultdict[str, list[tuple[float, int]]] = defaultdict(list)
    for stay in problem.stays:
        changes[stay.place].append((times[stay.first][0] + SLACK_S, 1))
        if stay.last is not None:
            changes[stay.place].append((times[stay.last][1], -1))
    found: list[str] = []
    for place, steps in changes.items():
        count = 0
        for at, change in sorted(steps):
            count += change
            if count > problem.room[place]:
                found.append(
                    f"{count} pieces of labware at {place} at {at} s; room for {problem.room[place]}"
                )
    return found


def _together(problem: Problem, times: Times) -> list[str]:
    found: list[str] = []
    for place in dict.fromkeys(one.place for one in problem.alone):
        spans = sorted((times[o.first][0], times[o.last][1]) for o in problem.alone if o.place == place)
        for (_, end), (begin, _) in pairwise(spans):
            if end > begin + SLACK_S:
                found.append(f"two works count on {place} at {begin} s, and neither knows when it is free")
    return found
