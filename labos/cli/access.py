"""``labos access``: a person works in a workcell by hand."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import click

from labos.cli._complete import make_completer
from labos.cli._options import Asker, asker_options, why_option
from labos.cli._out import end_with_json, report_done, wants_json
from labos.cli._rounds import ask
from labos.core.ids import local, workcell_of
from labos.errors import BadInput, NotFound, Refused

if TYPE_CHECKING:
    from labos.client import LabClient

LOOK_S = 0.2


@click.command("access", short_help="Reach into a workcell while its runs wait.")
@click.argument("workcell", shell_complete=make_completer("workcell"))
@why_option("The reason; users whose runs wait can read it. With --done: a comment.")
@click.option("--no-park", is_flag=True, help="Leave the arms where they are.")
@click.option(
    "--timeout",
    type=float,
    default=600.0,
    show_default=True,
    help="How many seconds to wait until nothing moves.",
)
@click.option("--done", is_flag=True, help="Report that everybody has left the workcell; the lab continues.")
@click.option(
    "--changed",
    multiple=True,
    metavar="STATION=WHAT",
    help="With --done: what stands at a station now: `empty`, an id of labware (P7), or a labware type.",
)
@click.option(
    "--unchanged", is_flag=True, help="With --done: report that nothing was changed, without questions."
)
@asker_options
def command(
    workcell: str,
    why: str,
    no_park: bool,
    timeout: float,
    done: bool,
    changed: tuple[str, ...],
    unchanged: bool,
    asker: Asker,
) -> None:
    """Request access, to reach into WORKCELL. No new action starts there, actions in progress end, and arms
    with a home position move to it. Then the command reports that nothing moves. Runs wait until you report
    --done.

    This is not a safety function: only doors, light curtains and emergency stops protect you. With --done,
    report what you changed. LabOS assumes that everything else is unchanged. On a terminal, the command asks
    you about each station, and you confirm at the end. Nothing is sent to the lab before that.

    \b
    labos access rpl --why "a plate has slipped"
    labos access rpl --done
    labos access rpl --done --changed sealer.default=empty --changed camera_module.plate_station=P7
    """
    if (changed or unchanged) and not done:
        raise click.UsageError("--changed and --unchanged need --done.")
    if changed and unchanged:
        raise click.UsageError("Give either --changed or --unchanged.")
    with asker.lab() as client:
        if done:
            changes = [_change(text) for text in changed]
            if not (changed or unchanged or wants_json()) and sys.stdin.isatty() and sys.stdout.isatty():
                _leave_asked(client, workcell, asker.user, why)
                return
            client.leave(workcell, asker.user, changes, why)
            listed = [{"station": station, "what": what} for station, what in changes]
            facts = {"workcell": workcell, "granted": False, "changed": listed}
            report_done(_describe_going_on(workcell, changes), facts)
            return
        parking = client.enter(workcell, asker.user, why, park=not no_park)
        if not wants_json():
            click.echo(f"No new action starts in {workcell}.")
            if parking:
                click.echo(f"Arms go home: {', '.join(parking)}.")
        _wait_until_granted(client, workcell, timeout)
        state = client.state(waits=False)
    access = state["lab"]["access"].get(workcell)
    doubtful = access["perhaps_moving"] if access is not None else []
    facts = {"workcell": workcell, "granted": True, "perhaps_moving": doubtful, "parking": parking}
    end_with_json({**facts, "stations": _list_recorded(state, workcell)})
    if doubtful:
        click.echo(
            f"WARNING: it is unknown whether everything has stopped: {', '.join(doubtful)}. Switch "
            "it off first.\n"
            f"Nothing else moves in {workcell} now. Nothing will start until you report --done."
        )
    else:
        click.echo(f"Nothing moves in {workcell} now. Nothing will start until you report --done.")
    _guide(state, workcell)


def _describe_going_on(workcell: str, changes: list[tuple[str, str]]) -> str:
    if changes:
        return f"{workcell} continues."
    return (
        f"{workcell} continues. No change was reported: the lab assumes that all labware stands as before "
        "(report changes with --changed)."
    )


def _leave_asked(client: LabClient, workcell: str, by: str, note: str) -> None:
    """Ask for the changes, then end the access. If the lab refuses an answer, it is asked again; if the user
    stops, nothing is sent."""
    while True:
        state = client.state(waits=False)
        access = state["lab"]["access"].get(workcell)
        changes: list[tuple[str, str]] = []
        if access is not None and access["granted"]:  # else no access was granted
            try:
                changes = ask(state, workcell, _list_recorded(state, workcell))
            except (click.Abort, KeyboardInterrupt):
                click.echo(
                    f"\nNothing was reported: {workcell} stays held. Repeat: labos access {workcell} --done"
                )
                raise
        try:
            client.leave(workcell, by, changes, note)
        except (BadInput, NotFound, Refused) as refused:
            if not changes:
                raise
            click.echo(f"labos: {refused}\nNone of your answers was recorded. Please answer again:", err=True)
            continue
        click.echo(_describe_going_on(workcell, changes))
        return


def _wait_until_granted(client: LabClient, workcell: str, timeout_s: float) -> None:
    """Raises NotFound when the time is over; the workcell stays reserved for the person."""
    give_up = time.monotonic() + timeout_s
    shown: list[str] = []
    while True:
        access = client.state(waits=False)["lab"]["access"].get(workcell)
        if access is None:
            raise NotFound("Another user has ended the access meanwhile.", remedy="Request access again.")
        if access["granted"]:
            return
        if access["moving"] and access["moving"] != shown:
            shown = access["moving"]
            click.echo(f"Waiting for {', '.join(shown)}.", err=True)
        if time.monotonic() > give_up:
            raise NotFound(
                f"After {timeout_s:g} s it still moves in {workcell}: {', '.join(access['moving'])}.",
                remedy="Repeat the command to wait longer, or end the access: labos access "
                f"{workcell} --done",
            )
        time.sleep(LOOK_S)


def _list_recorded(state: dict[str, Any], workcell: str) -> dict[str, list[str]]:
    """The content of each station that is not empty according to the log."""
    types = {item["id"]: item["type"] for item in state["labware"]}
    found: dict[str, list[str]] = {}
    hotels = {local(station["hotel"]) for station in state["stations"]}
    for station in state["stations"]:
        cell, name = workcell_of(station["name"]), local(station["name"])
        standing = [f"{labware} ({types[labware]})" for labware in station["labware"]]
        if station["stock"]:
            standing.append(f"{station['stock']} in stock")
        if cell == workcell and standing and name not in hotels:
            found[name] = standing
    return found


def _guide(state: dict[str, Any], workcell: str) -> None:
    click.echo("According to the lab, these stations hold labware:")
    for name, standing in _list_recorded(state, workcell).items():
        click.echo(f"  {name}: {', '.join(standing)}")
    click.echo(
        "All other stations are empty or unknown.\n"
        f"At the end:                labos access {workcell} --done\n"
        f"If you took labware away: labos access {workcell} --done --changed STATION=empty\n"
        f"If you moved P7:          labos access {workcell} --done --changed STATION=P7"
    )


def _change(text: str) -> tuple[str, str]:
    station, equals, what = text.partition("=")
    if not (station.strip() and equals and what.strip()):
        raise BadInput(
            f"{text!r} does not name a station and its content.", remedy="Write STATION=empty, STATION=P7."
        )
    return station.strip(), what.strip()
