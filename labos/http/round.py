"""The round: after the log lost its end, a person checks the whole bench and reports the content of each
station."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from labos.core.decide.composites import ReportRound
from labos.core.decide.contents import list_recorded
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.rights import check_role
from labos.core.decide.shorter import ConfirmStations, SayContents, list_to_say, must_describe
from labos.core.effects import list_places
from labos.core.ids import StationName, local, workcell_of
from labos.core.interventions import InterventionResolved
from labos.core.lab import WHOLE_LAB
from labos.core.shorter import StationsChecked
from labos.core.state import LabState
from labos.core.topics import ShorterLog
from labos.errors import LabosError
from labos.http.bodies import Asked
from labos.http.limits import Named, Names, says
from labos.http.stock import check

if TYPE_CHECKING:
    from labos.http.service import LabService


class RoundReport(Asked, kw_only=True):
    """A person's report on the round: the content of ``stations``, bottom to top, and the stations that are
    ``as_recorded``; ``finish``: the question that asks for the round is answered, if nothing is left."""

    stations: Annotated[
        Named,
        says("the labware at each station, from bottom to top: ids, or types if the log has no id"),
    ] = {}
    as_recorded: Annotated[Names, says("stations that are as recorded")] = []
    finish: Annotated[bool, says("`true`: answer the intervention if no station is left")] = False


class Evidence(msgspec.Struct, frozen=True):
    """A module or file that has a later position than the log, and that position."""

    by: str
    knows: str


class DiscoveredAction(msgspec.Struct, frozen=True):
    """An action that is in a node's journal and not in the log. ``places`` are the stations at which it
    worked; null: the journal does not name them."""

    module: str
    name: str
    status: str
    places: list[str] | None


class RoundStation(msgspec.Struct, frozen=True):
    """A station on the round. ``recorded`` is what stands there by the log, bottom to top; ``types`` are
    those of its labware; ``perhaps`` is uncertain labware that may be there; ``must_be_said``: it is not
    enough that it is as recorded."""

    station: str
    workcell: str
    kind: str
    capacity: int
    known: bool
    recorded: list[str]
    types: dict[str, str]
    perhaps: list[str]
    said: bool
    must_be_said: bool


class Round(msgspec.Struct, frozen=True):
    """The evidence that the log has lost its end: the ``intervention`` that asks for a comparison with the
    bench (empty: none), the position where the log ``ended``, and the highest position for which there is
    evidence (``known``; 0: none). ``not_known`` are variables such as doors and lids, by module."""

    intervention: str
    ended: int
    known: int
    evidence: list[Evidence]
    discovered: list[DiscoveredAction]
    not_known: dict[str, list[str]]
    stations: list[RoundStation]


class RoundRefusal(msgspec.Struct, frozen=True):
    station: str
    why: str
    remedy: str


class RoundResult(msgspec.Struct, frozen=True):
    """The reported stations (``said``), those whose report was ``refused``, and those that are ``left``.
    ``answered``: the intervention is answered. If no station is left and it is not answered, ``why_not`` is
    the reason."""

    said: list[str]
    refused: list[RoundRefusal]
    left: list[str]
    answered: bool = False
    why_not: str = ""


def round_view(state: LabState) -> Round:
    """The facts about the log's lost end, and every station with its content according to the log."""
    shorter, bench = state.shorter, state.bench
    left = set(list_to_say(state))
    asked = [q.id for q in state.interventions.open.values() if q.kind == ShorterLog.KIND]
    return Round(
        intervention=asked[0] if asked else "",
        ended=shorter.ended,
        known=shorter.known,
        evidence=[Evidence(local(by), knows) for by, knows in shorter.evidence.items()],
        discovered=[
            DiscoveredAction(
                local(action.module),
                action.name,
                action.status,
                None if action.effects is None else sorted(map(local, list_places(action.effects))),
            )
            for action in shorter.actions.values()
        ],
        not_known={
            local(name): sorted(unknown)
            for name, module in state.modules.by_name.items()
            if (unknown := [variable for variable, value in module.values.items() if value is None])
        },
        stations=[
            _make_round_station(state, name, name not in left)
            for name in bench.stations
            if shorter.since and name not in bench.shelves
        ],
    )


def _make_round_station(state: LabState, name: StationName, described: bool) -> RoundStation:
    bench, station = state.bench, state.bench.stations[name]
    return RoundStation(
        station=local(name),
        workcell=workcell_of(name),
        kind=station.spec.kind,
        capacity=station.spec.capacity,
        known=station.known,
        recorded=list(list_recorded(state, name)),
        types={item: bench.labware[item].type for item in station.labware},
        perhaps=[item.id for item in bench.labware.values() if name in item.maybe],
        said=described,
        must_be_said=must_describe(state, name),
    )


async def say(service: LabService, words: RoundReport, by: str) -> RoundResult:
    """Accept a person's report, station by station: an impossible one is refused with its reason, all others
    are recorded."""
    refused: list[RoundRefusal] = []
    reported: dict[StationName, SayContents] = {}
    confirmed: dict[StationName, ConfirmStations] = {}
    for written, contents in (*words.stations.items(), *((name, None) for name in words.as_recorded)):
        try:
            name = service.station(written)
            if contents is None:
                confirmed[name] = ConfirmStations((name,), by)
            else:
                _expect_known(service, name, contents)
                reported[name] = SayContents(name, by, tuple(contents))
        except LabosError as error:
            refused.append(RoundRefusal(written, error.message, error.remedy))
    taken = {name for name in confirmed if name in service.kernel.state.shorter.said}
    finish = words.finish and check_role(service.kernel.state, by, "operator", WHOLE_LAB) is None
    command = ReportRound(by, tuple(reported.values()), tuple(confirmed), finish)
    events = await service.kernel.execute(command, by)
    answered = any(isinstance(event, InterventionResolved) and event.choice == "checked" for event in events)
    taken.update(name for event in events if isinstance(event, StationsChecked) for name in event.stations)
    for name, word in (*reported.items(), *confirmed.items()):
        if name not in taken:
            try:
                check(service, word, by)
            except LabosError as error:
                refused.append(RoundRefusal(local(name), error.message, error.remedy))
    left = list(map(local, list_to_say(service.kernel.state)))
    why_not = _explain_open(service, by) if words.finish and not (answered or left) else ""
    recorded = [local(name) for name in (*reported, *confirmed) if name in taken]
    return RoundResult(recorded, refused, left, answered, why_not)


def _explain_open(service: LabService, by: str) -> str:
    """Why the question about the round cannot be answered although everything is reported."""
    for question in service.kernel.state.interventions.open_about(ShorterLog):
        try:
            check(service, ResolveIntervention(question.id, "checked", by), by)
        except LabosError as error:
            return f"{error.message} {error.remedy}".strip()
    return ""


def _expect_known(service: LabService, name: StationName, contents: Sequence[str]) -> None:
    """Labware by its id, or by its type; pieces in a waste are only counted."""
    bench = service.kernel.state.bench
    if bench.stations[name].spec.kind == "waste":
        return
    for item in contents:
        for piece in item.split("+"):
            if piece not in bench.labware:
                service.expect_labware(piece)
