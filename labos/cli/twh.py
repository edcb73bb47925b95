"""``labos twh``: time without human intervention, and the causes of the other time."""

from __future__ import annotations

import click
import msgspec

from labos.cli._complete import name_option
from labos.cli._liveness import find_lab_now, open_current_log
from labos.cli._out import show_json, show_table, wants_json
from labos.cli._query import Where, log_and_json
from labos.core.ids import local
from labos.errors import NotFound
from labos.services.losses import Loss, LossAccount, Losses, sum_losses, waits_for_a_person
from labos.services.next_touch import Touch
from labos.services.times import show_span, show_time
from labos.services.twh import Stretch, Twh, TwhReport, measure

RUNS_SHOWN = 20
TOUCHES_SHOWN = 8


@click.command("twh", short_help="Show the time without human intervention.")
@name_option("run", "R", "Show only this run.")
@name_option("experiment", "E", "Show only this experiment.")
@name_option("workcell", "W", "Show only this workcell.")
@click.option(
    "--losses", is_flag=True, help="Show the causes of lost time, and when a person is needed next."
)
@log_and_json
def command(where: Where, run: str, experiment: str, workcell: str, losses: bool) -> None:
    """Show the time without human intervention (TWH) of the lab, its workcells, experiments and runs.

    \b
    labos twh                     the lab and everything in it
    labos twh --experiment E1     one experiment
    labos twh --losses            every lost minute with its cause

    The time of a run counts from its first step to its end, except while it is paused or waits for a person.
    A person's answer, or access to the workcell, ends the current interval.
    docs/time-without-human-intervention.md has the exact definition.
    """
    with open_current_log(where, last_known=False) as store:
        now = find_lab_now(where.url, store.head())
        found = sum_losses(store.read(), now) if losses else None
        report = found.twh if found is not None else measure(store.read(), now)
    shown = choose_scopes(report, run, experiment, workcell)
    if found is not None:
        (_why_as_json if wants_json() else _show_why)(found, shown)
    elif wants_json():
        show_json({"pace": report.pace, "scopes": [make_plain_twh(twh) for twh in shown]})
    else:
        _show(report, shown)


def _show(report: TwhReport, shown: list[Twh]) -> None:
    columns = ["scope", "current", "commands", "longest", "commands", "from", "to"]
    columns += ["interventions", "planned"]
    if report.pace != 1:
        columns.insert(5, "longest in lab time")
    show_table(columns, [_row(twh, report.pace) for twh in shown])


def choose_scopes(report: TwhReport, run: str, experiment: str, workcell: str) -> list[Twh]:
    """The requested scopes; by default the lab, all workcells and experiments, and the last runs. Raises
    NotFound."""
    found: list[Twh] = []
    wanted = (("run", run, report.runs), ("experiment", experiment, report.experiments))
    for kind, name, known in (*wanted, ("workcell", workcell, report.workcells)):
        if name:
            if name not in known:
                raise NotFound(f"No {kind} {name!r} has started a step.", remedy="List all: labos twh")
            found.append(known[name])
    runs = list(report.runs.values())[-RUNS_SHOWN:]
    return found or [report.lab, *report.workcells.values(), *report.experiments.values(), *runs]


def _row(twh: Twh, pace: float) -> list[str]:
    name = f"{twh.kind} {twh.name}".strip()
    current = _show_worked(twh.current) + (" and counting" if twh.working else "")
    row = [name, current, str(twh.current.commands), _show_worked(twh.longest), str(twh.longest.commands)]
    if pace != 1:
        row.append(show_span(twh.longest.worked_ns / 1e9 * pace))
    row += [show_time(twh.longest.since), show_time(twh.longest.until)]
    return [*row, str(twh.interventions), str(twh.planned)]


def _show_worked(stretch: Stretch) -> str:
    return show_span(stretch.worked_ns / 1e9)


def _show_why(found: Losses, shown: list[Twh]) -> None:
    """The account of each scope on a line, then the causes of the first scope, then the next tasks."""
    accounts = [account_of(found, twh) for twh in shown]
    columns = ("scope", "had work", "at work", "lost", "of it for a person", "most of it to")
    show_table(columns, [_list_cells(each) for each in accounts])
    first = accounts[0]
    show_table(
        ("cause", "module", "class", "lost", "share", "waits for"),
        [_list_loss_cells(first, loss) for loss in first.losses],
        title=f"Losses of {_name_scope(first)}",
        gap=True,
    )
    show_table(
        ("when", "what", "run", "do"),
        [_touch(touch, found.end) for touch in found.next_touches[:TOUCHES_SHOWN]],
        title="A person is needed next",
        gap=True,
    )


def _why_as_json(found: Losses, shown: list[Twh]) -> None:
    scopes = [{**make_plain_twh(twh), "why": _make_plain(account_of(found, twh))} for twh in shown]
    touches = [msgspec.to_builtins(touch) for touch in found.next_touches]
    show_json({"pace": found.twh.pace, "scopes": scopes, "next_touches": touches})


def account_of(found: Losses, twh: Twh) -> LossAccount:
    """The account of a scope; an empty one if it never had work."""
    known = {"run": found.runs, "experiment": found.experiments, "workcell": found.workcells}
    if twh.kind == "lab":
        return found.lab
    return known[twh.kind].get(twh.name) or LossAccount(twh.kind, twh.name, 0, 0, 0, ())


def make_plain_twh(twh: Twh) -> dict[str, object]:
    """For programs: nanoseconds and seconds."""
    plain: dict[str, object] = msgspec.to_builtins(twh)
    for name, stretch in (("current", twh.current), ("longest", twh.longest)):
        plain[f"{name}_s"] = stretch.worked_ns / 1e9
    return plain


def _make_plain(each: LossAccount) -> dict[str, object]:
    return {
        "span_s": each.span_ns / 1e9,
        "at_work_s": each.at_work_ns / 1e9,
        "lost_s": each.lost_ns / 1e9,
        "for_a_person_s": each.for_a_person_ns / 1e9,
        "losses": [
            {
                **msgspec.to_builtins(loss.cause),
                "lost_s": loss.lost_ns / 1e9,
                "on_clock_s": loss.on_clock_ns / 1e9,
            }
            for loss in each.losses
        ],
    }


def _name_scope(each: LossAccount) -> str:
    return "the lab" if each.kind == "lab" else f"{each.kind} {each.name}"


def _list_cells(each: LossAccount) -> tuple[str, ...]:
    most = _name_cause(each.losses[0]) if each.losses else ""
    times = (each.span_ns, each.at_work_ns, each.lost_ns, each.for_a_person_ns)
    return (f"{each.kind} {each.name}".strip(), *(show_span(ns / 1e9) for ns in times), most)


def _name_cause(loss: Loss) -> str:
    return f"{local(loss.cause.module)} {loss.cause.what}".strip()


def _list_loss_cells(each: LossAccount, loss: Loss) -> tuple[str, ...]:
    cause = loss.cause
    share = f"{100 * loss.lost_ns / each.span_ns:.1f} %"
    named = cause.what if cause.kind in ("error", "other") else f"{cause.kind}: {cause.what}"
    waits = "a person" if waits_for_a_person(cause) else ""
    return (named, local(cause.module), cause.error_class, show_span(loss.lost_ns / 1e9), share, waits)


def _touch(touch: Touch, now: int) -> tuple[str, ...]:
    when = "now" if touch.at <= now else show_time(touch.at)
    return (when, touch.what, touch.run, touch.remedy)
