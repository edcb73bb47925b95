"""Runs in a rehearsal: which steps they have to start, and by when."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from labos.core.model import Plan, Window
from labos.core.runs import IN_FLIGHT, PENDING, SETTLED, RunState, find_anchor, list_statuses
from labos.core.state import LabState
from labos.core.waits import list_party
from labos.planning.forecast import (
    find_deadline,
    find_earliest_start,
    find_latest_starts,
    find_pending_before,
    find_usual_time,
    is_pending,
)

Step = tuple[str, int]
"""A run and one of its steps."""

Who = tuple[str, int | None]
"""A run with one of its steps, or with None: for labware that it put down before, or a module that it
holds."""

NOBODY: Who = ("", None)
"""No run that could wait or make way: for labware of no run, or a module that is down."""


def find_step(who: Who) -> Step | None:
    """The run and step of ``who``; None if it names no step."""
    name, index = who
    return (name, index) if index is not None else None


FAR = 2**62
"""A time that never comes (UTC ns)."""


def find_chained(run: RunState, plan: Plan, first: Iterable[int]) -> set[int]:
    """The pending steps that must follow in time once the steps ``first`` have started. These are the steps
    whose clocks they start, and all steps that have to be done before those. Clocks that already run, and
    clocks that these steps start in turn, count as well."""
    found: set[int] = set()
    begun = {index for index, s in enumerate(run.steps) if s.status == IN_FLIGHT or s.ended_at is not None}
    begun.update(first)
    growing = True
    while growing:
        growing = False
        for index, step in enumerate(plan.steps):
            if index in found | begun or not is_pending(run, index) or run.is_breached(index):
                continue
            if any(w.within_s is not None and _starts_clock(run, w, begun | found) for w in step.windows):
                found.update(
                    before for before in find_pending_before(run, plan, index) if before not in begun
                )
                growing = True
    return found


def _starts_clock(run: RunState, window: Window, begun: set[int]) -> bool:
    """Whether a window's clock runs or will run, if these steps have begun. A clock that a step of another
    run starts has to run already."""
    return find_anchor(run, window) is not None if window.of else window.anchor in begun


class Player:
    """A run that continues in a rehearsal. ``left`` are the steps that have to start before the rehearsal is
    over. ``ends`` are the expected ends of steps that have started (UTC ns). ``free``: it may also start
    other steps."""

    def __init__(
        self, state: LabState, run: RunState, ends: dict[int, int], *, free: bool, first: Iterable[int] = ()
    ) -> None:
        self.run, self.plan = run, state.runs.plan_of(run)
        self.name, self.party = str(run.id), list_party(run)
        self.steps = list_statuses(self.plan, run)
        self.ends = ends
        self.left = find_chained(run, self.plan, first) | {i for i in first if is_pending(run, i)}
        self._open = [index for index, status in enumerate(self.steps) if status == PENDING]
        self.free = free
        self.due: dict[int, int] = {}
        self.latest: dict[int, int] = {}
        self._state = state
        for index in state.runs.plans[run.plan].windowed:
            if is_pending(run, index) and not run.is_breached(index):
                self._set_due(index)

    def list_turns(self) -> Iterator[int]:
        """The pending steps whose predecessors are done. If the run is not ``free``, only those in
        ``left``."""
        for index in list(self._open):
            if not self.free and index not in self.left:
                continue
            for before in self.plan.steps[index].after:
                if self.steps[before] not in SETTLED:
                    break
            else:
                yield index

    def may_start_at(self, index: int) -> int:
        """The earliest time at which its windows let a step start (UTC ns; 0: at once)."""
        return find_earliest_start(self._state, self.run, index, self.ends)

    def start(self, index: int, end: int) -> None:
        self.steps[index] = IN_FLIGHT
        self._open.remove(index)
        self.ends[index] = end
        self.left.discard(index)
        for follower in self._state.runs.plans[self.run.plan].windowed:
            if self.steps[follower] != PENDING or self.run.is_breached(follower):
                continue
            windows = self.plan.steps[follower].windows
            if any(not w.of and w.anchor == index and w.within_s is not None for w in windows):
                before = find_pending_before(self.run, self.plan, follower)
                self.left.update(i for i in before if self.steps[i] == PENDING)
                self._set_due(follower)

    def _set_due(self, index: int) -> None:
        """Compute by when a step, and those before it, have to start."""
        due = find_deadline(self._state, self.run, index, self.ends)
        if due is None:
            return
        self.due[index] = due
        chain = find_pending_before(self.run, self.plan, index)
        latest = find_latest_starts(self._state, self.plan, chain, due, find_usual_time)
        for step_before, at in latest.items():
            self.latest[step_before] = min(at, self.latest.get(step_before, FAR))
