"""Tables and JSON, as commands print them."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from typing import Any

import click
import msgspec

from labos.cli._table import folded_lines, plain_lines
from labos.core.wells import by_well
from labos.services.times import with_iso_times


def show_table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "") -> None:
    """Print a table: folded to the width of a terminal, as wide as it is when piped."""
    if title:
        click.echo(title)
    if not sys.stdout.isatty():
        for line in plain_lines(columns, rows):
            click.echo(line)
        return
    for line, is_header in folded_lines(columns, rows, terminal_width()):
        click.echo(click.style(line, bold=True) if is_header and "NO_COLOR" not in os.environ else line)


def show_parts(parts: Sequence[str]) -> None:
    """Parts of a sentence on one line, or each on its own where a terminal is too narrow for them."""
    told = "; ".join(parts)
    fits = not sys.stdout.isatty() or len(told) <= terminal_width()
    click.echo(told if fits else "\n".join(parts))


def terminal_width(most: int = 0) -> int:
    """How wide the terminal is, or ``most`` if that is less; ``most`` where there is none."""
    wide = shutil.get_terminal_size().columns if sys.stdout.isatty() or not most else most
    return min(wide, most) if most else wide


def show_json(value: Any) -> None:
    """One JSON document, indented; moments in it as ISO 8601 in UTC."""
    click.echo(msgspec.json.format(_encoded(value), indent=2))


def tell(sentence: str, facts: Any, *, as_json: bool) -> None:
    """What a command has done: a sentence, or the facts of it as JSON."""
    if as_json:
        show_json(facts)
    else:
        click.echo(sentence)


def show_line(value: Any) -> None:
    """The same on one line."""
    click.echo(_encoded(value))


def _encoded(value: Any) -> bytes:
    plain = with_iso_times(msgspec.to_builtins(value))
    return msgspec.json.encode(by_well(plain, others_sorted=True))
