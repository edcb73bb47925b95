"""What planning makes of each case, beside the best that is known."""

from __future__ import annotations

from pathlib import Path

import msgspec

from tests.benchmarks.figures import Figure, Report, times
from tests.benchmarks.league.cases import Case, cases
from tests.benchmarks.league.check import Times, faults, makespan, missed
from tests.benchmarks.league.play import Outcome, Player
from tests.benchmarks.league.rules import problem_of

BEST = Path(__file__).with_name("best.json")
MUST = 1.10


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
    def is_good(self) -> bool:
        return self.ratio <= MUST and self.missed <= (self.best.missed if self.best is not None else 0)


def known() -> dict[str, Known]:
    return msgspec.json.decode(BEST.read_bytes(), type=dict[str, Known]) if BEST.exists() else {}


def played(case: Case) -> Outcome:
    return Player(case.cell, case.stock).play(case.works)


def times_of(case: Case, outcome: Outcome) -> Times:
    """When each task was carried out. Works are told apart by their plans, in the order of submission."""
    problem = problem_of(case.cell, case.works)
    numbers = {(t.work, t.run, t.step): number for number, t in enumerate(problem.tasks)}
    found: Times = {}
    for placed in outcome.steps:
        work, run = outcome.works[placed.run]
        found[numbers[work, run, placed.step]] = (placed.start_s, placed.end_s)
    return found


def score(case: Case) -> Score:
    """Play a case. Raises AssertionError if what came of it cannot have happened."""
    outcome = played(case)
    problem, done = problem_of(case.cell, case.works), times_of(case, outcome)
    wrong = faults(problem, done)
    assert not wrong, f"{case.name}: {wrong[0]}"
    late = missed(problem, done)
    assert late == outcome.breaches, f"{case.name}: {late} windows missed, {outcome.breaches} told"
    return Score(case, makespan(done), late, known().get(case.key))


def figure(found: Score) -> Figure:
    best = found.best
    return Figure(
        found.case.name,
        f"{found.makespan_s:,.0f} s, {found.missed} missed",
        f"{best.makespan_s:,.0f} s, {best.missed} missed" if best is not None else "–",
        times(found.ratio) if best is not None else "–",
        times(MUST),
        found.is_good if best is not None else None,
    )


def measure(*, quick: bool = False) -> Report:
    scores = [score(case) for case in cases(quick=quick)]
    notes = [
        "limit: the best schedule that is known, with the same rules; ours: without a planner",
        *(f"{s.case.name}: {s.best.how}" for s in scores if s.best is not None and not s.case.best),
    ]
    families = dict.fromkeys(s.case.family for s in scores)
    for family in families:
        ratios = [s.ratio for s in scores if s.case.family == family]
        notes.append(f"{family}: {min(ratios):.2f} to {max(ratios):.2f} × the best known")
    return Report([figure(found) for found in scores], notes)


def smoke() -> Report:
    return measure(quick=True)
