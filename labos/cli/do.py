"""``labos do``, ``reset`` and ``home``: one action of one module, as a run of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from labos.cli._complete import make_completer
from labos.cli._options import (
    json_option,
    lab_options,
    options_together,
    priority_option,
    quiet_option,
    simulate_option,
    user_option,
    wait_option,
)
from labos.cli._out import wants_json
from labos.cli._payload import read_value
from labos.cli._remote import lab_of
from labos.cli.run import RunRequest, carry_out, parse_places, show_result, submit
from labos.errors import BadInput
from labos.settings import Settings

_options = options_together(
    click.option("--workcell", metavar="NAME|FILE", help="The workcell, if the lab has several."),
    simulate_option,
    click.option(
        "--place",
        "placed",
        multiple=True,
        metavar="STATION=TYPE",
        help="Labware that stands at a station before the action, such as `hidex.default=plate96`.",
    ),
    user_option,
    priority_option,
    wait_option(
        "Wait for its end; otherwise queue it in the running lab and print the run's id.",
        default=True,
    ),
    lab_options,
    json_option,
    quiet_option,
)
"""The options of the three commands."""


@click.command("do")
@click.argument("module", shell_complete=make_completer("module"))
@click.argument("action")
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]...")
@_options
def do(module: str, action: str, arguments: tuple[str, ...], **options: Any) -> None:
    """Carry out one ACTION of MODULE, and wait for its end.

    The action is a run of one step. It is logged, queued and checked like a step of a workflow. It may use
    your own labware and shared labware. The command uses the running lab. If there is none, it starts a lab
    for this action only. Exit code 0 if the action succeeds, 1 if it fails or is refused.

    \b
    labos do sealer seal time=3.0
    labos do pf400 transfer source=sealer.default target=peeler.default
    labos do sciclops get_plate loc=tower1 --simulate
    """
    _carry_out(module, action, read_arguments(arguments), **options)


@click.command("reset")
@click.argument("module", shell_complete=make_completer("module"))
@_options
def reset(module: str, **options: Any) -> None:
    """Reset MODULE after an error. Same as `labos do MODULE reset`.

    A reset is an action: it is logged and done at most once. Unlike other actions, it may start while the
    module is in the state ERROR. Check the device first: a reset may move it.

    \b
    labos reset pf400
    """
    _carry_out(module, "reset", {}, **options)


@click.command("home")
@click.argument("module", shell_complete=make_completer("module"))
@_options
def home(module: str, **options: Any) -> None:
    """Move MODULE to its home position. Same as `labos do MODULE home`. Not every module has one.

    \b
    labos home sciclops
    """
    _carry_out(module, "home", {}, **options)


def read_arguments(given: Sequence[str]) -> dict[str, Any]:
    """``name=value`` with values as in a workflow file. Raises BadInput."""
    values: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise BadInput(f"{text!r} is not NAME=VALUE.", remedy="Write NAME=VALUE, such as time=3.0.")
        if name.strip() in values:
            raise BadInput(f"The argument {name.strip()!r} is given twice.", remedy="Leave one out.")
        values[name.strip()] = read_value(value)
    return values


def _carry_out(
    module: str,
    action: str,
    arguments: dict[str, Any],
    *,
    workcell: str | None,
    simulate: bool,
    placed: tuple[str, ...],
    user: str,
    priority: int,
    wait: bool,
    home: str | None,
    database: str | None,
    speed: float | None,
    seed: int,
    quiet: bool,
) -> None:
    from labos.client import step_text

    settings = Settings.make(home, database, speed=speed, simulate=True if simulate else None, seed=seed)
    job = RunRequest(
        step_text(module, action, arguments),
        user=user,
        workcell=workcell or module.rpartition("/")[0],
        placed=placed,
        priority=priority,
        simulate=simulate,
    )
    if not wait:
        _queue(job, home)
        return
    url = "" if database else lab_of(home)
    found = carry_out(job, settings, url=url, quiet=quiet or wants_json(), say_waits=True)
    show_result(found)


def _queue(job: Any, home: str | None) -> None:
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        run = submit(client, job, job.workcell, parse_places(job.placed))
    click.echo(f'{{"run": "{run}"}}' if wants_json() else run)
