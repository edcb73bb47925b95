"""``labos forecast``: when runs start and end, and when a person is needed."""

from __future__ import annotations

import click

from labos.cli._options import home_option, json_option
from labos.cli._out import show_json


@click.command("forecast", short_help="When runs start and end, and when a person is needed.")
@home_option
@json_option
def command(home: str | None, as_json: bool) -> None:
    """When each run starts and ends, and when a person is needed next.

    The lab as it is now is carried on in virtual time, with the durations that its log has taught.
    "about 14:20 (14:05–14:50)" is the middle, and the range in which four of five come: it is as wide as
    earlier forecasts of this lab were off, so others who submit more are in it. "If nobody else submits"
    stands beside it. Nothing fails in a forecast, and nobody fills anything up: a run that needs a person
    first is not in sight.
    """
    from labos.cli._forecast import show_campaign, show_runs, show_touches
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        told = client.forecast()
    if as_json:
        show_json(told)
        return
    found = told["forecast"]
    show_runs(found)
    for campaign in found["campaigns"]:
        said = "; ".join(f"{what} {text}" for what, text in show_campaign(campaign, found["now_at"]))
        click.echo(f"{campaign['campaign']} ({campaign['name']}): {said}")
    show_touches(found)
    for drift in told["drifts"]:
        click.echo(
            f"drift:       {drift['module']}.{drift['action']} takes {drift['takes_s']:.3g} s, "
            f"planned {drift['planned_s']:.3g} s"
        )
