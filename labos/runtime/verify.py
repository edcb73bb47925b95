"""Observes the result of a reported action before it is accepted: the observers of its stations are asked.

Their observations go to the kernel as ``VerifyAction``; the core decides. An observer that does not answer is
asked again for a while. After that the outcome of the action is unknown, and ``reconcile`` begins.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import structlog

from labos.core.actions import Action, ActionReported, ActionStatus
from labos.core.decide import Rejection
from labos.core.decide.observation import ObserveStation
from labos.core.decide.verification import VerifyAction, is_disturbed
from labos.core.ids import ActionId, ModuleName, StationName, local
from labos.core.labware import StationObserved
from labos.core.texts import cut
from labos.errors import BusError, LabosError
from labos.runtime.ledger import Entry
from labos.runtime.observing import ObservingPart, read_contents

PAUSE_S = 0.5

PATIENCE_S = 30.0
"""How long an observer that does not answer is asked."""

_log = structlog.get_logger(__name__)


class Verifier(ObservingPart[ActionId]):
    """Observes for one kernel whether reported actions had their effects."""

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            if isinstance(entry.event, ActionReported):
                self._observe_soon(entry.event.action)

    def on_reopened(self) -> None:
        for action in self._kernel.state.actions.open.values():
            if action.status == ActionStatus.REPORTED:
                self._observe_soon(action.id)

    # -- one action --------------------------------------------------------------------------

    async def _observe(self, name: ActionId) -> None:
        """Observe until nothing has changed during an observation, and every place was observed."""
        clock = self._kernel.clock
        give_up = clock.monotonic() + PATIENCE_S
        try:
            while (action := self._find_reported(name)) is not None:
                if is_disturbed(self._kernel.state, action):
                    give_up = clock.monotonic() + PATIENCE_S
                    await asyncio.sleep(PAUSE_S)
                    continue
                before = self._describe_places(action)
                observed, unseen = await self._list_observations(action)
                if self._find_reported(name) is None:
                    return
                if unseen and self._is_at_work(action):
                    give_up = clock.monotonic() + PATIENCE_S
                if self._describe_places(action) == before and (not unseen or clock.monotonic() >= give_up):
                    self._report_observation(action, observed, unseen)
                    return
                await asyncio.sleep(PAUSE_S)
        except LabosError as error:
            _log.info("look_given_up", action=name, why=str(error))  # observed again when the log is open

    async def _list_observations(self, action: Action) -> tuple[tuple[StationObserved, ...], str]:
        """The observations at the places where an action should have had its effect; and why not every place
        was observed."""
        state = self._kernel.state
        by_observer: dict[ModuleName, list[StationName]] = {}
        for place in action.looks:
            station = state.bench.stations.get(place)
            if station is not None and station.spec.watched:
                by_observer.setdefault(station.spec.observer, []).append(place)
        observed: list[StationObserved] = []
        unseen: list[str] = [] if by_observer else ["no observer is available there"]
        for observer, places in by_observer.items():
            why = self._observer.explain_cannot_ask(observer)
            sights: dict[StationName, Any] = {}
            try:
                sights = {} if why else await self._observer.observe(observer)
            except BusError as error:
                why = str(error).rstrip(".")
            for place in places:
                contents = read_contents(self._kernel.state, sights.get(place))
                if contents is not None:
                    observed.append(StationObserved(place, local(observer), *contents))
                else:
                    what = why or "without a reason"
                    unseen.append(f"{local(observer)} does not see what stands at {local(place)}: {what}")
        return tuple(observed), cut("; ".join(unseen))

    def _report_observation(self, action: Action, observed: tuple[StationObserved, ...], unseen: str) -> None:
        self.observed += 1
        self._submit(VerifyAction(action.id, observed, unseen), action)
        for sight in observed:
            station = self._kernel.state.bench.stations.get(sight.station)
            if station is None:
                continue  # the workcell was changed meanwhile
            stands = len(station.labware) + len(station.stock)
            strange = sight.labware and sight.labware not in station.labware
            if strange or sight.count not in (None, stands):
                # The station differs from the log, independent of this action.
                command = ObserveStation(sight.station, sight.by, sight.count, sight.labware)
                self._submit(command, action)

    def _submit(self, command: VerifyAction | ObserveStation, action: Action) -> None:
        answer = self._kernel.submit(command, str(action.module))
        if isinstance(answer, Rejection):
            _log.info("sight_not_taken", action=action.id, why=answer.message)

    # -- the places to observe --------------------------------------------------------------

    def _find_reported(self, name: ActionId) -> Action | None:
        action = self._kernel.state.actions.open.get(name)
        return action if action is not None and action.status == ActionStatus.REPORTED else None

    def _is_at_work(self, action: Action) -> bool:
        """Whether an observer does something else: its device may not be able to observe meanwhile."""
        state = self._kernel.state
        stations = [state.bench.stations[place] for place in action.looks if place in state.bench.stations]
        observers = {station.spec.observer for station in stations}
        modules = [state.modules.by_name[name] for name in observers if name in state.modules.by_name]
        return any(module.in_flight.keys() - {action.id} for module in modules)

    def _describe_places(self, action: Action) -> list[tuple[Any, ...]]:
        """The known facts about the observed places: if they change meanwhile, the observation is out of
        date."""
        bench = self._kernel.state.bench
        moving = is_disturbed(self._kernel.state, action)
        return [
            (place, moving, tuple(station.labware), len(station.stock), bench.uncertain_at.get(place, 0))
            for place in action.looks
            if (station := bench.stations.get(place)) is not None
        ]
