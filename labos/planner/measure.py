"""Measures how good the result of a rehearsal is, in the lab's own order of importance.

Smaller is better, in this order: runs that do not reach their ends; windows that are missed; how late the
runs of campaigns with a deadline end; the ends of the classes of runs that go before others (urgent
campaigns, then each higher priority); how late a user's runs end after their due dates only because other
runs of the same user went before; and then the end of all runs together with the mean of their ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import msgspec

from labos.core.ids import RunId
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.urgency import is_urgent
from labos.planning.virtual import Play

GOES_ON = 1
"""The weight of a run's end in an experiment, compared with the end of all known runs: more runs will follow
it, which are not known yet. With a greater weight, experiments would go before runs that take longer by
themselves."""


class Score(msgspec.Struct, frozen=True, order=True):
    """How good a play was; smaller is better. All fields but the first two are in seconds of wall time.
    ``overdue_s`` is for all runs. ``first_s`` are the ends of each class that goes before others, the highest
    first. ``avoidable_s`` is how much less late the runs would be if each user's runs ended at the same
    times, but in the order of their due dates. ``cost_s`` is twice the weighted mean of the end of all
    runs, the end of each run of an experiment, and the mean of all ends. Twice, so that it is the sum of end
    and mean where both count the same; a mean, so that larger weights make no gain larger than it is."""

    stays: int
    missed: int
    overdue_s: float
    first_s: tuple[float, ...]
    avoidable_s: float
    cost_s: float

    def is_better_than(self, other: Score, gain: float, least_s: float = 0.0) -> bool:
        """Whether this is better, where times that differ by at most this part of the other's, or by at most
        so many seconds (of wall time), count as equal."""
        if (self.stays, self.missed) != (other.stays, other.missed):
            return (self.stays, self.missed) < (other.stays, other.missed)
        pairs = zip(self._list_times(), other._list_times(), strict=True)
        return next((mine < its for mine, its in pairs if abs(mine - its) > max(gain * its, least_s)), False)

    def _list_times(self) -> tuple[float, ...]:
        return self.overdue_s, *self.first_s, self.avoidable_s, self.cost_s


class Rated(msgspec.Struct, frozen=True):
    """The facts about a run before any play. ``rank``: 0 for runs of the lowest class. ``deadline`` is that
    of its campaign, ``due`` its own due date (UTC ns; 0: none)."""

    rank: int
    deadline: int
    more: bool
    user: str = ""
    due: int = 0


def rate_runs(state: LabState, runs: Iterable[RunState], now: int) -> dict[RunId, Rated]:
    """The class of each run, compared with the others."""
    found = {run.id: (run, (is_urgent(state, run, now), run.priority)) for run in runs}
    ranks = {known: rank for rank, known in enumerate(sorted({known for _, known in found.values()}))}
    return {
        name: Rated(ranks[known], _deadline_of(state, run), bool(run.experiment), run.user, run.due_at)
        for name, (run, known) in found.items()
    }


def judge(plays: list[Play], rated: Mapping[RunId, Rated], now: int, end_weight: int = 1) -> Score:
    """The score of plays of the same runs with different durations: runs without an end and missed windows of
    all plays are added, times are averaged. ``now`` is the start of the plays (UTC ns). The end of all
    counts ``end_weight`` times as much as the mean of all ends."""
    scores = [_judge_one(play, rated, now, end_weight) for play in plays]
    return Score(
        sum(score.stays for score in scores),
        sum(score.missed for score in scores),
        _compute_mean([score.overdue_s for score in scores]),
        tuple(_compute_mean(list(times)) for times in zip(*(score.first_s for score in scores), strict=True)),
        _compute_mean([score.avoidable_s for score in scores]),
        _compute_mean([score.cost_s for score in scores]),
    )


def _judge_one(play: Play, rated: Mapping[RunId, Rated], now: int, end_weight: int) -> Score:
    ends = {run: (end - now) / 1e9 for run, end in play.ends.items() if run in rated}
    classes = range(max((known.rank for known in rated.values()), default=0), 0, -1)
    first_s = tuple(sum(end for run, end in ends.items() if rated[run].rank == rank) for rank in classes)
    deadlines = {run: (rated[run].deadline - now) / 1e9 for run in ends if rated[run].deadline}
    overdue_s = sum(max(0.0, ends[run] - deadline) for run, deadline in deadlines.items())
    goes_on = [end for run, end in ends.items() if rated[run].more]
    over_s = max(ends.values(), default=0.0) + GOES_ON * sum(goes_on)
    weights = end_weight * (1 + GOES_ON * len(goes_on)) + 1
    cost_s = 2 * (end_weight * over_s + _compute_mean(list(ends.values()))) / weights
    avoidable_s = _find_avoidable(ends, rated, now)
    stays = sum(run in rated for run in play.stays)
    return Score(stays, play.missed, overdue_s, first_s, avoidable_s, cost_s)


def _find_avoidable(ends: Mapping[RunId, float], rated: Mapping[RunId, Rated], now: int) -> float:
    """Due dates order the runs of one user and rank. So the score is not how late these runs are, but how
    much less late they would be in the order of their dates: no user gets more of the lab through early
    dates."""
    groups: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for run, end in ends.items():
        known = rated[run]
        due_s = (known.due - now) / 1e9 if known.due else float("inf")
        groups.setdefault((known.user, known.rank), []).append((due_s, end))
    return sum(map(_count_avoidable, groups.values()))


def _count_avoidable(runs: list[tuple[float, float]]) -> float:
    late = sum(max(0.0, end - due) for due, end in runs)
    dates, ends = sorted(due for due, _ in runs), sorted(end for _, end in runs)
    least = sum(max(0.0, end - due) for due, end in zip(dates, ends, strict=True))
    return max(0.0, late - least)


def _deadline_of(state: LabState, run: RunState) -> int:
    campaign = state.campaigns.open.get(run.campaign)
    return campaign.terms.deadline if campaign is not None else 0


def _compute_mean(numbers: list[float]) -> float:
    return sum(numbers) / len(numbers) if numbers else 0.0
