"""Finds out where labware is after a motion with an unknown end: the lab observes before it asks a person.

First the driver's own ``observe`` (the sensor of a hand or a nest), then the modules that can observe the
places in question (``observes`` in their config, or the observer that a station names). The kernel accepts an
observation like a person's report; if there is none, the question stays for a person.

The module itself is always asked first. While its hand is full, no other module is asked: only a person can
put down the labware in the hand, and observations before and after that do not fit together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import structlog

from labos.core.decide import Rejection
from labos.core.decide.observation import ObserveStation
from labos.core.effects import list_carried, list_places, name_hand
from labos.core.ids import ActionId, InterventionId, ModuleName, StationName, local, workcell_of
from labos.core.interventions import Intervention, InterventionRequested
from labos.core.modules import NodeJoined, NodeStateChanged
from labos.errors import BusError, LabosError, StoreError
from labos.runtime.ledger import Entry
from labos.runtime.observing import ObservingPart, read_contents, resolve_station

KINDS = ("unknown_action", "lost_labware")
"""Questions about motions with an unknown end."""

_log = structlog.get_logger(__name__)


class Reconciler(ObservingPart[InterventionId]):
    """Finds out for one kernel how motions with an unknown end have ended."""

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

    # -- the order of observers ---------------------------------------------------------------

    def _observe_again(self, module: ModuleName) -> None:
        """A module is back, or at rest: the module, or an observer of it, may answer now."""
        try:
            questions = list(self._kernel.state.interventions.open.values())
        except StoreError:
            return  # observed again when the log is open
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

    async def _ask(self, module: ModuleName, wanted: set[StationName], about: InterventionId) -> bool:
        """Let a module observe, and submit its observations to the kernel; returns whether it answered."""
        if self._observer.explain_cannot_ask(module):
            return False  # asked again when it is at rest
        try:
            sights = await self._observer.observe(module)
        except BusError as error:
            _log.info("nothing_seen", module=module, why=str(error))
            return False
        if self._are_all_empty(about, sights):
            return True  # it is at none of its possible places: a person has to find it
        for station, what in sights.items():
            if station in wanted and self._open(about) is not None:
                self._report_sight(module, station, what)
        return True

    def _are_all_empty(self, about: InterventionId, sights: Mapping[StationName, Any]) -> bool:
        """Whether all possible places of some labware are observed as empty at once. If these observations
        were submitted one by one, the labware would count as found at the last place."""
        question = self._open(about)
        wanted = self._list_possible_places(question) if question is not None else set()
        known = self._kernel.state.bench.labware.values()
        doubtful = [item.maybe for item in known if item.maybe and wanted.issuperset(item.maybe)]
        return any(all(sights.get(place) in (0, False) for place in maybe) for maybe in doubtful)

    def _report_sight(self, module: ModuleName, station: StationName, what: Any) -> None:
        state = self._kernel.state
        contents = read_contents(state, what) if station in state.bench.stations else None
        if contents is None:
            return  # its node cannot tell
        answer = self._kernel.submit(ObserveStation(station, local(module), *contents), str(module))
        if isinstance(answer, Rejection):
            _log.info("sight_not_taken", module=module, station=station, why=answer.message)
        else:
            self.observed += 1

    # -- the places to observe --------------------------------------------------------------

    def _open(self, name: InterventionId) -> Intervention | None:
        return self._kernel.state.interventions.open.get(name)

    def _list_possible_places(self, question: Intervention) -> set[StationName]:
        """The places where the labware of a question may be now."""
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
        """The other modules that can observe one of these places: as their own, or according to
        ``observes``."""
        found = []
        for name, module in self._kernel.state.modules.by_name.items():
            config = module.spec.config.get("config", module.spec.config)
            sees = config.get("observes", ()) if isinstance(config, Mapping) else ()
            observed = (
                {resolve_station(name, str(place)) for place in sees}
                if isinstance(sees, list | tuple)
                else set()
            )
            observed.update(self._kernel.state.bench.by_module.get(name, ()))
            if name != first and observed & wanted:
                found.append(name)
        return found
