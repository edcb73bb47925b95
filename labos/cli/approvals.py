"""``labos approvals``, ``approve`` and ``refuse``: submissions that wait for an operator's approval; and
``labos policy``: which ones do."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from labos.cli._forecast import show_campaign, show_change, show_ways
from labos.cli._options import Asker, asker_options, lab_and_json, why_option
from labos.cli._out import end_with_json, report_done, show_table, wants_json
from labos.cli._terms import as_seconds, consumable_option
from labos.cli.shares import read_file
from labos.errors import LabosError
from labos.services.times import show_span, show_time

if TYPE_CHECKING:
    from labos.client import LabClient

DIGEST_SHOWN = 12

_subject = click.argument("subject", metavar="ID")


@click.command("approvals", short_help="List requests that wait for an approval, and why.")
@click.argument("subject", metavar="ID", required=False)
@click.option("--no-forecast", is_flag=True, help="Do not forecast the effects of an approval.")
@lab_and_json
def approvals(subject: str | None, no_forecast: bool, asker: Asker) -> None:
    """List runs, campaigns, experiments and changes of campaigns that wait for an approval by the lab's
    policy. With an ID, show what it requests, a forecast for an approval now (start, end, delayed runs,
    consumption), and the differences from the last approved request with the same name.

    \b
    labos approvals
    labos approvals C3
    labos approve C3 --runs 20 --why "twenty are enough"
    labos refuse C3 --why "the reader is booked"
    """
    with asker.lab() as client:
        answer: Any = client.approval_of(subject) if subject else client.approvals()
        forecast = _forecast(client, subject, answer) if subject and not no_forecast else None
    if forecast is not None:
        answer["forecast"] = forecast
    end_with_json(answer)
    if subject:
        _show(answer)
        if forecast is not None:
            _show_forecast(forecast, subject)
    elif not answer:
        click.echo("Nothing waits for an approval.")
    else:
        rows = [
            (
                p["subject"],
                p["kind"],
                p["name"],
                p["user"],
                show_time(p["requested_at"]),
                _describe_reasons(p),
            )
            for p in answer
        ]
        show_table(("id", "kind", "name", "user", "since", "because"), rows)
        click.echo("Details: labos approvals ID; answer: labos approve ID, labos refuse ID")


def _forecast(client: LabClient, subject: str, approval: dict[str, Any]) -> dict[str, Any] | None:
    """The forecast for the submission; None if there is none: then the reason is shown."""
    if approval["proposal"]["kind"] == "experiment":
        return None
    try:
        return client.approval_forecast(subject)
    except LabosError as error:
        click.echo(f"labos: There is no forecast: {error.message}", err=True)
        return None


def _show_forecast(approval: dict[str, Any], subject: str) -> None:
    found = approval["forecast"]
    click.echo("Forecast for an approval now:")
    campaigns = [each for each in found["campaigns"] if each["campaign"] == subject]
    for campaign in campaigns:
        for what, text in show_campaign(campaign, found["now_at"]):
            click.echo(f"{what + ':':<12} {_strip_control(text)}")
    if not campaigns:
        show_ways(found)
    for kind, item in approval["consumables"].items():
        left = "not counted" if item["left"] is None else f"{item['left']:g} left"
        click.echo(f"uses up:     {item['needed']:g} {_strip_control(kind)} ({left})")
    show_change(found)


def _describe_reasons(proposal: dict[str, Any]) -> str:
    return "; ".join(why["text"] for why in proposal["why"])


def _show(approval: dict[str, Any]) -> None:
    proposal = approval["proposal"]
    demand, terms = proposal["demand"], proposal["terms"]
    lines = {
        "name": proposal["name"],
        "kind": proposal["kind"],
        "user": proposal["user"] if proposal["by"] == proposal["user"] else f"{proposal['by']}",
        "since": show_time(proposal["requested_at"]),
        "because": _describe_reasons(proposal),
        "rows": str(demand["rows"] or ""),
        "steps": str(demand["steps"] or ""),
        "module time": show_span(demand["module_time_s"]) if demand["module_time_s"] else "",
        "modules": ", ".join(f"{name} {show_span(time)}" for name, time in demand["modules"].items()),
        "consumables": ", ".join(f"{amount:g} {kind}" for kind, amount in demand["consumables"].items()),
        "dangerous": ", ".join(demand["dangers"]),
        **(_describe_terms(terms) if terms else {}),
        "digest": proposal["digest"][:DIGEST_SHOWN],
        "approved before": proposal["before"] or "no earlier request with this name",
    }
    show_table(
        ("what", proposal["subject"]), [(what, _strip_control(text)) for what, text in lines.items() if text]
    )
    for difference in approval["differences"]:
        click.echo(f"{_strip_control(difference['part'])} differs:")
        for line in difference["lines"]:
            click.echo(f"  {_strip_control(line)}")


def _describe_terms(terms: dict[str, Any]) -> dict[str, str]:
    budget = terms["budget"]
    return {
        "priority": str(terms["priority"]),
        "deadline": show_time(terms["deadline"]),
        "most runs": str(budget["runs"] or ""),
        "most lab time": show_span(budget["lab_time_s"]) if budget["lab_time_s"] else "",
        "most consumables": ", ".join(f"{amount:g} {kind}" for kind, amount in budget["consumables"].items()),
    }


def _strip_control(text: str) -> str:
    """A text of another user without control characters, which a terminal would obey."""
    return "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text)


@click.command("approve")
@_subject
@click.option(
    "--digest",
    metavar="SHA",
    help="The digest of the version that you checked; refused if it was changed since.",
)
@click.option("--priority", type=int, help="The priority, in place of the requested one.")
@click.option(
    "--deadline",
    metavar="TIME",
    help="For a campaign: the deadline, 2026-05-04T10:30, 12h, or empty for none.",
)
@click.option("--runs", type=click.IntRange(min=0), help="For a campaign: the maximum number of rows.")
@click.option(
    "--lab-time",
    "lab_time_s",
    metavar="TIME",
    callback=as_seconds,
    help="For a campaign: the maximum module time, such as `20 h`.",
)
@consumable_option
@click.option(
    "--alike",
    is_flag=True,
    default=None,
    help="For a run in an experiment: approve further runs of the same workflow with other values too.",
)
@click.option("--yes", is_flag=True, help="Do not ask.")
@why_option("A comment, for the log.")
@asker_options
def approve(subject: str, digest: str | None, yes: bool, why: str, asker: Asker, **changes: Any) -> None:
    """Approve the run, campaign or experiment ID: as it was proposed, or with changes.

    LabOS approves only the version that you have seen. If it was changed meanwhile, the command is refused.

    \b
    labos approve R7 --why "looked at the protocol"
    labos approve C3 --runs 20 --lab-time "10 h"
    """
    wanted = {name: value for name, value in changes.items() if value is not None}
    with asker.lab() as client:
        if digest is None:
            approval = client.approval_of(subject)
            digest = str(approval["proposal"]["digest"])
            if not wants_json():
                _show(approval)
            if not yes and sys.stdin.isatty():
                click.confirm(f"Approve {subject}?", abort=True)
        approved = client.approve(subject, asker.user, digest, comment=why, **wanted)
    facts = {"subject": subject, "approved": True, "digest": approved}
    report_done(f"{subject} is approved ({approved[:DIGEST_SHOWN]}).", facts)


@click.command("refuse")
@_subject
@why_option("A comment, for the log and for the requester.")
@asker_options
def refuse(subject: str, why: str, asker: Asker) -> None:
    """Refuse the run, campaign or experiment ID: it is cancelled. If ID is a change of a campaign, the
    campaign continues without the change."""
    with asker.lab() as client:
        refused = client.refuse(subject, asker.user, comment=why)
    facts = {"subject": subject, "approved": False, "digest": refused}
    report_done(f"{subject} is refused.", facts)


@click.command("policy", short_help="Show or set which submissions need an approval.")
@click.option("--apply", "file", metavar="FILE", help="Set the policy from this file.")
@asker_options
def policy(file: str | None, asker: Asker) -> None:
    """Show or set the policy: which submissions need an operator's approval, who may approve, the highest
    allowed priority, and what users without the role operator may book.

    Without a policy, only submissions of programs need an approval.

    \b
    labos policy                        the policy in force
    labos policy --apply policy.yaml    set the policy from a file
    labos approvals                     requests that wait
    """
    with asker.lab() as client:
        if file is not None:
            client.apply_policy(read_file(file), file, asker.user)
        answer = client.policy()
    end_with_json(answer)
    if not answer["applied"]:
        click.echo("No policy was set. These are the defaults.")
    show_table(("what", "says"), list(_describe_policy(answer["policy"])))


def _describe_policy(policy: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """A policy in words."""
    above = policy["above"]
    budget = [
        f"{above['runs']} runs" if above["runs"] else "",
        f"{show_span(above['lab_time_s'])} module time" if above["lab_time_s"] else "",
        *(f"{amount:g} {kind}" for kind, amount in above["consumables"].items()),
    ]
    trusted = f", but not those of {', '.join(policy['trusted'])}" if policy["trusted"] else ""
    waits = {
        f"submissions of programs{trusted}": policy["programs"],
        f"the first {policy['newcomers']} submissions of each user": policy["newcomers"],
        "dangerous actions": policy["dangerous"],
        f"more than {', '.join(filter(None, budget))}": any(budget),
        "campaigns with a deadline": policy["deadlines"],
    }
    for what, is_so in waits.items():
        if is_so:
            yield "waits for approval", what
    yield "erases words", "an admin" + (", when a second one has agreed" if policy["erasure"] else "")
    yield "approves", "an operator, also for their own requests" if policy["own"] else "another operator"
    if policy["priority"] is not None:
        yield (
            "highest priority",
            f"{policy['priority']}, for users without the role operator and have no quota for it",
        )
    booked = policy["bookings"]
    each = f"{booked['hours']:g} h each, " if booked["hours"] is not None else ""
    amount = f"{each}{booked['total_hours']:g} h to come, {booked['days_ahead']} days ahead"
    yield "bookings", f"{amount}, for users without the role operator"
