"""``labos bench``: declares the content of the bench, reports it after a lost log, and shows a simulated
bench."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import click

from labos.cli._group import Suggesting
from labos.cli._lab import need_lab_of
from labos.cli._options import Asker, asker_options, json_option, user_option
from labos.cli._out import end_with_json, show_json, wants_json
from labos.cli._query import Where, folder_and_json, log_options, open_database, open_log
from labos.core.ids import workcell_of
from labos.errors import BadInput
from labos.services.describe import describe_counts
from labos.services.log import fold_to


@click.group("bench", cls=Suggesting)
def command() -> None:
    """Declare what stands on the bench, or show a simulated bench."""


@command.command("declare")
@click.argument("stations", nargs=-1, metavar="[FILE | STATION=TYPE]...")
@click.option("--empty", is_flag=True, help="Declare all stations that were not declared yet as empty.")
@click.option("--workcell", default="", metavar="NAME", help="The workcell, if the lab has several.")
@asker_options
def declare(stations: tuple[str, ...], empty: bool, workcell: str, asker: Asker) -> None:
    """Declare what stands at stations. A station that was never declared is unknown, not empty. Runs that
    would put something there wait (`labos explain`).

    After a station and `=`, list the labware types from bottom to top. Nothing after `=` declares an empty
    station. A FILE is YAML: each line has a station and its list of types. If one entry has an error,
    nothing is declared.

    \b
    labos bench declare --empty
    labos bench declare camera_module.plate_station=plate96 sealer.default=
    labos bench declare sciclops.tower1=20xplate96
    labos bench declare bench.yaml --empty
    """

    contents: dict[str, list[str]] = {}
    for text in stations:
        for name, types in [_read(text)] if "=" in text else _read_contents_file(text):
            if name in contents:
                raise BadInput(f"The station {name} is given twice.", remedy="Declare it once.")
            contents[name] = types
    if not contents and not empty:
        raise click.UsageError("Name stations (STATION=TYPE) or a file, or give --empty.")
    with asker.lab() as client:
        found = client.declare(contents, asker.user, workcell=workcell, empty=empty)
    end_with_json(found)
    for name, types in found.items():
        click.echo(f"{name}: {describe_counts(types)}")
    if not found:
        click.echo("All stations were declared before.")


@command.command("show")
@folder_and_json
def show(where: Where) -> None:
    """Show the true state of a simulated bench, and where it differs from the log (exit code 1). The command
    works with and without a running lab, and changes nothing.

    \b
    labos bench show
    labos stations       the state according to the log

    The command also shows labware that an arm holds or has dropped. Only a person can check a real bench.
    """
    from labos.cli._bench_view import BenchView, read_bench, show

    benches = sorted((where.home / "world").glob("*.db"))
    if not benches:
        raise BadInput(
            f"There is no simulated bench in {where.home}.",
            remedy="Only a person can check a real bench. `labos stations` shows the state "
            "according to the log.",
        )
    with open_database(where) as store:
        sights: list[BenchView] = [read_bench(store, path) for path in benches]
    agrees = all(sight.agrees for sight in sights)
    end_with_json({"agrees": agrees, "workcells": sights}, int(not agrees))
    for sight in sights:
        show(sight)
    if not agrees:
        click.get_current_context().exit(1)


@command.command("round", short_help="Check the bench after the log has lost its last events.")
@click.option("--say", "reports", multiple=True, metavar="STATION=WHAT", help="The content of a station.")
@click.option("--file", "path", metavar="FILE", help="A YAML file with `STATION: WHAT` in each line.")
@click.option("--as-simulated", "simulated", is_flag=True, help="Report the true state of a simulated bench.")
@click.option(
    "--only-say", is_flag=True, help="Do not complete the check, even if every station is reported."
)
@json_option
@user_option
@log_options
def round_(
    where: Where,
    reports: tuple[str, ...],
    path: str | None,
    simulated: bool,
    only_say: bool,
    user: str,
) -> None:
    """Check the bench, station by station, after the log has lost its last events. Nodes, a
    checkpoint or a journal then know later events than the log, or the log was restored from an older copy.
    No action starts before the check is complete.

    On a terminal, the command asks you about each station. Your answers are kept if you stop. For a station
    that a lost action has changed, report what stands there. For all others, `as recorded` is enough. WHAT
    is `empty`, or the labware from bottom to top: its id (P7), with its lid (P7+P8), or its type if the log
    does not know it (plate96, 20xplate96). For a waste, WHAT is the number of pieces. A FILE is YAML, and
    may end with `rest: as recorded`.

    \b
    labos bench round --json                  what is known, and which stations you have to report
    labos bench round --say sealer.default=P7 --say peeler.default=empty
    labos bench round --file bench.yaml

    After the last station, the check is complete. Runs that were active end. Their labware stays where you
    reported it and belongs to their users. Waiting runs are paused (labos resume R7, labos cancel R7).
    """
    from labos.cli._bench_round import ask, parse_options, read_file, say, show, show_not_known, show_refused

    with need_lab_of(where) as client:
        view = client.round()
        if not view["intervention"]:
            raise BadInput(
                "This log has not lost its end: no check of the bench is needed.",
                remedy="You can report a single station at any time: labos observe STATION WHAT",
            )
        words = {**(read_file(path) if path else {}), **parse_options(reports)}
        if simulated:
            words = {**_read_bench_contents(where), "rest": None, **words}
        question = view["intervention"]
        if not words and not wants_json():
            show(view)
            if sys.stdin.isatty() and sys.stdout.isatty():
                ask(client, user)
                only_say = only_say or not click.confirm(
                    "Is this complete, and has everybody left the workcell?"
                )
        finish = not (only_say or (wants_json() and not words))
        found: dict[str, Any] = {"said": [], "refused": [], "answered": False, "why_not": ""}
        if words or finish:
            found = say(client, view, words, user, finish=finish)
        answered = found["answered"]
        if answered:  # no question is open any more
            view = {**view, "stations": [{**station, "said": True} for station in view["stations"]]}
        else:
            view = client.round()
        left = [station["station"] for station in view["stations"] if not station["said"]]
    if wants_json():
        show_json({**view, **found, "left": left})
    else:
        show_refused(found["refused"])
        if answered:
            click.echo(f"{question} is answered: the lab continues with your reports.")
            show_not_known(view)
        elif left:
            click.echo(f"Still to report: {', '.join(left)}.")
        elif found["why_not"]:
            click.echo(f"{question} is not answered: {found['why_not']}")
    if (words or found["why_not"]) and not answered and not only_say:
        click.get_current_context().exit(1)


def _read_bench_contents(where: Where) -> dict[str, list[str] | None]:
    """The true content of the simulated benches of this lab."""
    from labos.node.world import World
    from labos.services.truth import list_bench_contents

    benches = [] if where.lab else sorted((where.home / "world").glob("*.db"))
    if not benches:
        place = where.lab or where.home
        raise BadInput(
            f"There is no simulated bench in {place}.", remedy="Only a person can check a real bench."
        )
    found: dict[str, list[str] | None] = {}
    with open_log(where) as store:
        position = store.head().position
        state, records = fold_to(store, position), list(store.read(upto=position))
    for path in benches:
        with closing(World(str(path))) as world:
            seen = list_bench_contents(world, state, records)
        found |= {name: content for name, content in seen.items() if workcell_of(name) == path.stem}
    wastes = [name for name, station in state.bench.stations.items() if station.spec.kind == "waste"]
    return {**found, **dict.fromkeys(wastes, None)}


def _read(text: str) -> tuple[str, list[str]]:
    """``station=type,3xtype``."""
    name, _, contents = text.partition("=")
    types: list[str] = []
    for part in filter(None, (part.strip() for part in contents.split(","))):
        count, times, kind = part.partition("x")
        types += [kind] * int(count) if times and count.isdigit() else [part]
    return name.strip(), types


def _read_contents_file(path: str) -> list[tuple[str, list[str]]]:
    from labos.spec.source import read

    if not Path(path).is_file():
        raise BadInput(f"There is no file {path!r}.", remedy="Write STATION=TYPE, or name a YAML file.")
    data: Any = read(path).data
    if not isinstance(data, dict):
        raise BadInput(f"{path} is not a list of stations.", remedy="Write `station: [type]` in each line.")
    found = []
    for name, types in data.items():
        listed = [] if types is None else types if isinstance(types, list) else [types]
        if not all(isinstance(kind, str) for kind in listed):
            raise BadInput(f"{path}: what stands at {name!r} is not a labware type.")
        found.append(_read(f"{name}={','.join(listed)}"))
    return found
