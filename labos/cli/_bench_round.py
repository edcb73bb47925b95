"""The round of a person after the log has lost its end: the questions, and the forms of the answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from labos.core.ids import local
from labos.errors import BadInput

if TYPE_CHECKING:
    from labos.client import LabClient

AS_RECORDED, EMPTY, REST = "as recorded", "empty", "rest"

NAMED = 6
"""At most so many stations are named with one reason."""

Words = dict[str, list[str] | None]
"""The content of stations, bottom to top; None: as recorded."""


def read_words(text: str, station: str) -> list[str] | None:
    """``P7+P8, 3xplate96``, ``empty``, a number for a waste, or ``as recorded``. Raises BadInput."""
    text = text.strip().lower() if text.strip().lower() in (AS_RECORDED, EMPTY) else text.strip()
    if text in (AS_RECORDED, "as-recorded", "="):
        return None
    if text in ("", EMPTY):
        return []
    if text.isdecimal():
        return ["labware"] * int(text)
    found: list[str] = []
    for part in (part.strip() for part in text.split(",")):
        if not part:
            raise BadInput(
                f"{station}: {text!r} is not a valid content of a station.", remedy="Write P7, plate96."
            )
        count, times, kind = part.partition("x")
        found += [kind] * int(count) if times and count.isdecimal() and kind else [part]
    return found


def parse_options(options: Sequence[str]) -> Words:
    """``STATION=WHAT`` of the command line."""
    words: Words = {}
    for text in options:
        name, equals, what = text.partition("=")
        if not equals or not name.strip():
            raise BadInput(f"{text!r} does not name a station and its content.", remedy="Write STATION=WHAT.")
        words[name.strip()] = read_words(what, name)
    return words


def read_file(path: str) -> Words:
    """A YAML or JSON file: each line has a station and its content."""
    from labos.spec.source import read

    if not Path(path).is_file():
        raise BadInput(f"There is no file {path!r}.", remedy="Write `STATION: WHAT` in each line of one.")
    data: Any = read(path).data
    if not isinstance(data, dict):
        raise BadInput(f"{path} is not a list of stations.", remedy="Write `STATION: WHAT` in each line.")
    words: Words = {}
    for name, value in data.items():
        listed = value if isinstance(value, list) else ["" if value is None else value]
        contents = [read_words(str(part), str(name)) for part in listed]
        if len(contents) > 1 and None in contents:
            raise BadInput(f"{path}: {name} is given twice.", remedy="Give its content, or `as recorded`.")
        words[str(name)] = (
            None if contents == [None] else [piece for part in contents for piece in part or ()]
        )
    return words


def say(
    client: LabClient, view: Mapping[str, Any], words: Words, by: str, *, finish: bool = False
) -> dict[str, Any]:
    """Send the whole report to the lab. ``rest`` as the name of a station stands for all stations that are
    not reported and need not be reported one by one; ``finish`` answers the question if nothing is left.
    Raises BadInput for a name that is not on the round."""
    stations = {
        _find_station(view, name)["station"]: content for name, content in words.items() if name != REST
    }
    if REST in words and words[REST] is not None:
        raise BadInput(f"`{REST}` can only be `{AS_RECORDED}`.", remedy="Give other stations one by one.")
    as_recorded: list[str] = []
    contents: dict[str, list[str]] = {}
    for station in view["stations"]:
        name = station["station"]
        full = f"{station['workcell']}/{name}"
        if name in stations and stations[name] is not None:
            contents[full] = list(stations[name] or ())
        elif name in stations and station["must_be_said"]:
            contents[full] = station["recorded"]
        elif name in stations or (REST in words and not station["must_be_said"] and not station["said"]):
            as_recorded.append(full)
    # Labware that was removed makes room for the present content, and is found at the station that is
    # reported last.
    ordered = dict(sorted(contents.items(), key=lambda item: bool(item[1])))
    return client.say(by, ordered, as_recorded, finish=finish)


def _find_station(view: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = [s for s in view["stations"] if name in (s["station"], f"{s['workcell']}/{s['station']}")]
    if not found:
        raise BadInput(f"This round has no station {name!r}.", remedy="See: labos bench round --json")
    station: Mapping[str, Any] = found[0]
    return station


def show(view: Mapping[str, Any]) -> None:
    """The reason for the round, and the stations that are left."""
    click.echo(f"This log ends at position {view['ended']}. Nodes or files know later events:")
    for evidence in view["evidence"]:
        click.echo(f"- {evidence['by']} {evidence['knows']}")
    for action in view["discovered"]:
        places = action["places"]
        where = "anywhere" if places is None else ", ".join(places) or "no station"
        click.echo(f"- {action['module']} did {action['name']!r} ({action['status']}) at: {where}")
    left = [station for station in view["stations"] if not station["said"]]
    click.echo(f"To report: {len(left)} of {len(view['stations'])} stations.")
    for station in left:
        click.echo(f"  {_line(station)}")


def show_refused(refused: Sequence[Mapping[str, str]]) -> None:
    """The refused stations, each reason once."""
    reasons: dict[str, list[str]] = {}
    for one in refused:
        reasons.setdefault(f"{one['why']} {one['remedy']}", []).append(local(one["station"]))
    for reason, stations in reasons.items():
        more = f" and {len(stations) - NAMED} more" if len(stations) > NAMED else ""
        click.echo(f"{', '.join(stations[:NAMED])}{more}: {reason}")


def show_not_known(view: Mapping[str, Any]) -> None:
    """Doors and lids that an action of their module has to bring to their rest position."""
    for module, variables in view["not_known"].items():
        click.echo(
            f"Not known of {module}: {', '.join(variables)}. Check the module, and move it to its "
            f"proper position: labos do {module} ACTION"
        )


def _line(station: Mapping[str, Any]) -> str:
    mark = "" if station["must_be_said"] else f"   (`{AS_RECORDED}` is enough)"
    perhaps = f"; perhaps {', '.join(station['perhaps'])}" if station["perhaps"] else ""
    return f"{station['station']}: recorded {describe_recorded(station)}{perhaps}{mark}"


def describe_recorded(station: Mapping[str, Any]) -> str:
    """The content of a station according to the log, in words."""
    if station["kind"] == "waste":
        return f"{len(station['recorded'])} thrown away"
    if not station["known"] and not station["recorded"]:
        return "nothing: it was never declared"
    pieces: list[str] = []
    for item in station["recorded"]:
        kind = station["types"].get(item.partition("+")[0], "")
        pieces.append(f"{item} ({kind})" if kind else item)
    counts = {piece: pieces.count(piece) for piece in pieces}
    return ", ".join(piece if n == 1 else f"{n}x{piece}" for piece, n in counts.items()) or EMPTY


def ask(client: LabClient, by: str) -> None:
    """Ask about station after station, on a terminal. If the user stops, the earlier answers are kept."""
    click.echo(
        f"What stands there? `{EMPTY}`, `{AS_RECORDED}` (or `=`), labware by its id (P7), or by its "
        "type where it has none (plate96, 20xplate96), with its lid (P7+P8), bottom to top; for a "
        "waste, the number of pieces."
    )
    view = client.round()
    for station in [s for s in view["stations"] if s["must_be_said"] and not s["said"]]:
        _ask_one(client, view, station, by)
    for cell in dict.fromkeys(station["workcell"] for station in view["stations"]):
        _ask_others(client, cell, by)


def _ask_one(client: LabClient, view: Mapping[str, Any], station: Mapping[str, Any], by: str) -> None:
    while True:
        try:
            answer = read_words(click.prompt(_line(station)), station["station"])
        except BadInput as error:
            click.echo(f"  {error}")
            continue
        found = say(client, view, {f"{station['workcell']}/{station['station']}": answer}, by)
        if not found["refused"]:
            return
        click.echo(f"  {found['refused'][0]['why']} {found['refused'][0]['remedy']}")


def _ask_others(client: LabClient, cell: str, by: str) -> None:
    view = client.round()
    left = [s for s in view["stations"] if s["workcell"] == cell and not s["said"]]
    if not left:
        return
    click.echo(f"In {cell} no action is known to have been in progress at:")
    for station in left:
        click.echo(f"  {station['station']}: recorded {describe_recorded(station)}")
    names = {station["station"]: station for station in left}
    text = click.prompt(
        "Which of these differ from the record? (Enter: none)", default="", show_default=False
    )
    for name in filter(None, (part.strip() for part in text.replace(",", " ").split())):
        if name in names:
            _ask_one(client, view, names.pop(name), by)
        else:
            click.echo(f"  There is no {name!r} among them.")
    found = client.say(by, as_recorded=[f"{cell}/{name}" for name in names])
    show_refused(found["refused"])
