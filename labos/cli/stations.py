"""``labos stations``: the labware at each station."""

from __future__ import annotations

from typing import Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_at_and_json
from labos.core.bench import StationState
from labos.core.ids import StationName, local, workcell_of
from labos.core.state import LabState
from labos.services.describe import describe_counts, owner_name
from labos.services.history import find_position_at, list_possibly_at, list_stations
from labos.services.labware import LabwareHistory, list_labware_histories
from labos.services.log import Log, fold_to
from labos.services.times import Moment, iso_time, show_time


class StationPlace(msgspec.Struct, frozen=True):
    """A station as it is shown. ``state``: unknown, empty or occupied; ``stock`` are pieces without ids,
    bottom to top; ``maybe`` is labware that may stand here; ``hotel`` is the hotel to which a shelf belongs,
    ``shelves`` the number of a hotel's own shelves."""

    station: str
    kind: str
    state: str
    capacity: int
    labware: tuple[dict[str, Any], ...]
    stock: tuple[str, ...]
    maybe: tuple[str, ...]
    expected: int
    level: int
    hotel: str = ""
    shelves: int = 0


@click.command("stations", short_help="Show the labware at each station, now or at a past moment.")
@click.argument(
    "names", shell_complete=make_completer("module", "station"), nargs=-1, metavar="[MODULE|STATION]..."
)
@click.option("--occupied", is_flag=True, help="Leave out empty stations.")
@log_at_and_json
def command(where: Where, names: tuple[str, ...], occupied: bool, moment: Moment) -> None:
    """Show the labware at each station, its owner, and since when it stands there.

    \b
    labos stations                       now
    labos stations --at 2026-05-04T10:30 at a past moment (local time)
    labos stations --at 1234             after the event at that position
    labos stations sciclops wc.output    only these

    `unknown` is not `empty`: the station was never declared. Empty shelves of a hotel are shown only if you
    name the hotel or the shelf, such as wc.output.3.
    """
    with open_current_log(where, moment) as store:
        position = find_position_at(store, moment)
        state = fold_to(store, position)
        shown = list_places(store, state, names)
    if occupied:
        shown = [place for place in shown if place.state != "empty" or place.maybe or place.expected]
    at = iso_time(state.recorded_at)
    end_with_json({"position": position, "time": at, "lab": state.lab.name, "stations": shown})
    title = f"After event {position}, {show_time(state.recorded_at)}"
    rows = [row for place in shown if not _is_bare(place, names) for row in _rows(place)]
    show_table(("station", "kind", "holds", "of", "since"), rows, title=title)


def list_places(log: Log, state: LabState, names: tuple[str, ...] = ()) -> list[StationPlace]:
    """The stations of a state; with ``names``, only the modules or stations with these names. Raises
    click.UsageError for a name that no station has."""
    stories = list_labware_histories(log, state.position) if state.bench.labware else {}
    found = [(name, station) for name, station in list_stations(state) if not names or _is_named(name, names)]
    for wanted in names:
        if not any(_is_named(name, (wanted,)) for name, _ in found):
            raise click.UsageError(f"This lab has no station or module {wanted!r}.")
    return [_place(state, name, station, stories) for name, station in found]


def _is_bare(place: StationPlace, names: tuple[str, ...]) -> bool:
    """Whether it is an empty shelf, and neither it nor its hotel was requested."""
    bare = bool(place.hotel) and place.state == "empty" and not place.maybe and not place.expected
    own = (place.station, place.hotel)
    return bare and not any(name in (known, local(StationName(known))) for name in names for known in own)


def _is_named(station: StationName, names: tuple[str, ...]) -> bool:
    owners = [StationName(station[:dot]) for dot, letter in enumerate(station) if letter == "."]
    known = (station, *owners, *map(local, (station, *owners)), workcell_of(station))
    return any(name in known for name in names)


def _place(
    state: LabState, name: StationName, station: StationState, stories: dict[str, LabwareHistory]
) -> StationPlace:
    here = [state.bench.labware[item] for item in station.labware]
    held = station.level if station.spec.kind == "waste" else len(here) + len(station.stock)
    return StationPlace(
        station=name,
        kind=station.spec.kind,
        state="occupied" if held else "empty" if station.known else "unknown",
        capacity=station.spec.capacity,
        labware=tuple(
            {
                "id": item.id,
                "type": item.type,
                "owner": item.owner,
                "since": stories[item.id].stays[-1].since if item.id in stories else item.placed_at,
                "variables": item.variables,
                "moving": bool(item.moving),
            }
            for item in here
        ),
        stock=tuple(station.stock),
        maybe=tuple(item.id for item in list_possibly_at(state, name)),
        expected=station.expected,
        level=station.level,
        hotel=station.spec.hotel,
        shelves=len(state.bench.shelves.get(name, ())),
    )


def _rows(place: StationPlace) -> list[tuple[str, ...]]:
    """One line for the station with its pieces without ids; one line for each further piece of labware."""
    if place.shelves:
        text = f"{len(place.labware)} on {place.shelves} shelves"
        return [(local(StationName(place.station)), place.kind, text, "", "")]
    lines: list[tuple[str, str, str]] = []
    if place.stock:
        lines.append((describe_counts(place.stock), "", ""))
    for item in place.labware:
        lines.append((_describe_labware(item), owner_name(item["owner"]), show_time(item["since"])))
    if place.maybe:
        lines.append((f"perhaps {', '.join(place.maybe)}", "", ""))
    if place.expected:
        many = "an arrival" if place.expected == 1 else f"{place.expected} arrivals"
        lines.append((f"{many} being moved", "", ""))
    if place.kind == "waste":
        lines.insert(0, (f"{place.level} of {place.capacity} thrown away", "", ""))
    elif place.state != "occupied":
        lines.insert(0, (place.state, "", ""))
    names = [(local(place.station), place.kind), *[("", "")] * (len(lines) - 1)]
    return [(*name, *line) for name, line in zip(names, lines, strict=True)]


def _describe_labware(item: dict[str, Any]) -> str:
    values = item["variables"].items()
    about = [name if value is True else f"{name} = {value}" for name, value in values if value]
    moving = ["in motion"] if item["moving"] else []
    return f"{item['id']} ({', '.join([item['type'], *about, *moving])})"
