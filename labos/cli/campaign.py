"""``labos campaign``: a workflow for each row of a table."""

from __future__ import annotations

import csv
import sys
from typing import Any

import click
import msgspec

from labos.cli._group import Suggesting
from labos.cli._liveness import say_if_dead
from labos.cli._options import (
    ENDED_SHOWN,
    all_option,
    find_user,
    home_option,
    json_option,
    propose_option,
    user_option,
    why_option,
)
from labos.cli._out import show_json, show_table, tell
from labos.cli._query import Where, log_options, open_log
from labos.services.campaigns import (
    CampaignHistory,
    RowHistory,
    campaign_histories,
    campaign_history,
    campaign_rows,
)
from labos.services.times import show_span, show_time

_campaign = click.argument("campaign", metavar="ID")


@click.group("campaign", cls=Suggesting, short_help="Campaigns: a workflow for each row of a table.")
def command() -> None:
    """A workflow, carried out once for each row of a table.

    \b
    labos campaign plan screen.yaml       check every row, and estimate what it needs
    labos campaign submit screen.yaml     submit it
    labos campaign show C1                its progress
    labos campaign report C1 --csv        the results of its rows
    """


@command.command("submit")
@click.argument("file")
@user_option
@click.option("--request", default="", metavar="KEY", help="The same key twice is one campaign.")
@propose_option
@home_option
@json_option
def submit(file: str, user: str | None, request: str, propose: bool, home: str | None, as_json: bool) -> None:
    """Check the campaign FILE, row by row, submit it, and print its id. If a row cannot be carried out,
    nothing is submitted."""
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        told = client.submit_campaign(file, user=find_user(user), request=request, propose=propose)
    if as_json:
        show_json(told)
        return
    if told["approval"]:
        click.echo(f"labos: {told['approval']}", err=True)
    click.echo(told["campaign"])


@command.command("plan")
@click.argument("file")
@user_option
@home_option
@json_option
def plan(file: str, user: str | None, home: str | None, as_json: bool) -> None:
    """Check the campaign FILE, row by row, estimate what it needs from the lab, and forecast when it starts
    and ends, whom it delays and when a person is needed. Nothing is submitted.

    What the busiest module needs for all rows is the least that the campaign takes, in nominal times.
    The forecast carries the lab on as it is now, with the campaign and without it.
    """
    from labos.cli._forecast import show_campaign, show_change
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        answer = client.forecast_campaign(file, user=find_user(user))
    told, forecast = answer["estimate"], answer["forecast"]
    if as_json:
        show_json({**told, "forecast": forecast})
        return
    checked = "" if told["checked"] == told["rows"] else f" ({told['checked']} of them were checked)"
    click.echo(f"{told['name']}: {told['rows']} rows of {told['workflow']} in {told['workcell']}{checked}")
    click.echo(f"module time: {show_span(told['module_time_s'])}")
    click.echo(f"at least:    {show_span(told['bounds_s'])}, for {told['busiest']}")
    rows = [
        (kind, f"{item['needed']:g}", "not counted" if item["left"] is None else f"{item['left']:g}")
        for kind, item in told["consumables"].items()
    ]
    if rows:
        show_table(("consumable", "needed", "left"), rows)
    if forecast["refusal"]:
        click.echo(f"It would be refused: {forecast['refusal']}")
        return
    for campaign in forecast["campaigns"][-1:]:
        for what, text in show_campaign(campaign, forecast["now_at"]):
            click.echo(f"{what + ':':<12} {text}")
    show_change(forecast)


@command.command("list")
@all_option
@json_option
@log_options
def list_(where: Where, everything: bool, as_json: bool) -> None:
    """Campaigns that have not been completed and the last ones that have."""
    with open_log(where) as store:
        say_if_dead(where.url, store.head())
        told = list(campaign_histories(store).values())
    ended = [story.campaign.id for story in told if story.ended_at]
    hidden = set() if everything else set(ended[:-ENDED_SHOWN])
    shown = [story for story in told if story.campaign.id not in hidden]
    if as_json:
        show_json([_plain(story) for story in shown])
        return
    titles = ("id", "name", "user", "status", "rows", "submitted", "took")
    show_table(titles, [_row(story) for story in shown])
    if hidden:
        click.echo(f"{len(hidden)} more campaigns have ended: labos campaign list --all")


@command.command("show")
@_campaign
@json_option
@log_options
def show(where: Where, campaign: str, as_json: bool) -> None:
    """The progress of a campaign, its terms, and in a lab that runs when it is expected to end (with --json,
    `labos forecast` tells that)."""
    with open_log(where) as store:
        story = campaign_history(store, campaign)
    if as_json:
        show_json(_plain(story))
        return
    found, terms = story.campaign, story.campaign.terms
    budget = terms.budget
    lines = {
        "name": found.name,
        "user": found.user,
        "workflow": f"{found.workflow} in {found.workcell}",
        "status": f"{story.status} ({found.why})" if found.why else story.status,
        "rows": _counts(story),
        "submitted": show_time(found.submitted_at),
        "completed": show_time(story.ended_at),
        "priority": str(terms.priority),
        "deadline": show_time(terms.deadline),
        "stop rule": terms.until.text if terms.until is not None else "",
        "failures": f"stops after {terms.stop_after}" if terms.stop_after else "go on",
        "most runs": str(budget.runs) if budget.runs else "",
        "most lab time": show_span(budget.lab_time_s) if budget.lab_time_s else "",
        "used": ", ".join(f"{amount:g} {kind}" for kind, amount in found.used.items()),
        "most consumables": ", ".join(f"{amount:g} {kind}" for kind, amount in budget.consumables.items()),
        "tags": ", ".join(terms.tags),
        **_find_expected(where, story),
    }
    show_table(("what", found.id), [(what, text) for what, text in lines.items() if text])


@command.command("report")
@_campaign
@click.option("--csv", "as_csv", is_flag=True, help="CSV, for spreadsheets.")
@json_option
@log_options
def report(where: Where, campaign: str, as_csv: bool, as_json: bool) -> None:
    """The rows of a campaign: their values, runs, and the results of their steps."""
    with open_log(where) as store:
        rows = campaign_rows(store, campaign)
    if as_json:
        show_json(rows)
        return
    values = [_flat(row.payload) for row in rows]
    results = [_flat(row.results) for row in rows]
    keys = list(dict.fromkeys(key for row in values for key in row))
    given = list(dict.fromkeys(key for row in results for key in row))
    titles = ("row", "run", "status", "took", *keys, *given, "why")
    lines = [
        (*_begin(row), *(_text(v.get(key)) for key in keys), *(_text(r.get(key)) for key in given), row.why)
        for row, v, r in zip(rows, values, results, strict=True)
    ]
    if as_csv:
        csv.writer(sys.stdout, lineterminator="\n").writerows([titles, *lines])
        return
    show_table(titles, lines)


@command.command("pause")
@_campaign
@user_option
@why_option()
@home_option
@json_option
def pause(campaign: str, user: str | None, why: str, home: str | None, as_json: bool) -> None:
    """Submit no further row of a campaign and start none of its runs that wait. Runs under way go on."""
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        client.pause_campaign(campaign, find_user(user), why=why)
    tell(f"{campaign} is paused.", {"campaign": campaign, "paused": True}, as_json=as_json)


@command.command("resume")
@_campaign
@user_option
@home_option
@json_option
def resume(campaign: str, user: str | None, home: str | None, as_json: bool) -> None:
    """Let a paused campaign go on."""
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        client.resume_campaign(campaign, find_user(user))
    tell(f"{campaign} goes on.", {"campaign": campaign, "paused": False}, as_json=as_json)


@command.command("cancel")
@_campaign
@user_option
@why_option()
@click.option("--stay", is_flag=True, help="The labware of its runs stays where it is.")
@home_option
@json_option
def cancel(campaign: str, user: str | None, why: str, stay: bool, home: str | None, as_json: bool) -> None:
    """Submit no further row of a campaign, and cancel its runs."""
    from labos.cli._lab import need_lab

    with need_lab(home) as client:
        client.cancel_campaign(campaign, find_user(user), why=why, stay=stay)
    tell(f"{campaign} is cancelled.", {"campaign": campaign, "cancelled": True}, as_json=as_json)


@command.command("amend")
@_campaign
@user_option
@click.option("--priority", type=int, help="The priority of rows that are submitted from now on.")
@click.option("--deadline", metavar="TIME", help="2026-05-04T10:30, 12h from now, or empty for none.")
@click.option("--runs", type=click.IntRange(min=0), help="So many runs at most; 0: no limit.")
@click.option("--lab-time", metavar="TIME", help="So much module time at most, as `20 h`; 0: no limit.")
@click.option("--consumable", "consumables", multiple=True, metavar="KIND=AMOUNT", help="So much at most.")
@click.option("--until", metavar="RULE", help="The stop rule; empty for none.")
@click.option("--stop-after", type=click.IntRange(min=0), help="So many rows may fail; 0: however many.")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="Its tags, in place of those it has.")
@home_option
@json_option
def amend(
    campaign: str,
    user: str | None,
    lab_time: str | None,
    consumables: tuple[str, ...],
    tags: tuple[str, ...],
    home: str | None,
    as_json: bool,
    **changes: Any,
) -> None:
    """Change the terms of a campaign: priority, deadline, budget, stop rule, tags. What is not given
    stays."""
    from labos.cli._lab import need_lab
    from labos.spec.durations import parse_duration

    told = {name: value for name, value in changes.items() if value is not None}
    if lab_time is not None:
        try:
            told["lab_time_s"] = parse_duration(lab_time)
        except ValueError as error:
            raise click.BadParameter(f"{error}.", param_hint="--lab-time") from None
    if consumables:
        told["consumables"] = dict(map(amount_of, consumables))
    if tags:
        told["tags"] = list(tags)
    with need_lab(home) as client:
        terms = client.amend_campaign(campaign, find_user(user), **told)
        if client.approval:
            click.echo(f"labos: {client.approval}", err=True)
    if as_json:
        show_json(terms)


def _find_expected(where: Where, story: CampaignHistory) -> dict[str, str]:
    """When a campaign that goes on starts and ends, if a lab runs that can say so."""
    from labos.cli._forecast import show_campaign
    from labos.cli._lab import need_lab_of
    from labos.errors import LabosError

    if story.ended_at:
        return {}
    try:
        with need_lab_of(where) as client:
            found = client.forecast()["forecast"]
    except LabosError:
        return {}
    known = [each for each in found["campaigns"] if each["campaign"] == story.campaign.id]
    return dict(show_campaign(known[0], found["now_at"])) if known else {}


def amount_of(text: str) -> tuple[str, float]:
    kind, _, amount = text.partition("=")
    try:
        return kind, float(amount)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not KIND=AMOUNT.", param_hint="--consumable") from None


def _plain(story: CampaignHistory) -> dict[str, Any]:
    """For programs: without what only the fold needs."""
    found: dict[str, Any] = msgspec.to_builtins(story.campaign)
    for key in ("reads", "results", "met_by", "spent_ns", "first_started_at"):
        del found[key]
    return {**found, "status": story.status, "left": story.campaign.left, "ended_at": story.ended_at}


def _counts(story: CampaignHistory) -> str:
    found = story.campaign
    kinds = {
        "completed": found.completed,
        "failed": found.failed,
        "cancelled": found.cancelled,
        "refused": found.refused,
        "under way": len(found.runs) - found.queued,
        "waiting": found.queued,
        "left": found.left,
    }
    return f"{found.rows}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)


def _row(story: CampaignHistory) -> tuple[str, ...]:
    found = story.campaign
    took = show_span((story.ended_at - found.submitted_at) / 1e9) if story.ended_at else ""
    submitted = show_time(found.submitted_at)
    return found.id, found.name, found.user, story.status, _counts(story), submitted, took


def _begin(row: RowHistory) -> tuple[str, ...]:
    span = show_span((row.ended_at - row.started_at) / 1e9) if row.ended_at and row.started_at else ""
    return str(row.row + 1), row.run, row.status, span


def _flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            found.update(_flat(value, f"{prefix}{key}."))
        else:
            found[f"{prefix}{key}"] = value
    return found


def _text(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else msgspec.json.encode(value).decode()
