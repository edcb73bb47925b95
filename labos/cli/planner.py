"""``labos planner``: suggests to a running lab the order of the next steps."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, cast

import click
import msgspec

from labos.cli._lab import end_in_order, need_lab_of
from labos.cli._options import user_option
from labos.cli._orders import ask_order_setting
from labos.cli._query import Where, log_options, now_ns, open_log
from labos.errors import LabosError

if TYPE_CHECKING:
    from labos.client import LabClient
    from labos.core.state import LabState
    from labos.planner.planner import Planner
    from labos.planner.watch import CellWatch
    from labos.ports import EventStore

LOOK_S = 0.5
"""How often the log is checked for new events."""

LOST_PAUSE_S = 5.0
"""The pause between two attempts to reach a lab that is away."""


@click.command("planner", short_help="Search for a better order of steps, and suggest it to the lab.")
@click.option(
    "--seconds",
    type=click.FloatRange(0.1, 600),
    default=5.0,
    show_default=True,
    help="How long to search for an order each time. For runs with windows, a search takes up to about 5 s.",
)
@click.option(
    "--quantile",
    "level",
    type=click.FloatRange(0, 1),
    default=0.5,
    show_default=True,
    metavar="0..1",
    help="The quantile of measured durations to plan with: 0.5 is the median, 0.8 is longer. Where "
    "the lab has its own order for windows, the median counts.",
)
@click.option(
    "--end-weight",
    type=click.IntRange(1, 100),
    default=1,
    show_default=True,
    help="The weight of the end of the last run; the mean end of all runs has the weight 1.",
)
@click.option(
    "--pause",
    "pause_s",
    type=click.FloatRange(0, 3600),
    default=5.0,
    show_default=True,
    metavar="SECONDS",
    help="The minimum time between two searches for a workcell.",
)
@click.option(
    "--workcell", "cells", multiple=True, metavar="NAME", help="Only for this workcell; may be repeated."
)
@click.option("--once", is_flag=True, help="Suggest one order for each workcell, then end.")
@user_option
@log_options
def command(
    where: Where, pause_s: float, cells: tuple[str, ...], once: bool, user: str, **search: Any
) -> None:
    """Search for a better order of the next steps and suggest it to a running lab, until Ctrl-C.

    The planner follows the log. When a run is submitted or ends, or when a step takes longer than planned,
    it searches for the order in which all known runs would end soonest. It simulates the lab with and
    without this order, and suggests the order if it is better. The lab still applies its own rules,
    windows and deadlock avoidance. A bad suggestion can change only the order of steps. `labos
    explain RUN` shows whether a run waits because of a suggestion. The planner needs OR-tools: python -m
    pip install "labos-sdl[plan]". See docs/scheduling.md.

    \b
    labos planner
    labos planner --workcell rpl --seconds 10
    """
    from labos.planner.planner import Planner
    from labos.planner.solve import expect_solver
    from labos.planner.watch import CellWatch
    from labos.runtime.follower import Follower

    expect_solver()
    watch = CellWatch()
    planner = Planner(searches=ask_order_setting(where), **search)
    next_look: dict[str, float] = {}
    with end_in_order(), need_lab_of(where) as client, open_log(where, stored=True) as log:
        follower = Follower(cast("EventStore", log))  # it only reads
        try:
            while True:
                try:
                    follower.catch_up()
                    for cell in cells or sorted(follower.state.lab.workcells):
                        if time.monotonic() < next_look.get(cell, 0.0):
                            continue
                        if _suggest(follower.state, cell, planner, watch, client, user):
                            next_look[cell] = time.monotonic() + pause_s
                    if once:
                        return
                    time.sleep(LOOK_S)
                except LabosError as error:
                    if once:
                        raise
                    click.echo(f"labos: {error}", err=True)
                    time.sleep(LOST_PAUSE_S)
        except KeyboardInterrupt:
            click.echo("The planner is closed. Its last suggestion stays in force until it expires.")


def _suggest(
    state: LabState, cell: str, planner: Planner, watch: CellWatch, client: LabClient, asker: str
) -> bool:
    """Search for a better order for a workcell if that is worthwhile; returns whether it was."""
    from labos.planner.watch import list_waiting

    waiting = list_waiting(state, cell)
    now = now_ns()
    if not watch.is_due(state, cell, waiting, now) and not planner.is_due(state, cell, waiting, now):
        return False
    order = planner.suggest(state, cell, waiting, now_ns())
    watch.note(state, cell, waiting, order, now_ns())
    if order is None:
        return True
    steps = [msgspec.to_builtins(one) for one in order.steps]
    line = [str(run) for run in order.line]
    taken = client.suggest_order(cell, steps, order.until, order.position, line=line, by=asker)
    if line:
        click.echo(f"{cell}: an order of {len(line)} runs. The lab's own search begins with it.")
    elif not steps:
        click.echo(f"{cell}: the last order is withdrawn. The lab is at least as good without it.")
    elif all(one.outside for one in order.steps):
        click.echo(f"{cell}: {taken} runs wait outside, so that they do not block others.")
    else:
        click.echo(f"{cell}: an order for {taken} steps of {len({one.run for one in order.steps})} runs.")
    return True
