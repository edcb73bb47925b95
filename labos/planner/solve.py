"""Searches for a good schedule with OR-tools' CP-SAT (the extra ``plan``)."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec

import msgspec
from msgspec.structs import replace

from labos.errors import SystemFailed
from labos.planner.problem import SchedulingProblem

TIDY = 0.3
"""The part of the time in which each run is moved to an earlier end, after a schedule for the whole was
found."""


class Schedule(msgspec.Struct, frozen=True):
    """The start of each task (lab seconds from now), and the length of the whole. ``proven``: no schedule is
    better. ``cost`` is what the search made as small as it could."""

    starts_s: tuple[float, ...]
    makespan_s: float
    proven: bool
    cost: float = 0.0


def expect_solver() -> None:
    """Raises SystemFailed if OR-tools are not installed."""
    if find_spec("ortools") is None:
        raise SystemFailed(
            "The planner needs OR-tools, which are not installed.",
            remedy='Install them: python -m pip install "labos-sdl[plan]"',
        )


def solve(
    problem: SchedulingProblem,
    seconds: float,
    hint: Mapping[int, float] | None = None,
    *,
    counted: bool = False,
) -> Schedule | None:
    """The best schedule that is found in so many seconds of wall time; None if there is none. ``hint`` are
    the starts (lab seconds) in a known schedule, by task. One search begins there; a schedule that misses
    windows is looked for only if the known one misses some, or if no other is possible. With windows, this
    search stays near the known schedule. So if its result is not proven to be the best, a second search
    begins anew, each has half of the time, and the better result is kept. ``counted``: the seconds are
    measured by the work done, as on a computer that does nothing else; then the same problem gives the same
    schedule."""
    limit, found = seconds * (1 - TIDY), None
    windowed = any(lag.within_s is not None for task in problem.tasks for lag in task.lags)
    if hint:
        limit /= 1 + windowed
        found = _search(problem, limit, hint, counted=counted)
    if not hint or (windowed and (found is None or not found.proven)):
        anew = _search(problem, limit, {}, counted=counted)
        if found is None or (anew is not None and anew.cost < found.cost):
            found = anew
    if found is None:
        return None
    best = _search(problem, seconds * TIDY, dict(enumerate(found.starts_s)), counted=counted, tidy=True)
    if best is None:
        return found
    return replace(found, starts_s=best.starts_s, makespan_s=best.makespan_s)


def _search(
    problem: SchedulingProblem,
    limit: float,
    hint: Mapping[int, float],
    *,
    counted: bool,
    may_miss: bool = False,
    tidy: bool = False,
) -> Schedule | None:
    """One search that begins at ``hint``, if that is not empty. ``tidy``: each run's end counts too, their
    mean as much as the end of all, or less."""
    from ortools.sat.python import cp_model

    from labos.planner.constraints import ScheduleModel, misses_window

    keeps_all = bool(hint) and not may_miss and not misses_window(hint, problem.tasks)
    model = ScheduleModel(problem, hint, keeps_all=keeps_all)
    model.minimize_ends(tidy=tidy)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 2
    solver.parameters.interleave_search = counted
    if counted:
        solver.parameters.max_deterministic_time = limit
    else:
        solver.parameters.max_time_in_seconds = limit
    status = solver.solve(model.cp)
    if status == cp_model.INFEASIBLE and keeps_all:  # times are rounded: a window that was just kept is not
        return _search(problem, limit, hint, counted=counted, may_miss=True, tidy=tidy)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return None
    return Schedule(
        tuple(solver.value(start) * model.unit for start in model.begin),
        max(map(solver.value, model.end), default=0) * model.unit,
        status == cp_model.OPTIMAL,
        solver.objective_value,
    )
