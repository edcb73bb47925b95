"""Older runs that were overtaken too often: younger ones stay out for them."""

from __future__ import annotations

from labos.core.ids import ModuleName, RunId
from labos.core.rules import examine
from labos.core.runs import RunState, find_holds, list_options
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning import booked
from labos.planning.obstacle import find_obstacle
from labos.planning.reservations import Reservations
from labos.planning.safety import Safety
from labos.planning.stuck import find_block
from labos.planning.waiting import WaitingRoom, list_modules


class Elders:
    """Finds the elder run for which another one waits outside."""

    def __init__(self, room: WaitingRoom, safety: Safety, reservations: Reservations) -> None:
        self._room = room
        self._safety = safety
        self._reservations = reservations
        self._hopeless: dict[tuple[RunId, str], bool] = {}
        self._known_at: int | None = None

    def find_protected(self, state: LabState, run: RunState, now: int) -> str:
        """The elder run that this run has to stay out for; empty if there is none."""
        plan = state.runs.plans[run.plan]
        mine: set[ModuleName] | None = None
        for elder in self._room.list_overtaken(state, plan.plan.workcell):
            if elder.position >= run.position or find_holds(elder):
                continue
            mine = mine or {step.module for step in plan.plan.steps}
            if mine.isdisjoint(list_modules(state, elder)):
                continue
            if any(self._is_next(state, option, now, bool(plan.windowed)) for option in list_options(elder)):
                return str(elder.id)
        return ""

    def _is_next(self, state: LabState, elder: RunState, now: int, windowed: bool) -> bool:
        """Whether a run would come in next, with the plan that it has here, if nobody else was let in."""
        first = state.runs.plans[elder.plan].starts[0]
        found = examine(state, elder, first, now)
        if isinstance(found, Wait) and found.blocked:
            return False  # it waits for a person: nobody has to wait with it
        if self._is_hopeless(state, elder):
            return False  # a later step of it does, or what it waits for no run inside moves away
        if state.bookings.open and booked.check_start(state, elder, first, now) is not None:
            return False  # it waits until somebody else's booking is over
        # It may wait for a time: who reserves nothing does not put it off.
        return windowed or self._reservations.check_start(state, elder, first, now, self._safety) is None

    def _is_hopeless(self, state: LabState, elder: RunState) -> bool:
        """Whether a run could not come to its end in an empty workcell either."""
        if self._known_at != state.position:
            self._known_at = state.position
            self._hopeless.clear()
        known = self._hopeless.get((elder.id, elder.plan))
        if known is None:
            known = find_block(state, elder) is not None or bool(find_obstacle(self._safety, state, elder))
            self._hopeless[elder.id, elder.plan] = known
        return known
