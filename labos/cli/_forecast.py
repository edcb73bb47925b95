"""Forecasts in the form that people read."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import click

from labos.cli._out import show_lines, show_table
from labos.services.times import show_span

DELAYS_SHOWN = 10
TOUCHES_SHOWN = 5


def show_expected(times: Mapping[str, int] | None, now_ns: int) -> str:
    """``about 14:20 (14:05–14:50)``, with the day if it is not today; empty if there is no forecast."""
    if times is None:
        return ""
    early, expected, late = (times[name] for name in ("earliest_at", "expected_at", "latest_at"))
    if late <= now_ns:
        return _show_clock(expected, now_ns)  # it has already happened
    return f"about {_show_clock(expected, now_ns)} ({_show_clock(early, now_ns)}–{_show_clock(late, now_ns)})"


def show_range(times: Mapping[str, int] | None, now_ns: int) -> str:
    """``14:05–14:30``; empty if there is no forecast."""
    if times is None:
        return ""
    return f"{_show_clock(times['earliest_at'], now_ns)}–{_show_clock(times['latest_at'], now_ns)}"


def describe_learning(count: int) -> str:
    """The origin of the ranges."""
    from labos.planning.hindsight import ENOUGH

    if count < ENOUGH:
        return (
            f"Only {count} earlier forecasts can be compared with the result yet: the width of the ranges is "
            "partly assumed."
        )
    return (
        "Four of five runs start and end within their range. The ranges come from the errors of the last "
        f"{count} forecasts."
    )


def _show_clock(ns: int, now_ns: int) -> str:
    at, now = (datetime.fromtimestamp(each / 1e9).astimezone() for each in (ns, now_ns))
    short = abs(ns - now_ns) < 600e9
    return f"{at:{'' if at.date() == now.date() else '%m-%d '}%H:%M{':%S' if short else ''}}"


def show_runs(found: Mapping[str, Any]) -> None:
    """The runs of a forecast."""
    now = found["now_at"]
    rows = [
        (
            run["run"],
            _describe_workflow(run),
            run["user"],
            show_expected(run["starts"], now) or "unknown",
            show_expected(run["ends"], now) or "unknown",
            show_range(run["ends_alone"], now),
            show_due(run, now),
            run["waits"],
        )
        for run in found["runs"]
    ]
    alone = "if no other user submits runs"
    columns = ("run", "workflow", "user", "starts", "ends", alone, "due", "waits for")
    show_table(columns, rows, optional="due")
    if rows:
        click.echo(describe_learning(found["learned_from"]))
    if found["left_out"]:
        click.echo(f"The first {len(rows)} runs are forecast; {found['left_out']} more wait.")
    if found["cut"]:
        click.echo("The lab has too much work: late runs have no forecast.")


def show_due(run: Mapping[str, Any], now_ns: int) -> str:
    """The due date of a run in a forecast, and whether the run will keep it; empty without a due date."""
    from labos.planning.hindsight import TimeRange
    from labos.services.due import describe_margin

    if not run["due_at"]:
        return ""
    kept = describe_margin(run["due_at"], TimeRange(**run["ends"]) if run["ends"] else None)
    return f"{_show_clock(run['due_at'], now_ns)}: {kept}"


def _describe_workflow(run: Mapping[str, Any]) -> str:
    """A run's workflow, with the modules that it is expected to choose."""
    chosen = ", ".join(dict.fromkeys(run["modules"].values()))
    return f"{run['workflow']} ({chosen})" if chosen else str(run["workflow"])


def show_change(found: Mapping[str, Any]) -> None:
    """The effects of a planned submission: when a person is needed, which runs it delays, and the
    obstacles."""
    show_touches(found)
    delays = found["delays"]
    for delay in delays[:DELAYS_SHOWN]:
        by = "would wait for a person" if delay["by_s"] is None else f"{show_span(delay['by_s'])} later"
        click.echo(f"delays:      {delay['run']} of {delay['user']}: {by}")
    if len(delays) > DELAYS_SHOWN:
        click.echo(f"delays:      {len(delays) - DELAYS_SHOWN} more runs")
    if not delays:
        click.echo("delays:      nobody")
    show_lines(found["conflicts"], "conflict:    ")


def show_touches(found: Mapping[str, Any]) -> None:
    """When a person is needed."""
    now = found["now_at"]
    for touch in found["touches"][:TOUCHES_SHOWN]:
        click.echo(f"person:      {show_expected(touch['at'], now)}: {touch['why']}")
        if touch["remedy"]:
            click.echo(f"             {touch['remedy']}")
    if not found["touches"]:
        click.echo("person:      nobody is needed")


def show_ways(found: Mapping[str, Any]) -> None:
    """When the run that is not submitted would start and end."""
    now = found["now_at"]
    for run in found["runs"]:
        if run["run"] in found["new"]:
            click.echo(f"starts:      {show_expected(run['starts'], now) or 'unknown'}")
            click.echo(f"ends:        {show_expected(run['ends'], now) or 'unknown'}")
            if run["due_at"]:
                click.echo(f"due:         {show_due(run, now)}")
            if run["ends_alone"]:
                click.echo(f"             {show_range(run['ends_alone'], now)} if no other user submits runs")


def show_campaign(campaign: Mapping[str, Any], now: int) -> list[tuple[str, str]]:
    """When a campaign starts and ends."""
    seen, left = campaign["rows_forecast"], campaign["rows_left"]
    rate = f", by the rate of the next {seen} of {left} rows" if seen < left else ""
    ends = show_expected(campaign["ends"], now)
    return [
        ("starts", show_expected(campaign["starts"], now) or "unknown"),
        ("ends", f"{ends}{rate}" if ends else f"unknown: {campaign['waits'] or 'too far away'}"),
    ]
