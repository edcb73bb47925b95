"""``labos submit``: queue a workflow in the running lab."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._complete import make_completer, name_option
from labos.cli._options import Asker, asker_options, priority_option, propose_option, wait_option
from labos.cli._out import wants_json
from labos.cli._payload import payload_option, read_payload
from labos.cli.run import show_result, show_warnings


@click.command("submit")
@click.argument("workflow", shell_complete=make_completer("workflow"))
@payload_option
@click.option("--workcell", default="", metavar="NAME", help="The workcell, if the lab has several.")
@priority_option
@name_option("experiment", "ID", "The experiment to which the run belongs.")
@click.option(
    "--request",
    default="",
    metavar="KEY",
    help="A key of the request: two requests with the same key create one run.",
)
@click.option(
    "--due",
    default="",
    metavar="TIME",
    help="The time by which the run should end: 2026-05-04T10:30 in the lab's time, or 12h from now. "
    "Among your own runs, the run with the least time to spare goes first. labos explain shows whether it "
    "will be kept.",
)
@propose_option
@wait_option("Wait for the end of the run; exit code 1 if it does not complete.", default=False)
@asker_options
def command(workflow: str, payloads: tuple[str, ...], asker: Asker, wait: bool, **asked: Any) -> None:
    """Queue WORKFLOW, a file or a packaged workflow, and print the run's id.

    \b
    labos submit pcr --user ada
    labos submit my_workflow.yaml --payload values.yaml --payload seal.time=4 --wait
    labos submit pcr --due 12h
    """
    values = read_payload(payloads)
    with asker.lab() as client:
        run = client.submit(workflow, values, user=asker.user, **asked)
        show_warnings(client)
        if not wait:
            click.echo(f'{{"run": "{run}"}}' if wants_json() else run)
            return
        show_result(client.wait(run))
