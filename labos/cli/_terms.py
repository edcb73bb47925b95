"""Options for the terms of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from labos.cli._options import options_together

_OPTIONS = (
    click.option("--priority", type=int, help="The priority of rows that are submitted from now on."),
    click.option(
        "--deadline", metavar="TIME", help="The deadline: 2026-05-04T10:30, 12h from now, or empty for none."
    ),
    click.option("--runs", type=click.IntRange(min=0), help="The maximum number of runs; 0: no limit."),
    click.option("--lab-time", metavar="TIME", help="The maximum module time, such as `20 h`; 0: no limit."),
    click.option(
        "--consumable", "consumables", multiple=True, metavar="KIND=AMOUNT", help="Maximum, such as tips=96."
    ),
    click.option("--until", metavar="RULE", help="The stop rule; empty for none."),
    click.option(
        "--stop-after", type=click.IntRange(min=0), help="Stop after this number of failed rows; 0: never."
    ),
    click.option(
        "--tag", "tags", multiple=True, metavar="TAG", help="New tags, which replace the present ones."
    ),
)


def terms_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command gets ``terms_wanted``: the given terms, in the form that the client accepts."""

    @wraps(command)
    def wrap(
        *args: Any,
        priority: int | None,
        deadline: str | None,
        runs: int | None,
        lab_time: str | None,
        consumables: tuple[str, ...],
        until: str | None,
        stop_after: int | None,
        tags: tuple[str, ...],
        **options: Any,
    ) -> Any:
        terms = {
            "priority": priority,
            "deadline": deadline,
            "runs": runs,
            "lab_time_s": seconds_of(lab_time) if lab_time is not None else None,
            "consumables": dict(map(amount_of, consumables)) or None,
            "until": until,
            "stop_after": stop_after,
            "tags": list(tags) or None,
        }
        wanted = {name: value for name, value in terms.items() if value is not None}
        return command(*args, terms_wanted=wanted, **options)

    return options_together(*_OPTIONS)(wrap)


def seconds_of(text: str) -> float:
    from labos.spec.durations import parse_duration

    try:
        return parse_duration(text)
    except ValueError as error:
        raise click.BadParameter(f"{error}.", param_hint="--lab-time") from None


def amount_of(text: str) -> tuple[str, float]:
    kind, _, amount = text.partition("=")
    try:
        return kind, float(amount)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not KIND=AMOUNT.", param_hint="--consumable") from None
