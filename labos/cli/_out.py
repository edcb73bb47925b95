"""Output of commands: tables (formatted in a terminal, plain and never cut in a pipe), JSON, and files."""

from __future__ import annotations

import re
import shutil
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from labos.core.wells import sort_by_well
from labos.errors import SystemFailed
from labos.private import create_file
from labos.services.times import with_iso_times

LONGEST_WORD = 32

_JSON = "labos.cli.json"
_TIME = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d[\d:.+\-Z]*")


def show_table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    title: str = "",
    gap: bool = False,
    optional: str = "",
) -> None:
    """Print a table; only its head if there are no rows. ``gap``: after an empty line. ``optional``: a column
    that is left out if it is empty."""
    if optional and not any(row[columns.index(optional)] for row in rows):
        at = columns.index(optional)
        columns, *rows = ((*line[:at], *line[at + 1 :]) for line in (columns, *rows))
    if gap:
        click.echo()
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.markup import escape
        from rich.table import Table

        table = Table(title=escape(title) or None, title_justify="left", header_style="bold", box=None)
        for at, column in enumerate(columns):
            table.add_column(column, overflow="fold", no_wrap=all(_is_one_word(row[at]) for row in rows))
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


def count_each(things: Iterable[str]) -> str:
    """``plate96, 2 × lid96``"""
    return ", ".join(thing if n == 1 else f"{n} × {thing}" for thing, n in Counter(things).items())


def show_lines(lines: Iterable[object], begin: str = "", *, err: bool = False) -> None:
    """Each on a line of its own, which begins with ``begin``; with ``err`` on standard error."""
    for line in lines:
        click.echo(f"{begin}{line}", err=err)


def show_parts(parts: Sequence[str]) -> None:
    """Parts of a sentence on one line, or each on a line of its own if the terminal is too narrow."""
    line = "; ".join(parts)
    fits = not sys.stdout.isatty() or len(line) <= terminal_width()
    click.echo(line if fits else "\n".join(parts))


def terminal_width(most: int = 0) -> int:
    """The width of the terminal, but at most ``most``; ``most`` if there is no terminal."""
    wide = shutil.get_terminal_size().columns if sys.stdout.isatty() or not most else most
    return min(wide, most) if most else wide


def _is_one_word(cell: str) -> bool:
    """Whether a cell must not be broken into two lines: an id, a number, a time."""
    return len(cell) <= LONGEST_WORD and (" " not in cell or _TIME.fullmatch(cell) is not None)


def show_json(value: Any) -> None:
    """One JSON document, indented; times in it as ISO 8601 in UTC."""
    click.echo(msgspec.json.format(_encode(value), indent=2))


def note_json(context: click.Context, option: click.Parameter, value: bool) -> None:
    """Callback of ``--json``: the functions below know of it, so that no command has to pass it on."""
    context.meta[_JSON] = value


def wants_json() -> bool:
    """Whether the present command answers in JSON."""
    return bool(click.get_current_context().meta.get(_JSON))


def end_with_json(value: Any, code: int = 0) -> None:
    """With ``--json``, show the value and end the command with this exit code."""
    if wants_json():
        show_json(value)
        click.get_current_context().exit(code)


def report_done(sentence: str, facts: Any) -> None:
    """Report what a command has done: a sentence, or its facts as JSON."""
    if wants_json():
        show_json(facts)
    else:
        click.echo(sentence)


def show_line(value: Any) -> None:
    """The same on one line."""
    click.echo(_encode(value))


def _encode(value: Any) -> bytes:
    plain = with_iso_times(msgspec.to_builtins(value))
    return msgspec.json.encode(sort_by_well(plain, others_sorted=True))


def write_new(file: Path, data: bytes) -> None:
    """Write a file that only its owner can read. Raises SystemFailed."""
    try:
        with create_file(file) as written:
            written.write(data)
    except OSError as error:
        raise SystemFailed(f"{file} cannot be written: {error}.", remedy="Name another file.") from None
