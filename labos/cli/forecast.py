"""``labos forecast``: when runs start and end, and when a person is needed."""

from __future__ import annotations

import click

from labos.cli._forecast import show_campaign, show_runs, show_touches
from labos.cli._options import Asker, lab_and_json
from labos.cli._out import end_with_json


@click.command("forecast", short_help="Forecast when runs start and end, and when a person is needed.")
@lab_and_json
def command(asker: Asker) -> None:
    """Forecast when each run starts and ends, and when a person is needed next.

    LabOS simulates the lab from its present state in virtual time, with durations learned from its log.
    "about 14:20 (14:05–14:50)" is the median, and the range for four of five cases. The range comes from
    the errors of earlier forecasts of this lab, so it includes delays by later submissions. The column "if
    nobody else submits" does not. In a forecast no step fails, and nobody refills a resource. A run that
    needs a person first has no forecast.
    """
    with asker.lab() as client:
        answer = client.forecast()
    end_with_json(answer)
    found = answer["forecast"]
    show_runs(found)
    for campaign in found["campaigns"]:
        line = "; ".join(f"{what} {text}" for what, text in show_campaign(campaign, found["now_at"]))
        click.echo(f"{campaign['campaign']} ({campaign['name']}): {line}")
    show_touches(found)
    for drift in answer["drifts"]:
        click.echo(
            f"drift:       {drift['module']}.{drift['action']} takes {drift['takes_s']:.3g} s, "
            f"planned {drift['planned_s']:.3g} s"
        )
