"""A person goes round a bench of which the log has lost sight, and says what stands where."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from labos.core.decide.contents import recorded
from labos.core.decide.shorter import ConfirmStations, SayContents, must_be_said, to_say
from labos.core.effects import places
from labos.core.ids import StationName, local, workcell_of
from labos.core.shorter import LOG_SHORTER
from labos.core.state import LabState
from labos.errors import LabosError
from labos.http.limits import Named, Names, Person

if TYPE_CHECKING:
    from labos.http.service import LabService


class RoundWords(msgspec.Struct, forbid_unknown_fields=True):
    """What a person says on the round: what stands at ``stations``, bottom to top, and which are
    ``as_recorded``."""

    by: Person
    stations: Named = {}
    as_recorded: Names = []


def round_view(state: LabState) -> dict[str, Any]:
    """What is known of the log's lost end, and every station with what the log believes of it."""
    shorter, bench = state.shorter, state.bench
    left = set(to_say(state))
    asked = [q.id for q in state.interventions.open.values() if q.kind == LOG_SHORTER]
    return {
        "intervention": asked[0] if asked else "",
        "ended": shorter.ended,
        "known": shorter.known,
        "evidence": [{"by": local(by), "knows": knows} for by, knows in shorter.evidence.items()],
        "discovered": [
            {
                "module": local(action.module),
                "name": action.name,
                "status": action.status,
                "places": None if action.effects is None else sorted(map(local, places(action.effects))),
            }
            for action in shorter.actions.values()
        ],
        "not_known": {
            local(name): sorted(unknown)
            for name, module in state.modules.by_name.items()
            if (unknown := [variable for variable, value in module.variables.items() if value is None])
        },
        "stations": [
            {
                "station": local(name),
                "workcell": workcell_of(name),
                "kind": bench.stations[name].spec.kind,
                "capacity": bench.stations[name].spec.capacity,
                "known": bench.stations[name].known,
                "recorded": recorded(state, name),
                "types": {item: bench.labware[item].type for item in bench.stations[name].labware},
                "perhaps": [item.id for item in bench.labware.values() if name in item.maybe],
                "said": name not in left,
                "must_be_said": must_be_said(state, name),
            }
            for name in bench.stations
            if shorter.since and name not in bench.shelves
        ],
    }


async def say(service: LabService, words: RoundWords, by: str) -> dict[str, Any]:
    """Take what a person says, station by station: what cannot be is told with its reason, all else
    holds."""
    refused: list[dict[str, str]] = []
    taken: list[str] = []
    for written, contents in words.stations.items():
        try:
            name = service.station(written)
            _expect_known(service, name, contents)
            await service.kernel.execute(SayContents(name, by, tuple(contents)), by)
            taken.append(local(name))
        except LabosError as error:
            refused.append({"station": written, "why": error.message, "remedy": error.remedy})
    for written in words.as_recorded:
        try:
            name = service.station(written)
            await service.kernel.execute(ConfirmStations((name,), by), by)
            taken.append(local(name))
        except LabosError as error:
            refused.append({"station": written, "why": error.message, "remedy": error.remedy})
    return {"said": taken, "refused": refused, "left": list(map(local, to_say(service.kernel.state)))}


def _expect_known(service: LabService, name: StationName, contents: Sequence[str]) -> None:
    """Labware by its id, or by its type; what lies in a waste is only counted."""
    bench = service.kernel.state.bench
    if bench.stations[name].spec.kind == "waste":
        return
    for item in contents:
        for piece in item.split("+"):
            if piece not in bench.labware:
                service.expect_labware(piece)
