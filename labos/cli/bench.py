"""``labos bench``: saying what stands on the bench at the first start; looking at a simulated one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from labos.cli._options import home_option, json_option, user_option, who
from labos.cli._query import Where, log_options, reading
from labos.errors import BadInput


@click.group("bench")
def command() -> None:
    """What stands on the bench: say it, or look at a simulated one."""


@command.command("declare")
@click.argument("stations", nargs=-1, metavar="[FILE | STATION=TYPE]...")
@click.option("--empty", is_flag=True, help="All stations that nobody has spoken of stand empty.")
@click.option("--workcell", default="", metavar="NAME", help="The workcell, if the lab has several.")
@json_option
@user_option
@home_option
def declare(
    stations: tuple[str, ...], empty: bool, workcell: str, as_json: bool, user: str | None, home: str | None
) -> None:
    """Say what stands at stations already. What nobody has spoken of is unknown to LabOS, not empty:
    runs that would put something there wait and ask (`labos explain`).

    A station is followed by what stands there, bottom to top; nothing behind `=` is an empty one. A
    FILE is YAML: a station and its list of types in each line. All of it is declared, or nothing.

    \b
    labos bench declare --empty
    labos bench declare camera_module.plate_station=plate96 sealer.default=
    labos bench declare sciclops.tower1=20xplate96
    labos bench declare bench.yaml --empty
    """
    from labos.cli._lab import need_lab
    from labos.cli._out import show_json

    told: dict[str, list[str]] = {}
    for text in stations:
        for name, types in [_read(text)] if "=" in text else _in_file(text):
            if name in told:
                raise BadInput(f"The station {name} is declared twice.", remedy="Say it once.")
            told[name] = types
    if not told and not empty:
        raise click.UsageError("Name stations (STATION=TYPE), a file, or say --empty.")
    with need_lab(home) as client:
        found = client.declare(told, who(user), workcell=workcell, empty=empty)
    if as_json:
        show_json(found)
        return
    for name, types in found.items():
        click.echo(f"{name}: {_counted(types)}")
    if not found:
        click.echo("Everything was declared before.")


@command.command("look")
@json_option
@log_options
def look(where: Where, as_json: bool) -> None:
    """Look at a simulated bench: what its devices really did, whatever the log says, and where the two
    differ (exit code 1). It works with and without a running lab, and changes nothing.

    \b
    labos bench look
    labos stations       what the log says

    What an arm holds or has let fall is shown too. On a real bench, go and look.
    """
    from labos.cli._out import show_json
    from labos.cli._sight import Sight, look_at, show

    benches = sorted((where.home / "world").glob("*.db"))
    if not benches:
        raise BadInput(
            f"There is no simulated bench in {where.home}.",
            remedy="On a real one, go and look; `labos stations` tells what the log says.",
        )
    with reading(where) as store:
        sights: list[Sight] = [look_at(store, path) for path in benches]
    if as_json:
        show_json({"agrees": all(sight.agrees for sight in sights), "workcells": sights})
    else:
        for sight in sights:
            show(sight)
    if not all(sight.agrees for sight in sights):
        raise SystemExit(1)


def _read(text: str) -> tuple[str, list[str]]:
    """``station=type,3xtype``."""
    name, _, contents = text.partition("=")
    types: list[str] = []
    for part in filter(None, (part.strip() for part in contents.split(","))):
        count, times, kind = part.partition("x")
        types += [kind] * int(count) if times and count.isdigit() else [part]
    return name.strip(), types


def _in_file(path: str) -> list[tuple[str, list[str]]]:
    from labos.spec.source import read

    if not Path(path).is_file():
        raise BadInput(f"There is no file {path!r}.", remedy="Write STATION=TYPE, or name a YAML file.")
    data: Any = read(path).data
    if not isinstance(data, dict):
        raise BadInput(f"{path} is no list of stations.", remedy="Write `station: [type]` in each line.")
    found = []
    for name, types in data.items():
        listed = [] if types is None else types if isinstance(types, list) else [types]
        if not all(isinstance(kind, str) for kind in listed):
            raise BadInput(f"{path}: what stands at {name!r} is no type of labware.")
        found.append(_read(f"{name}={','.join(listed)}"))
    return found


def _counted(types: Sequence[str]) -> str:
    counts = {kind: types.count(kind) for kind in types}
    return ", ".join(f"{number} × {kind}" for kind, number in counts.items()) or "empty"
