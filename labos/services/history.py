"""The lab at any past moment."""

from __future__ import annotations

from labos.core.bench import Labware, StationState
from labos.core.ids import StationName, workcell_of
from labos.core.state import LabState
from labos.errors import BadInput
from labos.ports import LogQuery
from labos.services.log import Log, fold_to
from labos.services.times import Moment, show_time

NOW = Moment()


def find_position_at(log: Log, moment: Moment = NOW) -> int:
    """The last position that was recorded up to and at a moment. Raises BadInput for a moment before the
    beginning or after the end of the log."""
    head = log.head()
    if moment.position is not None:
        if not 1 <= moment.position <= head.position:
            raise BadInput(
                f"The log has no position {moment.position}.",
                remedy=f"Its positions are 1 to {head.position}." if head.position else "It is empty.",
            )
        return moment.position
    if moment.at_ns is None or moment.at_ns >= head.recorded_at:
        return head.position
    found = next(log.select(LogQuery(until_ns=moment.at_ns + 1, last=1)), None)
    if found is None:
        first = next(log.read(0, 1), None)
        began = f"It begins at {show_time(first.head.recorded_at)}." if first else "It is empty."
        raise BadInput(f"At {show_time(moment.at_ns)} there was no log yet.", remedy=began)
    return found.head.position


def fold_state_at(log: Log, moment: Moment = NOW) -> LabState:
    """The state at a moment. Raises BadInput, LogTooNew, LogDamaged."""
    return fold_to(log, find_position_at(log, moment))


def list_stations(state: LabState) -> list[tuple[StationName, StationState]]:
    """The stations by workcell and name, as the workcells list them."""
    return sorted(state.bench.stations.items(), key=lambda item: workcell_of(item[0]))


def list_possibly_at(state: LabState, station: StationName) -> list[Labware]:
    """Labware of uncertain place that may be at a station."""
    if station not in state.bench.uncertain_at:
        return []
    return [item for item in state.bench.labware.values() if station in item.maybe]
