"""What planning makes of each case, beside the best that is known."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from pathlib import Path

import msgspec

from labos.planner.planner import Planner
from labos.planner.solve import solve
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from tests.benchmarks.figures import Figure, Report, times
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.check import Times, count_missed, faults, makespan
from tests.benchmarks.league.play import Outcome, Player
from tests.benchmarks.league.rules import problem_of

BEST = Path(__file__).with_name("best.json")
MUST, MUST_PLANNED = 1.10, 1.03
"""So many times the best known are to be reached without a planner, and with one."""


END_WEIGHT = 4
"""The league compares the end of all, so for the planner it counts so many times the mean of all ends."""

PLANNER_S = 1.0
"""So long the planner may look each time."""


class Known(msgspec.Struct, frozen=True):
    """The best schedule that is known of a case, with how many windows it misses and how it is known."""

    makespan_s: float
    missed: int
    how: str


class Score(msgspec.Struct, frozen=True):
    """What planning made of a case, checked; ``best`` is None where nobody has looked for it."""

    case: Case
    makespan_s: float
    missed: int
    best: Known | None

    @property
    def ratio(self) -> float:
        return self.makespan_s / self.best.makespan_s if self.best is not None else 1.0

    @property
    def too_many_missed(self) -> int:
        """How many windows more were missed than the best known schedule misses."""
        return max(0, self.missed - (self.best.missed if self.best is not None else 0))

    @property
    def is_good(self) -> bool:
        return self.ratio <= MUST and not self.too_many_missed


def read_best() -> dict[str, Known]:
    return msgspec.json.decode(BEST.read_bytes(), type=dict[str, Known]) if BEST.exists() else {}


def play_case(
    case: Case,
    *,
    planner: bool = False,
    seconds: float = PLANNER_S,
    together: bool = True,
    by_age: bool = False,
) -> Outcome:
    """``by_age``: the lab looks for no order of its own (``LABOS_ORDER=age``)."""
    plans = make_planner(seconds, searches=not by_age) if planner else None
    plans_with = Scheduler if by_age else make_searching_scheduler
    return Player(case.cell, case.stock, plans_with, planner=plans, together=together).play(case.works)


def make_planner(seconds: float, *, searches: bool = True) -> Planner:
    """A planner that finds the same orders on every computer. It knows that durations are exact, and that no
    other runs follow: the end of all counts more than the mean of all ends. ``searches``: so does its lab."""
    solver = partial(solve, counted=True)
    return Planner(seconds=seconds, solver=solver, exact=True, end_weight=END_WEIGHT, searches=searches)


def times_of(case: Case, outcome: Outcome) -> Times:
    """When each task was carried out. Works are told apart by their plans, in the order of submission."""
    problem = problem_of(case.cell, case.works)
    numbers = {(t.work, t.run, t.step): number for number, t in enumerate(problem.tasks)}
    found: Times = {}
    for placed in outcome.steps:
        work, run = outcome.works[placed.run]
        found[numbers[work, run, placed.step]] = (placed.start_s, placed.end_s)
    return found


def score(
    case: Case,
    *,
    planner: bool = False,
    seconds: float = PLANNER_S,
    together: bool = True,
    by_age: bool = False,
) -> Score:
    """Play a case. Raises AssertionError if what came of it cannot have happened."""
    outcome = play_case(case, planner=planner, seconds=seconds, together=together, by_age=by_age)
    problem, done = problem_of(case.cell, case.works), times_of(case, outcome)
    wrong = faults(problem, done)
    assert not wrong, f"{case.name}: {wrong[0]}"
    late = count_missed(problem, done)
    assert late == outcome.breaches, f"{case.name}: {late} windows missed, {outcome.breaches} told"
    return Score(case, makespan(done) - case.rest_s, late, read_best().get(case.key))


def figure(found: Score, planned: Score | None) -> Figure:
    best = found.best
    ours = f"{found.makespan_s:,.0f} s, {found.missed} missed"
    if planned is not None:
        ours += f"; planner {planned.makespan_s:,.0f} s ({times(planned.ratio)}), {planned.missed} missed"
    return Figure(
        found.case.name,
        ours,
        _limit(found.case, best),
        times(found.ratio) if best is not None else "–",
        times(MUST),
        found.is_good if best is not None else None,
    )


def _limit(case: Case, best: Known | None) -> str:
    published = f"published {case.published_s:,.0f} s; " if case.published_s else ""
    return published + (f"{best.makespan_s:,.0f} s, {best.missed} missed" if best is not None else "–")


def measure(*, quick: bool = False) -> Report:
    """With the planner too, if OR-tools are installed."""
    with_planner = find_spec("ortools") is not None and not quick
    scores = [
        (score(case), score(case, planner=True) if with_planner else None) for case in cases(quick=quick)
    ]
    notes = [
        "limit: the best schedule that is known, with the same rules; ours: without a planner, and with it",
        *(f"{s.case.name}: {s.best.how}" for s, _ in scores if s.best is not None and not s.case.best),
    ]
    for family in dict.fromkeys(s.case.family for s, _ in scores):
        for what, found in (
            ("online", [s for s, _ in scores]),
            ("with planner", [s for _, s in scores if s is not None]),
        ):
            ratios = [s.ratio for s in found if s.case.family == family]
            if ratios:
                mean = sum(ratios) / len(ratios)
                span = f"{min(ratios):.2f} to {max(ratios):.2f} × the best known, mean {mean:.3f}"
                notes.append(f"{family}, {what}: {span}")
    return Report([figure(found, planned) for found, planned in scores], notes)


def smoke() -> Report:
    return measure(quick=True)
