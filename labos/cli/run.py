"""``labos run``: a workflow from start to end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from labos.cli._options import json_option, lab_options, user_option, who
from labos.cli._payload import payload_option

if TYPE_CHECKING:
    from labos.client import LabClient, RunResult


@click.command("run")
@click.argument("workflow")
@payload_option
@click.option("--workcell", metavar="NAME|FILE", help="The workcell (the lab's own; rpl in a new lab).")
@click.option("--simulate", is_flag=True, help="On simulated instruments; a running lab must be simulated.")
@click.option(
    "--place",
    "placed",
    multiple=True,
    metavar="STATION=TYPE",
    help="Labware that stands there before the run, as `camera_module.plate_station=plate96`.",
)
@user_option
@click.option("--priority", type=int, default=0, show_default=True, help="Higher goes first.")
@lab_options
@json_option
@click.option("--quiet", is_flag=True, help="Only the end.")
def command(
    workflow: str,
    payloads: tuple[str, ...],
    workcell: str | None,
    simulate: bool,
    placed: tuple[str, ...],
    user: str | None,
    priority: int,
    home: str | None,
    database: str | None,
    speed: float | None,
    seed: int,
    as_json: bool,
    quiet: bool,
) -> None:
    """Run WORKFLOW, a file or a packaged workflow, and wait for its end.

    In the running lab if there is one, else in a lab of its own that ends with the run.
    Exit code 0 if it completes, 1 if it fails, is cancelled or is refused.

    \b
    labos run pcr --simulate --speed 600
    labos run wf.yaml --workcell workcell.yaml --simulate --payload seal.time=3
    labos run mix.yaml --simulate --place camera_module.plate_station=plate96 --payload mix.json
    """
    from labos.cli._lab import check_first, orderly, read_workcell, some_lab
    from labos.cli._payload import read_payload
    from labos.client import workflow_text
    from labos.errors import BadInput
    from labos.settings import Settings, find_kernel, was_simulated
    from labos.spec import parse_workflow

    values = read_payload(payloads)
    settings = Settings.of(home, database, speed=speed, simulate=True if simulate else None, seed=seed)
    # What is wrong with the file itself is said before a lab is started for it.
    text = workflow_text(workflow, values)
    parse_workflow(text["text"], text["name"])
    running = find_kernel(settings.home)
    cells, cell = [], workcell or ""
    if running is None:
        was = was_simulated(settings)
        if not simulate and was is None:
            raise BadInput(
                f"No lab runs in {settings.home}.",
                remedy="Add --simulate to run it on simulated instruments, or start a lab with `labos up`.",
            )
        if workcell or was is None:
            cells = [read_workcell(workcell or "rpl")]
            cell = cells[0].workcell.name
            check_first(workflow, values, cells[0], simulate=simulate or bool(was))
    elif simulate and not running.simulated:
        raise BadInput(
            f"The lab in {settings.home} is real.", remedy="Leave --simulate out, or use another --home."
        )
    elif workcell and workcell.endswith((".yaml", ".yml")):
        cell = read_workcell(workcell).workcell.name
    with orderly(), some_lab(settings, cells) as client:
        result = _run(client, workflow, values, cell, placed, who(user), priority, quiet or as_json)
    show_result(result, as_json=as_json)


def _run(
    client: LabClient,
    workflow: str,
    values: dict[str, object],
    workcell: str,
    placed: tuple[str, ...],
    user: str,
    priority: int,
    quiet: bool,
) -> RunResult:
    from labos.cli._narrate import Narrator

    for place in placed:
        station, equals, labware = place.partition("=")
        if not equals or not station or not labware:
            raise click.BadParameter(f"{place!r} is not STATION=TYPE.", param_hint="--place")
        client.place(f"{workcell}/{station}" if workcell and "/" not in station else station, labware, user)
    after = client.health()["position"]
    run = client.submit(workflow, values, user=user, workcell=workcell, priority=priority)
    show_warnings(client)
    return Narrator(client, after).follow_run(run, quiet=quiet)


def show_warnings(client: LabClient) -> None:
    """What the lab remarked on the submission, on standard error."""
    for warning in client.warnings:
        click.echo(f"labos: {warning} (warning)", err=True)


def show_result(result: RunResult, *, as_json: bool) -> None:
    """How a run ended. Raises Exit(1) if it did not complete."""
    from labos.cli._out import show_line

    if as_json:
        show_line(result)
    else:
        done = sum(step.state == "done" for step in result.steps)
        took_s = (result.ended_at - result.started_at) / 1e9 if result.started_at else 0.0
        why = f": {result.why}" if result.why else ""
        click.echo(
            f"{result.id} ({result.workflow}) {result.status}{why}; "
            f"{done} of {len(result.steps)} steps in {took_s:.1f} s."
        )
    if not result.succeeded:
        raise click.exceptions.Exit(1)
