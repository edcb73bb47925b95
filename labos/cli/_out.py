"""Tables: rich in a terminal, plain and never cut when piped."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click
import msgspec

from labos.core.wells import by_well
from labos.services.times import with_iso_times


def show_table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "") -> None:
    """Print a table; nothing but a dash for no rows."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.markup import escape
        from rich.table import Table

        table = Table(title=escape(title) or None, title_justify="left", header_style="bold", box=None)
        for column in columns:
            table.add_column(column, overflow="fold")
        for row in rows:
            table.add_row(*(escape(cell) for cell in row))
        Console().print(table)
        return
    if title:
        click.echo(title)
    lines = [list(columns), *(list(row) for row in rows)]
    widths = [max(len(line[at]) for line in lines) for at in range(len(columns))]
    for line in lines:
        click.echo("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def show_json(value: Any) -> None:
    """One JSON document, indented; moments in it as ISO 8601 in UTC."""
    click.echo(msgspec.json.format(_encoded(value), indent=2))


def show_line(value: Any) -> None:
    """The same on one line."""
    click.echo(_encoded(value))


def _encoded(value: Any) -> bytes:
    plain = with_iso_times(msgspec.to_builtins(value))
    return msgspec.json.encode(by_well(plain, others_sorted=True))
