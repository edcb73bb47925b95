"""Where labware is that nobody saw arrive: the lab looks before it asks a person to.

The ladder: what the driver's own ``observe`` sees (a hand's sensor, a nest's), then the modules
that say that they see the places in question (``observes`` in their config, or as the observer that a
station names). What is seen goes to
the kernel like a person's word; what nobody sees stays the question that a person answers.

The module itself is asked first, always, and nothing more is asked while its hand is full: only a
person can put down what it holds, and places seen before and after that do not go together.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

import structlog

from labos.core.decide import Rejection
from labos.core.decide.observation import ObserveStation
from labos.core.effects import list_carried, list_places, name_hand
from labos.core.ids import ActionId, InterventionId, ModuleName, StationName, local, workcell_of
from labos.core.interventions import Intervention, InterventionRequested
from labos.core.modules import NodeJoined, NodeStateChanged
from labos.core.state import LabState
from labos.errors import BusError, LabosError, StoreError
from labos.runtime.ledger import Entry
from labos.runtime.observing import ObservingListener, read_contents, resolve_station

KINDS = ("unknown_action", "lost_labware")
"""Questions about motions that nobody saw end."""

_log = structlog.get_logger(__name__)


class Reconciler(ObservingListener[InterventionId]):
    """Finds out for one kernel how motions ended that nobody saw end."""

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            match entry.event:
                case InterventionRequested(kind=kind, intervention=name) if kind in KINDS:
                    self._observe_soon(name)
                case NodeJoined(module=module) | NodeStateChanged(module=module):
                    self._observe_again(module)
                case _:
                    pass

    def on_reopened(self) -> None:
        for question in self._kernel.state.interventions.open.values():
            if question.kind in KINDS:
                self._observe_soon(question.id)

    # -- the ladder --------------------------------------------------------------------------

    def _observe_again(self, module: ModuleName) -> None:
        """A module is back, or at rest: it, or what it sees, may answer now."""
        try:
            questions = list(self._kernel.state.interventions.open.values())
        except StoreError:
            return  # looked for when the log is open again
        for question in questions:
            if question.kind in KINDS and workcell_of(ModuleName(question.module)) == workcell_of(module):
                self._observe_soon(question.id)

    async def _observe(self, name: InterventionId) -> None:
        try:
            question = self._open(name)
            if question is None:
                return
            module = ModuleName(question.module)
            wanted = self._list_possible_places(question)
            if not wanted or not await self._ask(module, wanted, name):
                return
            for other in self._list_observers(wanted, module):
                question = self._open(name)
                if question is None or self._has_labware_in_hand(question):
                    return
                await self._ask(other, self._list_possible_places(question), name)
        except LabosError as error:
            _log.info("look_given_up", intervention=name, why=str(error))
        finally:
            if self._observing.get(name) is asyncio.current_task():
                del self._observing[name]

    async def _ask(self, module: ModuleName, wanted: set[StationName], about: InterventionId) -> bool:
        """Ask a module what it sees, and tell the kernel; whether it answered."""
        if self._observer.explain_cannot_ask(module):
            return False  # asked again when it is at rest
        try:
            sights = await self._observer.observe(module)
        except BusError as error:
            _log.info("nothing_seen", module=module, why=str(error))
            return False
        if self._are_all_empty(about, sights):
            return True  # it stands where nobody thinks: a person has to look
        for station, what in sights.items():
            if station in wanted and self._open(about) is not None:
                self._tell(module, station, what)
        return True

    def _are_all_empty(self, about: InterventionId, sights: Mapping[StationName, Any]) -> bool:
        """Whether every place where some labware may be is seen empty at once: told one by one, the
        last place would count as found."""
        question = self._open(about)
        wanted = self._list_possible_places(question) if question is not None else set()
        known = self._kernel.state.bench.labware.values()
        doubtful = [item.maybe for item in known if item.maybe and wanted.issuperset(item.maybe)]
        return any(all(sights.get(place) in (0, False) for place in maybe) for maybe in doubtful)

    def _tell(self, module: ModuleName, station: StationName, what: Any) -> None:
        command = read_sight(self._kernel.state, station, what, local(module))
        if command is None:
            return
        answer = self._kernel.submit(command, str(module))
        if isinstance(answer, Rejection):
            _log.info("sight_not_taken", module=module, station=station, why=answer.message)
        else:
            self.observed += 1

    # -- what to look for --------------------------------------------------------------------

    def _open(self, name: InterventionId) -> Intervention | None:
        return self._kernel.state.interventions.open.get(name)

    def _list_possible_places(self, question: Intervention) -> set[StationName]:
        """Where the labware of a question may be now."""
        state = self._kernel.state
        action = state.actions.open.get(ActionId(question.subject))
        effects = action.effects if action is not None else question.motions
        motions = list_carried(effects)
        wanted = list_places(effect for effect in motions if effect.stock)
        for effect in motions:
            labware = state.bench.labware.get(effect.labware)
            wanted |= set(labware.maybe) if labware is not None else set()
        takes = any(effect.stock for effect in motions)
        return wanted | ({name_hand(question.module)} if takes else set())

    def _has_labware_in_hand(self, question: Intervention) -> bool:
        hand = self._kernel.state.bench.stations.get(name_hand(question.module))
        return hand is not None and bool(hand.labware)

    def _list_observers(self, wanted: set[StationName], first: ModuleName) -> list[ModuleName]:
        """The other modules that see one of these places: their own, or said so by ``observes``."""
        found = []
        for name, module in self._kernel.state.modules.by_name.items():
            told = module.spec.config.get("config", module.spec.config)
            sees = told.get("observes", ()) if isinstance(told, Mapping) else ()
            mine = (
                {resolve_station(name, str(place)) for place in sees}
                if isinstance(sees, list | tuple)
                else set()
            )
            mine.update(self._kernel.state.bench.by_module.get(name, ()))
            if name != first and mine & wanted:
                found.append(name)
        return found


def read_sight(state: LabState, station: StationName, what: Any, by: str) -> ObserveStation | None:
    """What a node says of a station: whether something is there, how much, or its barcode; null if
    it cannot tell."""
    said = read_contents(state, what) if station in state.bench.stations else None
    return ObserveStation(station, by, *said) if said is not None else None
