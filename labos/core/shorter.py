"""A log that has lost its end: the evidence for it, and the stations that a person has to report.

The events after the end of the log are lost. Until a person has checked the whole bench, no action starts.
Every station has to be reported; a station at which no unknown action was at work may be confirmed instead.
"""

from __future__ import annotations

import msgspec

from labos.core.actions import ActionDiscovered
from labos.core.effects import Move, Needs, list_places
from labos.core.ids import ActionId, LabwareId, StationName, workcell_of
from labos.core.registry import Event, event
from labos.core.words import Words

STATIONS_PER_EVENT = 400


@event("log.found_shorter")
class LogFoundShorter(Event, frozen=True):
    """There is evidence that the log has lost its end. ``evidence`` names the source (a module, a checkpoint
    …), and ``knows`` describes in words what it knows. ``known`` is the highest position that it knows (0:
    none named); ``ended`` is where this log ended when the loss was found. If a ``workcell`` is named,
    labware there may stand elsewhere, because one of its modules has forgotten its actions after that end."""

    evidence: str
    knows: str
    known: int
    ended: int
    workcell: str = ""


@event("log.stations_checked")
class StationsChecked(Event, frozen=True):
    """A person checked these stations and reported what stands there, or confirmed the record. The resulting
    changes are events before this one."""

    stations: tuple[StationName, ...]
    by: str


@event("log.bench_compared")
class BenchCompared(Event, frozen=True):
    """The comparison with the bench is complete: every station was reported, and the log continues from these
    reports."""

    by: str
    note: Words = ""


class Shorter(msgspec.Struct):
    """``since`` is the time at which the log was found shorter (UTC ns; 0: it was not). ``known`` is the
    highest known position, ``ended`` the end of this log, and ``evidence`` the sources with their knowledge.
    ``touched`` are the stations at which an action was at work that is not in the log. ``cells`` are the
    workcells in which a module did something unknown: all their stations count as touched. ``displaced`` is
    labware that such an action may have moved. ``said`` are the stations that a person has reported since.
    ``actions`` are the discovered actions. ``answered`` is the evidence of rounds that are over: a node that
    was away reports it again."""

    since: int = 0
    known: int = 0
    ended: int = 0
    evidence: dict[str, str] = {}
    touched: dict[StationName, bool] = {}
    cells: dict[str, bool] = {}
    displaced: dict[LabwareId, bool] = {}
    said: dict[StationName, bool] = {}
    actions: dict[ActionId, ActionDiscovered] = {}
    answered: dict[str, str] = {}

    def is_touched(self, station: StationName) -> bool:
        """Whether an action that is not in the log may have been at work at a station."""
        return station in self.touched or workcell_of(station) in self.cells


def fold_log_found_shorter(shorter: Shorter, event: LogFoundShorter, at: int) -> None:
    if not shorter.since:
        shorter.since, shorter.ended = at, event.ended
    shorter.known = max(shorter.known, event.known)
    shorter.evidence[event.evidence] = event.knows
    if event.workcell:
        _doubt_cell(shorter, event.workcell)


def fold_action_discovered(shorter: Shorter, event: ActionDiscovered, at: int) -> None:
    """In logs of earlier versions, actions were discovered without a round."""
    if not shorter.since:
        return
    shorter.actions[event.action] = event
    if event.effects is None:
        _doubt_cell(shorter, workcell_of(event.module))
        return
    for place in list_places(event.effects):
        shorter.touched[place] = True
        shorter.said.pop(place, None)
    for effect in event.effects:
        if isinstance(effect, Move | Needs) and effect.labware:
            shorter.displaced[effect.labware] = True


def _doubt_cell(shorter: Shorter, cell: str) -> None:
    shorter.cells[cell] = True
    for station in [name for name in shorter.said if workcell_of(name) == cell]:
        del shorter.said[station]


def fold_stations_checked(shorter: Shorter, event: StationsChecked, at: int) -> None:
    shorter.said.update(dict.fromkeys(event.stations, True))


def fold_bench_compared(shorter: Shorter, event: BenchCompared, at: int) -> None:
    fresh = Shorter(answered=shorter.answered | shorter.evidence)
    for field in fresh.__struct_fields__:
        setattr(shorter, field, getattr(fresh, field))
