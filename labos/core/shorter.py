"""A log that is shorter than others know: who knows more, and what has to be said of the bench since.

What happened behind the end of the log nobody can tell. Until a person has been round the bench, nothing is
started: every station has to be said, or, where nothing is known to have been at work, confirmed.
"""

from __future__ import annotations

import msgspec

from labos.core.actions import ActionDiscovered
from labos.core.effects import AnyEffect, Move, Needs, list_places
from labos.core.ids import ActionId, LabwareId, ModuleName, StationName, workcell_of
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


class Discovered(msgspec.Struct):
    """An action that only a node's journal knows; ``effects`` is null where the journal does not
    say what it moved."""

    module: ModuleName
    name: str
    status: str
    effects: tuple[AnyEffect, ...] | None = None


class Shorter(msgspec.Struct):
    """``since`` is when the log was found shorter (UTC ns; 0: it was not); ``known`` and ``ended`` are the
    highest position that somebody knows of and where this log ended, ``evidence`` who knows what.
    Where an action that is not in the log was at work is ``touched``; where nobody knows what a
    module did, all of its workcell is (``cells``). ``astray`` is labware that such an action may have moved,
    ``said`` are the stations that a person has reported since, ``actions`` what was discovered;
    ``answered`` is the evidence of rounds that are over: a node that was away tells it once more."""

    since: int = 0
    known: int = 0
    ended: int = 0
    evidence: dict[str, str] = {}
    touched: dict[StationName, bool] = {}
    cells: dict[str, bool] = {}
    astray: dict[LabwareId, bool] = {}
    said: dict[StationName, bool] = {}
    actions: dict[ActionId, Discovered] = {}
    answered: dict[str, str] = {}

    def is_touched(self, station: StationName) -> bool:
        """Whether something that is not in the log may have been at work there."""
        return station in self.touched or workcell_of(station) in self.cells


def fold_log_found_shorter(shorter: Shorter, event: LogFoundShorter, at: int) -> None:
    if not shorter.since:
        shorter.since, shorter.ended = at, event.ended
    shorter.known = max(shorter.known, event.known)
    shorter.evidence[event.evidence] = event.knows
    if event.workcell:
        _doubt_cell(shorter, event.workcell)


def fold_action_discovered(shorter: Shorter, event: ActionDiscovered, at: int) -> None:
    """Logs of earlier versions discovered actions without a round."""
    if not shorter.since:
        return
    shorter.actions[event.action] = Discovered(event.module, event.name, event.status, event.effects)
    if event.effects is None:
        _doubt_cell(shorter, workcell_of(event.module))
        return
    for place in list_places(event.effects):
        shorter.touched[place] = True
        shorter.said.pop(place, None)
    for effect in event.effects:
        if isinstance(effect, Move | Needs) and effect.labware:
            shorter.astray[effect.labware] = True


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


HANDLERS = {
    LogFoundShorter: fold_log_found_shorter,
    ActionDiscovered: fold_action_discovered,
    StationsChecked: fold_stations_checked,
    BenchCompared: fold_bench_compared,
}
