"""The order in which steps and waiting runs are tried.

The rules are listed in ``docs/scheduling.md`` (*Which step goes first*).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from labos.core.ids import RunId
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.due import UNDATED, DueDates
from labos.planning.own_order import group_equally_old
from labos.planning.patience import OvertakeCounts
from labos.planning.reservations import Reservations
from labos.planning.setup_order import SetupOrder
from labos.planning.suggested import LAST, Adviser
from labos.planning.urgency import is_urgent
from labos.planning.work_behind import WorkBehind


class ReadyStart(msgspec.Struct, frozen=True):
    """Something that may start: a step of a started run, or a bundle of waiting runs, with its first run."""

    run: RunState
    step: int
    bundle: str = ""


class Rank(msgspec.Struct, frozen=True, order=True):
    """The start with the lowest rank goes first. A field decides only if all fields before it are equal."""

    deadline: int
    is_patient: bool
    is_calm: bool
    low_priority: int
    advised: int
    is_waiting: bool
    share_used: tuple[float, float]
    due: float
    change: int
    position: int
    work_behind: float


class Ranking:
    """Ranks what may start. Computed values are valid for one turn (``forget``)."""

    def __init__(self, reservations: Reservations, adviser: Adviser) -> None:
        self.behind = WorkBehind()
        self._reservations = reservations
        self._adviser = adviser
        self._due_dates = DueDates()
        self._setup_order = SetupOrder()
        self._shares: dict[str, tuple[float, float]] = {}

    def forget(self) -> None:
        """Drop the computed values: a new turn begins."""
        self._shares.clear()
        self._due_dates.forget()
        self._setup_order.forget()

    def sort(
        self, state: LabState, starts: list[ReadyStart], patience: OvertakeCounts, now: int
    ) -> list[ReadyStart]:
        """What may start, in the order in which it is tried."""
        if len(starts) < 2:
            return starts
        turns = self._swap_turns(state, [start for start in starts if not start.bundle])
        return sorted(starts, key=lambda start: self._rank(state, start, patience, now, turns))

    def _swap_turns(self, state: LabState, starts: Sequence[ReadyStart]) -> dict[RunId, int]:
        """The positions that equal runs inside take instead of their own. It makes no difference which of
        several equally old runs of one plan ends first. So the one with the most work left takes the position
        of the oldest."""
        runs = {start.run.id: start.run for start in starts}
        turns: dict[RunId, int] = {}
        if len(runs) < 2:
            return turns
        behind: dict[RunId, float] = {}
        for start in starts:
            left = self.behind.measure(state, start.run.plan, start.step)
            behind[start.run.id] = max(left, behind.get(start.run.id, 0.0))
        for group in group_equally_old(state, runs.values()):
            alike: dict[str, list[RunState]] = {}
            for run in group:
                alike.setdefault(run.plan, []).append(run)
            for members in alike.values():
                by_age = sorted(run.position for run in members)
                by_work = sorted(members, key=lambda run: (-behind[run.id], run.position))
                turns.update(zip([run.id for run in by_work], by_age, strict=True))
        return turns

    def find_first(self, state: LabState, runs: Sequence[RunState], now: int) -> RunState | None:
        """The run that goes first among waiting runs with the same needs and priority. Among equal runs it is
        the oldest. None if there are no runs."""
        groups = [self._rank_group(state, run, now) for run in runs]
        least = min(groups, default=None)
        first = [run for run, group in zip(runs, groups, strict=True) if group == least]
        if len(first) < 2:
            return first[0] if first else None
        return min(first, key=lambda run: (self._rank_own(state, run, None), run.position))

    def rank_waiting(self, state: LabState, run: RunState, now: int) -> tuple[object, ...]:
        """The rank of a waiting run among those with the same needs and priority, without its age. The lowest
        rank goes first."""
        return *self._rank_group(state, run, now), *self._rank_own(state, run, None)

    def _rank_group(self, state: LabState, run: RunState, now: int) -> tuple[bool, float, float]:
        """Runs of urgent campaigns (False) go first. Then the used share of the group decides, then that of
        the user within it."""
        return not is_urgent(state, run, now), *self._find_share_used(state, now, run.user)

    def _rank(
        self,
        state: LabState,
        start: ReadyStart,
        patience: OvertakeCounts,
        now: int,
        turns: Mapping[RunId, int],
    ) -> Rank:
        run, waits = start.run, bool(start.bundle)
        step = None if waits else start.step
        deadline = self._reservations.find_latest_start(state, run, step, now)
        behind = 0.0 if step is None else -self.behind.measure(state, run.plan, step)
        if not waits and patience.is_over(run.id):
            nobody = (0.0, 0.0)
            return Rank(deadline, False, False, 0, 0, False, nobody, UNDATED, 0, run.position, behind)
        advised = self._adviser.start_of(state, run, step, now) if self._adviser.has_orders(state) else LAST
        due, change = self._rank_own(state, run, step)
        return Rank(
            deadline,
            True,
            not is_urgent(state, run, now),
            -run.priority,
            advised,
            waits,
            self._find_share_used(state, now, run.user),
            due,
            change,
            turns.get(run.id, run.position),
            behind,
        )

    def _find_share_used(self, state: LabState, now: int, user: str) -> tuple[float, float]:
        """The used lab time of a user's group, and of the user, each divided by the weight."""
        share = self._shares.get(user)
        if share is None:
            share = self._shares[user] = state.shares.find_share_used(user, now)
        return share

    def _rank_own(self, state: LabState, run: RunState, step: int | None) -> tuple[float, int]:
        """What decides before age among the runs of one user: the due date, then the set-up time."""
        return self._due_dates.rank(state, run), self._setup_order.rank(state, run, step)
