"""Options for the terms of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from labos.cli._options import options_together


def as_seconds(context: click.Context, option: click.Parameter, text: str | None) -> float | None:
    """Option callback: a duration such as ``20 h``."""
    from labos.spec.durations import parse_duration

    try:
        return None if text is None else parse_duration(text)
    except ValueError as error:
        raise click.BadParameter(f"{error}.", param_hint="--lab-time") from None


def as_amounts(
    context: click.Context, option: click.Parameter, texts: tuple[str, ...]
) -> dict[str, float] | None:
    """Option callback: amounts by kind; None if there are none."""
    found: dict[str, float] = {}
    for text in texts:
        kind, _, amount = text.partition("=")
        try:
            found[kind] = float(amount)
        except ValueError:
            raise click.BadParameter(f"{text!r} is not KIND=AMOUNT.", param_hint="--consumable") from None
    return found or None


consumable_option = click.option(
    "--consumable",
    "consumables",
    multiple=True,
    metavar="KIND=AMOUNT",
    callback=as_amounts,
    help="Maximum, such as tips=96.",
)
_OPTIONS = {
    "priority": click.option(
        "--priority", type=int, help="The priority of rows that are submitted from now on."
    ),
    "deadline": click.option(
        "--deadline", metavar="TIME", help="The deadline: 2026-05-04T10:30, 12h from now, or empty for none."
    ),
    "runs": click.option(
        "--runs", type=click.IntRange(min=0), help="The maximum number of runs; 0: no limit."
    ),
    "lab_time_s": click.option(
        "--lab-time",
        "lab_time_s",
        metavar="TIME",
        callback=as_seconds,
        help="The maximum module time, such as `20 h`; 0: no limit.",
    ),
    "consumables": consumable_option,
    "until": click.option("--until", metavar="RULE", help="The stop rule; empty for none."),
    "stop_after": click.option(
        "--stop-after", type=click.IntRange(min=0), help="Stop after this number of failed rows; 0: never."
    ),
    "tags": click.option(
        "--tag", "tags", multiple=True, metavar="TAG", help="New tags, which replace the present ones."
    ),
}
"""The options, by the names of the terms."""


def terms_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command gets ``terms_wanted``: the given terms, in the form that the client accepts."""

    @wraps(command)
    def wrap(*args: Any, **options: Any) -> Any:
        terms = {name: options.pop(name) for name in _OPTIONS}
        terms["tags"] = list(terms["tags"]) or None
        wanted = {name: value for name, value in terms.items() if value is not None}
        return command(*args, terms_wanted=wanted, **options)

    return options_together(*_OPTIONS.values())(wrap)
