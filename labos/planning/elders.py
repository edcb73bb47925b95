"""Elders: waiting runs that were overtaken too often. Younger runs wait outside until they have started."""

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
    """Finds the elder run for which another run waits outside."""

    def __init__(self, room: WaitingRoom, safety: Safety, reservations: Reservations) -> None:
        self._room = room
        self._safety = safety
        self._reservations = reservations
        self._able: dict[tuple[RunId, str], bool] = {}
        self._known_at: tuple[int, int] | None = None

    def find_protected(self, state: LabState, run: RunState, now: int) -> str:
        """The elder run for which this run has to wait outside; empty if there is none."""
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
        """Whether an elder run could start next with this plan, if no other run started. ``windowed``: the
        run that waits for it has windows."""
        first = state.runs.plans[elder.plan].starts[0]
        if not self._is_able(state, elder, first, now):
            return False
        if state.bookings.open and booked.check_start(state, elder, first, now) is not None:
            return False  # it waits until a booking of others is over
        # The elder may wait for a reservation to end. A run without windows reserves nothing, so its start
        # does not delay the elder.
        return windowed or self._reservations.check_start(state, elder, first, now) is None

    def _is_able(self, state: LabState, elder: RunState, first: int, now: int) -> bool:
        """Whether neither the first step of an elder run nor a later one is blocked, and no obstacle stays in
        its way after all other runs have moved. Computed once for each position of the log and time."""
        if self._known_at != (state.position, now):
            self._known_at = state.position, now
            self._able.clear()
        known = self._able.get((elder.id, elder.plan))
        if known is None:
            found = examine(state, elder, first, now)
            waits_for_person = isinstance(found, Wait) and found.blocked
            known = self._able[elder.id, elder.plan] = not (
                waits_for_person or find_block(state, elder) or find_obstacle(self._safety, state, elder)
            )
        return known
