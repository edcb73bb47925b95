"""Asks a person who has left a workcell what stands there now, station by station."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import click

from labos.core.ids import local, workcell_of

KEPT, EMPTY = "kept", "empty"
COUNTED = ("stack", "waste")
"""Kinds of stations whose pieces are counted, not named."""

Changes = list[tuple[str, str]]


def ask(state: Mapping[str, Any], workcell: str, standing: Mapping[str, Sequence[str]]) -> Changes:
    """The changes for ``LabClient.leave``; the user confirms them. ``standing`` is the content of each
    station that is not empty according to the log. Raises click.Abort for an end of input and for a no."""
    hotels = Counter(local(station["hotel"]) for station in state["stations"])
    stations = {
        local(name): station
        for station in state["stations"]
        if workcell_of(name := station["name"]) == workcell and local(name) not in hotels
    }
    click.echo("What stands there now? Enter: unchanged. Otherwise: empty, or an id (P7) or type of labware.")
    now: dict[str, list[str]] = {}
    for name, things in standing.items():
        content = _ask_station(name, stations[name], f"  {name}: {', '.join(things)}")
        if content is not None:
            now[name] = content
    while (other := _find_other(stations, hotels)) is not None:
        now[other[0]] = other[1]
    changes = _list_changes(stations, now)
    click.echo(
        "\n".join(f"  {name}: {' and '.join(content) or EMPTY}" for name, content in now.items())
        or "Nothing."
    )
    click.confirm("Is this list of changes complete, and has everybody left the workcell?", abort=True)
    return changes


def _ask_station(name: str, station: Mapping[str, Any], text: str) -> list[str] | None:
    """The present content of a station; None if it is unchanged."""
    while True:
        content = _split_words(click.prompt(text, default=KEPT))
        if content in ([KEPT], ["k"], list(station["labware"])):
            return None
        if content in ([EMPTY], ["e"]):
            return []
        problem = _find_problem(name, station, content)
        if not problem:
            return content
        click.echo(f"  {problem}")


def _find_other(
    stations: Mapping[str, Mapping[str, Any]], hotels: Mapping[str, int]
) -> tuple[str, list[str]] | None:
    """Another station with changed content, and the content; None if there is none. ``hotels`` are the
    numbers of shelves of the hotels."""
    while True:
        text = click.prompt("Other changes? STATION=WHAT; Enter: none", default="", show_default=False)
        if not text.strip():
            return None
        name, equals, what = (part.strip() for part in text.partition("="))
        content = [] if what == EMPTY else _split_words(what)
        if not equals or not (content or what == EMPTY):
            click.echo("  Write STATION=WHAT, such as wc.shelf=P7.")
        elif name in hotels:
            click.echo(f"  {name} has shelves: {name}.1 to {name}.{hotels[name]}. Name one of them.")
        elif name not in stations:
            click.echo(f"  There is no station {name!r} here. Known: {', '.join(sorted(stations))}.")
        elif problem := _find_problem(name, stations[name], content):
            click.echo(f"  {problem}")
        else:
            return name, content


def _find_problem(name: str, station: Mapping[str, Any], content: Sequence[str]) -> str:
    """Why a station cannot have that content, as far as it can be checked here."""
    if content and (station["kind"] in COUNTED or station["stock"]):
        return (
            f"Labware in {name} has no ids: answer kept or empty here, and at the end run: "
            f"labos bench declare {name}=NUMBERxTYPE"
        )
    if len(content) > station["capacity"]:
        return f"{name} has room for {station['capacity']}."
    if EMPTY in content or KEPT in content:
        return "Write kept, empty, or the labware."
    return ""


def _list_changes(stations: Mapping[str, Mapping[str, Any]], now: Mapping[str, Sequence[str]]) -> Changes:
    """The changes; a station whose labware was only moved to another one needs no entry."""
    named = {labware for content in now.values() for labware in content}
    changes: Changes = []
    for name, content in now.items():
        gone = set(stations[name]["labware"]) - named
        if gone or (not content and not stations[name]["labware"]) or stations[name]["stock"]:
            changes.append((name, EMPTY))
            changes += [(name, labware) for labware in content]
        else:
            changes += [(name, labware) for labware in content if labware not in stations[name]["labware"]]
    return changes


def _split_words(text: str) -> list[str]:
    return [word for word in re.split(r"[,\s]+", text.strip()) if word]
