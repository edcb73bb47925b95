"""Forecasts: start and end of everything that is submitted, and the effects of a new submission."""

from __future__ import annotations

import msgspec

from labos.core.lengths import Drift, find_drifts
from labos.http.bodies import NewCampaign, NewRun
from labos.http.campaigns import Estimate, forecast_campaign
from labos.http.operation import Call, Method, read, submit
from labos.http.routes.campaigns import CAMPAIGN
from labos.http.routes.runs import WORKFLOW
from labos.planning.lab_forecast import LabForecast
from labos.spec.findings import Finding


class Forecast(msgspec.Struct, frozen=True):
    """The forecast for the lab. ``drifts`` are the actions that take longer or shorter than planned."""

    forecast: LabForecast
    drifts: list[Drift]


class RunForecast(msgspec.Struct, frozen=True):
    """The forecast for a run, and the warnings about its workflow's files."""

    forecast: LabForecast
    warnings: tuple[Finding, ...] = ()


class CampaignForecast(msgspec.Struct, frozen=True):
    """The forecast for a campaign, and the work and material that all its rows need."""

    estimate: Estimate
    forecast: LabForecast


FORECAST_S = 180.0
"""How many seconds the lab may take for a forecast."""


@read(
    route="GET /forecast",
    client=Method("forecast", timeout_s=FORECAST_S),
    summary="Forecast when runs start and end, and when a person is needed",
    problems=("refused",),
)
async def get_forecast(call: Call) -> Forecast:
    """LabOS simulates the lab in virtual time with durations from its log. The simulation assumes that
    nothing fails and nobody refills a resource. The ranges are as wide as the errors of earlier forecasts. It
    covers the first 200 waiting runs."""
    forecast = await call.service.forecasts.queue()
    state = call.service.kernel.state
    return Forecast(hide_others(forecast, call), find_drifts(state.lengths, state.lab.pace))


@submit(
    route="POST /runs/forecast",
    client=Method("_forecast_run", "workflow", repeat=True, timeout_s=FORECAST_S),
    summary="Forecast when a run would start and end, without submitting it",
    example={"workflow": WORKFLOW, "user": "ada"},
)
async def forecast_run(call: Call, body: NewRun) -> RunForecast:
    """Nothing is submitted or stored. The run counts as approved."""
    service = call.service
    service.expect_role(body.user, "submitter")  # before anything is planned
    planned = await service.plan_run(body, propose=False)
    forecast = await service.forecasts.forecast(planned.command, body.user)
    return RunForecast(hide_others(forecast, call), planned.findings)


@submit(
    route="POST /campaigns/forecast",
    client=Method("forecast_campaign", by_hand=True),
    summary="Forecast a campaign and its needs, without submitting it",
    tag="campaigns",
    example=CAMPAIGN,
)
async def forecast_campaign_file(call: Call, body: NewCampaign) -> CampaignForecast:
    """The campaign is checked row by row. Nothing is submitted or stored. It counts as approved."""
    estimate, forecast = await forecast_campaign(call.service, body)
    return CampaignForecast(estimate, hide_others(forecast, call))


def hide_others(forecast: LabForecast, call: Call) -> LabForecast:
    """A forecast without the campaigns that the user does not see; runs that they delay or that delay them
    are not named either."""
    hidden = call.hidden
    if not hidden:
        return forecast
    runs = {run.run for run in forecast.runs if run.campaign in hidden}
    return msgspec.structs.replace(
        forecast,
        runs=[run for run in forecast.runs if run.run not in runs],
        campaigns=[campaign for campaign in forecast.campaigns if campaign.campaign not in hidden],
        touches=[touch for touch in forecast.touches if touch.run not in runs],
        delays=[delay for delay in forecast.delays if delay.campaign not in hidden],
    )
