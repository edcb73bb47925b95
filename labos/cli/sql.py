"""``labos sql``: queries in SQL on the audit tables."""

from __future__ import annotations

import csv
import itertools
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import msgspec

from labos.audit.query import TIME_LIMIT_S, QueryResult, ReadConnection, open_asker
from labos.audit.tables import VIEWS, list_view_columns
from labos.cli._audit import open_views
from labos.cli._options import file_option
from labos.cli._out import show_table
from labos.cli._query import Where, folder_options
from labos.errors import BadInput, LabosError

MOST_SHOWN = 1000
"""At most so many rows are shown as a table; for more, another form of output is suggested."""

PROMPT, GOES_ON = "labos> ", "   ... "


@click.command("sql")
@click.argument("query", required=False)
@click.option("--csv", "as_csv", is_flag=True, help="CSV, with column names in the first line.")
@click.option("--json", "as_json", is_flag=True, help="JSON, for programs: one object for each line.")
@file_option("--parquet", help="Write a Parquet file (extra `parquet`).")
@click.option("--views", is_flag=True, help="List the views and their columns.")
@click.option(
    "--as-is",
    is_flag=True,
    help="Query the tables without an update first, for roles that may only read them.",
)
@click.option(
    "--timeout",
    "limit_s",
    type=click.FloatRange(min=0.1),
    default=TIME_LIMIT_S,
    show_default=True,
    metavar="SECONDS",
    help="How long a query may take.",
)
@folder_options
def command(
    where: Where,
    query: str | None,
    as_csv: bool,
    as_json: bool,
    parquet: Path | None,
    views: bool,
    as_is: bool,
    limit_s: float,
) -> None:
    """Query the lab in SQL (read-only). Without QUERY, the command shows a prompt.

    The answer includes all events that are in the log at that moment. Views and columns are the same on
    SQLite and PostgreSQL. --views and docs/reference/sql.md list them.

    \b
    labos sql "SELECT run, workflow, status FROM runs ORDER BY submitted_at DESC LIMIT 10"
    labos sql "SELECT * FROM results WHERE run = 'R7'" --csv > R7.csv
    labos sql --views
    """
    if sum((as_csv, as_json, parquet is not None, views)) > 1:
        raise click.UsageError("Choose one of --csv, --json, --parquet and --views.")
    if views:
        _show_views()
        return
    with open_asker(where.url, limit_s) if as_is else open_views(where, limit_s) as asker:
        if query is None and sys.stdin.isatty():
            _converse(asker)
            return
        answer = asker.ask(query if query is not None else sys.stdin.read())
        if parquet is not None:
            click.echo(f"{parquet} has {write_parquet(answer, parquet)} rows.")
        elif as_csv:
            out = csv.writer(sys.stdout, lineterminator="\n")
            out.writerow(answer.columns)
            out.writerows(answer.rows)
        elif as_json:
            for row in answer.rows:
                click.echo(msgspec.json.encode(dict(zip(answer.columns, row, strict=True))))
        else:
            _show(answer)


def write_parquet(answer: QueryResult, path: Path) -> int:
    """An answer as a Parquet file; returns how many rows it has. Raises BadInput without pyarrow."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise BadInput(
            "Parquet files need pyarrow, which is not installed.",
            remedy='Run: pip install "labos-sdl[parquet]"',
        ) from None
    rows = list(answer.rows)
    columns = [pyarrow.array([row[at] for row in rows]) for at in range(len(answer.columns))]
    table = pyarrow.Table.from_arrays(columns, names=list(answer.columns))
    pyarrow.parquet.write_table(table, path)  # type: ignore[no-untyped-call]
    return len(rows)


def _show(answer: QueryResult) -> None:
    rows = [[_write_cell(value) for value in row] for row in itertools.islice(answer.rows, MOST_SHOWN)]
    show_table(answer.columns, rows)
    if next(answer.rows, None) is not None:
        click.echo(f"There are more than {MOST_SHOWN} rows. To see all: --csv or --json.", err=True)


def _write_cell(value: Any) -> str:
    return "" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)


def _converse(asker: ReadConnection) -> None:
    """Queries that a user types, each with a semicolon at its end, until Ctrl-D."""
    with suppress(ImportError):  # Windows has line editing of its own
        import readline

        assert readline, "lines can be edited and recalled"
    click.echo("Enter SQL, and end it with a semicolon; \\v lists the views, Ctrl-D ends.")
    lines: list[str] = []
    while True:
        try:
            line = input(GOES_ON if lines else PROMPT)
        except EOFError:
            click.echo()
            return
        except KeyboardInterrupt:
            click.echo()
            lines.clear()
            continue
        if not lines and line.strip() in ("\\v", "\\d", ".tables"):
            _show_views()
            continue
        lines.append(line)
        if line.rstrip().endswith(";"):
            query = "\n".join(lines).rstrip().rstrip(";")
            lines.clear()
            try:
                _show(asker.ask(query))
            except LabosError as error:
                click.echo(str(error), err=True)


def _show_views() -> None:
    rows: list[Sequence[str]] = []
    for table in VIEWS:
        rows.append((table.view, "", "", table.about))
        rows += [("", column.name, column.kind, column.about) for column in list_view_columns(table)]
    show_table(("view", "column", "kind", "meaning"), rows)
