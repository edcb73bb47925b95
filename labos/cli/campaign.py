"""``labos campaign``: a workflow for each row of a table."""

from __future__ import annotations

import csv
import sys
from typing import Any, get_args

import click
import msgspec

from labos.cli._forecast import show_campaign, show_change
from labos.cli._group import Suggesting
from labos.cli._lab import need_lab_of
from labos.cli._liveness import open_current_log
from labos.cli._options import (
    ENDED_SHOWN,
    Asker,
    all_option,
    asker_options,
    propose_option,
    why_option,
)
from labos.cli._out import end_with_json, report_done, show_table
from labos.cli._query import Where, log_and_json, open_log
from labos.cli._terms import terms_options
from labos.core.viewer import Visibility
from labos.errors import LabosError
from labos.services.campaigns import (
    CampaignHistory,
    RowHistory,
    list_campaign_histories,
    list_campaign_rows,
    read_campaign_history,
)
from labos.services.times import show_span, show_time

_campaign = click.argument("campaign", metavar="ID")


_request_option = click.option(
    "--request",
    default="",
    metavar="KEY",
    help="A key of the request: two requests with the same key create one campaign.",
)


@click.group("campaign", cls=Suggesting, short_help="Carry out a workflow for each row of a table.")
def command() -> None:
    """Carry out a workflow once for each row of a table.

    \b
    labos campaign plan screen.yaml       check every row, and estimate what it needs
    labos campaign submit screen.yaml     submit it
    labos campaign show C1                its progress
    labos campaign report C1 --csv        the results of its rows
    labos campaign clone C1               submit it once more
    """


@command.command("submit")
@click.argument("file")
@_request_option
@propose_option
@asker_options
def submit(file: str, asker: Asker, request: str, propose: bool) -> None:
    """Check the campaign FILE, row by row, submit it, and print its id. If a row has errors, nothing is
    submitted."""
    with asker.lab() as client:
        answer = client.submit_campaign(file, user=asker.user, request=request, propose=propose)
    end_with_json(answer)
    if answer["approval"]:
        click.echo(f"labos: {answer['approval']}", err=True)
    click.echo(answer["campaign"])


@command.command("plan")
@click.argument("file")
@asker_options
def plan(file: str, asker: Asker) -> None:
    """Check the campaign FILE, row by row, and estimate which resources and how much time it needs. Forecast
    when it starts and ends, which runs it delays, and when a person is needed. Nothing is submitted.

    The minimum duration of the campaign is the nominal time that its busiest module needs for all rows.
    The forecast simulates the lab from its present state, with the campaign and without it.
    """
    with asker.lab() as client:
        answer = client.forecast_campaign(file, user=asker.user)
    estimate, forecast = answer["estimate"], answer["forecast"]
    end_with_json({**estimate, "forecast": forecast})
    checked = (
        "" if estimate["checked"] == estimate["rows"] else f" ({estimate['checked']} of them were checked)"
    )
    click.echo(
        f"{estimate['name']}: {estimate['rows']} rows of {estimate['workflow']} "
        f"in {estimate['workcell']}{checked}"
    )
    click.echo(f"module time: {show_span(estimate['module_time_s'])}")
    click.echo(f"at least:    {show_span(estimate['bounds_s'])}, for {estimate['busiest']}")
    rows = [
        (kind, f"{item['needed']:g}", "not counted" if item["left"] is None else f"{item['left']:g}")
        for kind, item in estimate["consumables"].items()
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
@click.option("--archived", is_flag=True, help="Show archived campaigns too.")
@log_and_json
def list_(where: Where, everything: bool, archived: bool) -> None:
    """List open campaigns and the last completed ones, without archived campaigns and private campaigns of
    other users."""
    with open_current_log(where) as store:
        stories = [s for s in list_campaign_histories(store).values() if archived or not s.archived]
    ended = [story.campaign.id for story in stories if story.ended_at]
    hidden = set() if everything else set(ended[:-ENDED_SHOWN])
    shown = [story for story in stories if story.campaign.id not in hidden]
    end_with_json([_make_plain(story) for story in shown])
    titles = ("id", "name", "user", "status", "rows", "submitted", "took")
    show_table(titles, [_row(story) for story in shown])
    if hidden:
        click.echo(f"{len(hidden)} more campaigns have ended: labos campaign list --all")


@command.command("show")
@_campaign
@log_and_json
def show(where: Where, campaign: str) -> None:
    """Show the progress and the terms of a campaign. If the lab is running, show also when the campaign is
    expected to end (not with --json: use `labos forecast`)."""
    with open_log(where) as store:
        story = read_campaign_history(store, campaign)
    end_with_json(_make_plain(story))
    found, terms = story.campaign, story.campaign.terms
    budget = terms.budget
    lines = {
        "name": found.name,
        "user": found.user,
        "workflow": f"{found.workflow} in {found.workcell}",
        "status": f"{story.status} ({found.why})" if found.why else story.status,
        "rows": _describe_counts(story),
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
        "seen by": {"lab": "", "group": "the group of its user", "private": "its user"}[story.visibility],
        "clone of": found.cloned_from,
        "archived": "yes" if story.archived else "",
        **_find_expected(where, story),
    }
    show_table(("what", found.id), [(what, text) for what, text in lines.items() if text])


@command.command("report")
@_campaign
@click.option("--csv", "as_csv", is_flag=True, help="CSV, for spreadsheets.")
@log_and_json
def report(where: Where, campaign: str, as_csv: bool) -> None:
    """Show the rows of a campaign with their values, runs and results."""
    with open_log(where) as store:
        rows = list_campaign_rows(store, campaign)
    end_with_json(rows)
    values = [_flatten_table(row.payload) for row in rows]
    results = [_flatten_table(row.results) for row in rows]
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
@why_option()
@asker_options
def pause(campaign: str, asker: Asker, why: str) -> None:
    """Pause a campaign: submit no further row, and start none of its waiting runs. Active runs continue."""
    with asker.lab() as client:
        client.pause_campaign(campaign, asker.user, why=why)
    report_done(f"{campaign} is paused.", {"campaign": campaign, "paused": True})


@command.command("resume")
@_campaign
@asker_options
def resume(campaign: str, asker: Asker) -> None:
    """Resume a paused campaign."""
    with asker.lab() as client:
        client.resume_campaign(campaign, asker.user)
    report_done(f"{campaign} continues.", {"campaign": campaign, "paused": False})


@command.command("archive")
@_campaign
@click.option("--undo", is_flag=True, help="Show it in lists again.")
@asker_options
def archive(campaign: str, asker: Asker, undo: bool) -> None:
    """Hide an ended campaign in lists. Nothing is deleted: `labos campaign list --archived` still shows it,
    and all other commands accept its id."""
    with asker.lab() as client:
        client.archive_campaign(campaign, asker.user, undo=undo)
    message = f"{campaign} is shown in lists again." if undo else f"{campaign} is archived."
    report_done(message, {"campaign": campaign, "archived": not undo})


@command.command("cancel")
@_campaign
@why_option()
@click.option("--stay", is_flag=True, help="Leave the labware of its runs where it is.")
@asker_options
def cancel(campaign: str, asker: Asker, why: str, stay: bool) -> None:
    """Cancel a campaign: submit no further row, and cancel its runs."""
    with asker.lab() as client:
        client.cancel_campaign(campaign, asker.user, why=why, stay=stay)
    report_done(f"{campaign} is cancelled.", {"campaign": campaign, "cancelled": True})


@command.command("amend")
@_campaign
@terms_options
@asker_options
def amend(campaign: str, asker: Asker, terms_wanted: dict[str, Any]) -> None:
    """Change the terms of a campaign: priority, deadline, budget, stop rule, tags. Terms without an option
    stay as they are."""
    with asker.lab() as client:
        terms = client.amend_campaign(campaign, asker.user, **terms_wanted)
        if client.approval:
            click.echo(f"labos: {client.approval}", err=True)
    end_with_json(terms)


@command.command("clone")
@_campaign
@click.option(
    "--name",
    default="",
    metavar="NAME",
    help="The name of the clone; the first campaign's name if not given.",
)
@click.option(
    "--visibility",
    type=click.Choice(get_args(Visibility)),
    help="The users who can see it, besides you and operators: everybody, your group, or nobody.",
)
@terms_options
@click.option("--dry-run", is_flag=True, help="Only check the campaign; submit nothing.")
@_request_option
@propose_option
@asker_options
def clone(campaign: str, asker: Asker, terms_wanted: dict[str, Any], **asked: Any) -> None:
    """Submit a campaign again, and print the id of the new campaign. The first campaign may have ended. The
    clone has the same rows and the same workflow, and belongs to you. The lab checks each row again. Terms
    without an option are copied from the first campaign, except the deadline: the clone has none.

    \b
    labos campaign clone C1 --priority 2 --deadline 36h
    labos campaign clone C1 --dry-run
    """
    with asker.lab() as client:
        answer = client.clone_campaign(campaign, asker.user, **asked, **terms_wanted)
    end_with_json(answer)
    if answer["approval"]:
        click.echo(f"labos: {answer['approval']}", err=True)
    estimate = answer["estimate"]
    click.echo(answer["campaign"] or f"{estimate['rows']} rows of {estimate['workflow']} can be carried out.")


def _find_expected(where: Where, story: CampaignHistory) -> dict[str, str]:
    """When a campaign in progress is expected to start and end, if a running lab has a forecast."""
    if story.ended_at:
        return {}
    try:
        with need_lab_of(where) as client:
            found = client.forecast()["forecast"]
    except LabosError:
        return {}
    known = [each for each in found["campaigns"] if each["campaign"] == story.campaign.id]
    return dict(show_campaign(known[0], found["now_at"])) if known else {}


def _make_plain(story: CampaignHistory) -> dict[str, Any]:
    """For programs: without fields that only the fold needs."""
    found: dict[str, Any] = msgspec.to_builtins(story.campaign)
    for key in ("reads", "results", "met_by", "spent_ns", "first_started_at"):
        del found[key]
    more = {"status": story.status, "left": story.campaign.left, "ended_at": story.ended_at}
    return {**found, **more, "visibility": story.visibility, "archived": story.archived}


def _describe_counts(story: CampaignHistory) -> str:
    found = story.campaign
    kinds = {
        "completed": found.completed,
        "failed": found.failed,
        "cancelled": found.cancelled,
        "refused": found.refused,
        "active": len(found.runs) - found.queued,
        "waiting": found.queued,
        "left": found.left,
    }
    return f"{found.rows}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)


def _row(story: CampaignHistory) -> tuple[str, ...]:
    found = story.campaign
    took = show_span((story.ended_at - found.submitted_at) / 1e9) if story.ended_at else ""
    submitted = show_time(found.submitted_at)
    return found.id, found.name, found.user, story.status, _describe_counts(story), submitted, took


def _begin(row: RowHistory) -> tuple[str, ...]:
    span = show_span((row.ended_at - row.started_at) / 1e9) if row.ended_at and row.started_at else ""
    return str(row.row + 1), row.run, row.status, span


def _flatten_table(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            found.update(_flatten_table(value, f"{prefix}{key}."))
        else:
            found[f"{prefix}{key}"] = value
    return found


def _text(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else msgspec.json.encode(value).decode()
