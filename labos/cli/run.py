"""``labos run``: runs a workflow from start to end."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._forecast import show_change, show_ways
from labos.cli._options import (
    json_option,
    lab_options,
    priority_option,
    quiet_option,
    simulate_option,
    user_option,
)
from labos.cli._out import show_json, show_line, wants_json
from labos.cli._payload import payload_option, read_payload
from labos.cli._remote import lab_of
from labos.core.ids import local
from labos.errors import BadInput
from labos.settings import Settings, find_kernel, was_simulated

if TYPE_CHECKING:
    from labos.client import LabClient, RunResult
    from labos.core.model import Workcell
    from labos.spec import Compiled


@click.command("run")
@click.argument("workflow", shell_complete=make_completer("workflow"))
@payload_option
@click.option(
    "--workcell",
    metavar="NAME|FILE",
    help="The workcell (the lab's own; in a new lab the one beside the workflow's file, else rpl).",
)
@simulate_option
@click.option(
    "--place",
    "placed",
    multiple=True,
    metavar="STATION=TYPE",
    help="Labware that stands at a station before the run, such as `camera_module.plate_station=plate96`; "
    "`peeler.default=plate96,sealed` if it is sealed.",
)
@user_option
@priority_option
@lab_options
@json_option
@quiet_option
@click.option("--dry-run", is_flag=True, help="Show when it would start and end; submit nothing.")
def command(
    workflow: str,
    payloads: tuple[str, ...],
    workcell: str | None,
    simulate: bool,
    placed: tuple[str, ...],
    user: str,
    priority: int,
    home: str | None,
    database: str | None,
    speed: float | None,
    seed: int,
    quiet: bool,
    dry_run: bool,
) -> None:
    """Run WORKFLOW, a file or a packaged workflow, and wait for its end.

    The command uses the running lab. If there is none, it starts a lab for this run only. Exit code 0 if
    the run completes, 1 if it fails, is cancelled or is refused.

    \b
    labos run pcr --simulate --speed 600
    labos run wf.yaml --workcell workcell.yaml --simulate --payload seal.time=3
    labos run mix.yaml --simulate --place camera_module.plate_station=plate96 --payload mix.json
    labos run pcr --dry-run

    With --dry-run nothing is submitted. The running lab forecasts when the run would start and end, which
    runs it would delay, and when a person would be needed.
    """
    from labos.client import workflow_text

    values = read_payload(payloads)
    settings = Settings.make(home, database, speed=speed, simulate=True if simulate else None, seed=seed)
    text = workflow_text(workflow, values)
    job = RunRequest(text, values, user, workcell or "", placed, priority, simulate, workflow)
    url = "" if database else lab_of(home)
    if dry_run:
        forecast(job, home)
        return
    show_result(carry_out(job, settings, url=url, quiet=quiet or wants_json()))


def forecast(job: RunRequest, home: str | None) -> None:
    """Show the forecast for a job in the running lab. Raises Exit(1) if it would be refused."""
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        answer = client.forecast_run(
            job.text,
            payload=job.values,
            user=job.user,
            workcell=job.workcell,
            priority=job.priority,
            place=parse_places(job.placed),
        )
    found = answer["forecast"]
    if wants_json():
        show_json(answer)
    elif found["refusal"]:
        click.echo(f"It would be refused: {found['refusal']}")
    else:
        show_ways(found)
        show_change(found)
    if found["refusal"]:
        raise click.exceptions.Exit(1)


Put = tuple[str, str, dict[str, bool]]
"""A station, the type of labware that is placed there, and its variables: ``{"sealed": True}``."""


class RunRequest(msgspec.Struct, frozen=True):
    """A run to carry out: the text of a workflow with its files, its path, and the options."""

    text: dict[str, Any]
    values: dict[str, Any] = {}
    user: str = ""
    workcell: str = ""
    placed: tuple[str, ...] = ()
    priority: int = 0
    simulate: bool = False
    path: str = ""


def carry_out(
    job: RunRequest, settings: Settings, *, url: str = "", quiet: bool, say_waits: bool = False
) -> RunResult:
    """Run a job to its end, in the lab at ``url`` or the running one of the home folder, else in a lab of its
    own."""
    from labos.cli._lab import check_first, end_in_order, read_workcell, some_lab
    from labos.cli._narrate import Narrator
    from labos.spec import parse_workflow

    # Errors of the file itself are reported before a lab is started for it.
    source = parse_workflow(job.text["text"], job.text["name"])
    placed = parse_places(job.placed)
    cells, cell = [], job.workcell
    is_simulated = _is_simulated(settings, url)
    if is_simulated is None:
        was = was_simulated(settings)
        if not job.simulate and was is None:
            raise BadInput(
                f"No lab runs in {settings.home}.",
                remedy="Add --simulate to run it on simulated instruments, or start a lab with `labos up`.",
            )
        if job.workcell or was is None:
            cells = [read_workcell(job.workcell or _find_workcell_beside(job.path) or "rpl", [source])]
            cell = cells[0].workcell.name
            compiled = check_first(job.text, job.values, cells[0], simulate=job.simulate or bool(was))
            if job.simulate and was is None:
                placed += _place_starting_labware(compiled, cells[0].workcell, placed)
    elif job.simulate and not is_simulated:
        raise BadInput(
            f"The lab {f'at {url}' if url else f'in {settings.home}'} is real.",
            remedy="Leave --simulate out, or use another --home.",
        )
    elif job.workcell.endswith((".yaml", ".yml")):
        cell = read_workcell(job.workcell).workcell.name
    with end_in_order(), some_lab(settings, cells, url) as client:
        after = client.health()["position"]
        run = submit(client, job, cell, placed)
        if say_waits and is_simulated is not None and not quiet:
            _say_waits(client, run)
        return Narrator(client, after).follow_run(run, quiet=quiet)


def _is_simulated(settings: Settings, url: str) -> bool | None:
    """Whether the lab at ``url``, or in the home folder, has a simulated bench; None if no lab runs. Raises
    LabUnreachable."""
    from labos.client import LabClient

    if url:
        with LabClient(url) as client:
            return bool(client.health()["simulated"])
    running = find_kernel(settings.home)
    return None if running is None else running.simulated


def _find_workcell_beside(workflow: str) -> str:
    """The workcell file in the folder of a workflow's file, or in a parent folder; empty if there is none.
    Raises BadInput if there are several."""
    from labos.spec.files import find_workcells

    path = Path(workflow)
    is_file = path.suffix in (".yaml", ".yml") and path.is_file()
    found = find_workcells(path.resolve().parent) if is_file else []
    if len(found) > 1:
        names = ", ".join(each.name for each in found)
        raise BadInput(
            f"The workcell is ambiguous: {found[0].parent} holds {names}.",
            remedy=f"Name it: --workcell {found[0]}",
        )
    for each in found:
        click.echo(f"labos: on the workcell of {each} (--workcell names another)", err=True)
    return str(found[0]) if found else ""


def _place_starting_labware(compiled: Compiled, cell: Workcell, placed: Sequence[Put]) -> list[Put]:
    """The labware that a person would have to bring for a workflow, placed on the simulated bench of its own
    lab."""
    found: list[Put] = []
    aliases = {alias: local(station.name) for station in cell.stations for alias in station.aliases}
    filled = {aliases.get(place, place) for place, *_ in placed}
    for brought in compiled.brought:
        station = local(brought.station)
        if station in filled:
            continue
        found.append((station, brought.labware, {name: bool(v) for name, v in brought.variables.items()}))
        words = [name if value else f"not {name}" for name, value in found[-1][2].items()]
        what = ", ".join([brought.labware, *words])
        click.echo(
            f"labos: {what} is assumed to stand at {station} (use --place to name other labware)", err=True
        )
    return found


def submit(client: LabClient, job: RunRequest, workcell: str, placed: Sequence[Put]) -> str:
    """Queue the job together with the labware that was placed for it; returns the run's id."""
    run = client.submit(
        job.text,
        job.values,
        user=job.user,
        workcell=workcell,
        priority=job.priority,
        place=placed,
    )
    show_warnings(client)
    return run


def parse_places(placed: Sequence[str]) -> list[Put]:
    """Stations, labware types and variables of labware, as given with ``--place``. Raises BadParameter."""
    found: list[Put] = []
    for text in placed:
        station, _, what = text.partition("=")
        labware, *words = (word.strip() for word in what.split(","))
        if not station or not labware or not all(words):
            raise click.BadParameter(f"{text!r} is not STATION=TYPE.", param_hint="--place")
        variables = {word.removeprefix("not ").strip(): not word.startswith("not ") for word in words}
        found.append((station, labware, variables))
    return found


def _say_waits(client: LabClient, run: str) -> None:
    """Show why a new run does not start, if it may need a person."""
    for shown in client.state()["runs"]:
        for wait in shown["waits"] if shown["id"] == run else ():
            if wait["blocked"]:
                click.echo(f"{run} waits: {wait['why']}. To cancel it: labos cancel {run}")


def show_warnings(client: LabClient) -> None:
    """Show the warnings about the submission on standard error."""
    for warning in client.warnings:
        click.echo(f"labos: {warning} (warning)", err=True)


def show_result(result: RunResult) -> None:
    """Show how a run ended. Raises Exit(1) if it did not complete."""

    if wants_json():
        show_line(result)
    else:
        done = sum(step.state == "done" for step in result.steps)
        steps = sum(step.state != "asleep" for step in result.steps)
        took_s = (result.ended_at - result.started_at) / 1e9 if result.started_at else 0.0
        why = f": {result.why}" if result.why else ""
        click.echo(
            f"{result.id} ({result.workflow}) {result.status}{why}; "
            f"{done} of {steps} steps in {took_s:.1f} s."
        )
    if not result.succeeded:
        raise click.exceptions.Exit(1)
