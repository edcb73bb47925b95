"""Every driver's page says where each of its commands comes from: a manual, a standard, a repository."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.docs.markdown import DOCS

COMMANDS = {"command", "request", "function", "object", "hands", "asked"}
"""How tables begin that tell what is said to a device, or what somebody's gateway has to say to it."""
AS_ABOVE = re.compile(r"(the same|both|the first)\b")


class Table(NamedTuple):
    """Of a page: its header, its rows, the number of its first line."""

    line: int
    header: list[str]
    rows: list[list[str]]


def cells(line: str) -> list[str]:
    """``\\|`` is no border, nor is one in code."""
    bare = re.sub(r"`[^`]*`", lambda span: span[0].replace("|", "¦"), line.replace(r"\|", "¦"))
    return [cell.strip() for cell in bare.strip().strip("|").split("|")]


def tables(text: str) -> list[Table]:
    found: list[Table] = []
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if not line.startswith("|"):
            inside = False
        elif not inside:
            found.append(Table(number, cells(line), []))
            inside = True
        elif not re.fullmatch(r"[|\s:-]+", line):
            found[-1].rows.append(cells(line))
    return found


def driver_pages() -> list[Any]:
    return [pytest.param(page, id=page.stem) for page in sorted((DOCS / "drivers").glob("*.md"))]


@pytest.mark.parametrize("page", driver_pages())
def test_each_command_has_a_source(page: Path) -> None:
    told = [table for table in tables(page.read_text("utf-8")) if table.header[0] in COMMANDS]
    assert told, "it has no table of commands"
    wrong = []
    named = False
    for table in told:
        if "source" not in table.header:
            wrong.append(f"{table.line}: the table has no column `source`")
            continue
        at = table.header.index("source")
        for number, row in enumerate(table.rows, table.line + 2):
            source = row[at] if len(row) == len(table.header) else ""
            if not re.search(r"\w{3}", source):
                wrong.append(f"{number}: {row[0]} has no source")
            elif AS_ABOVE.match(source) and not named:
                wrong.append(f"{number}: {row[0]}: {source!r} refers to nothing above")
            named = named or (bool(source) and not AS_ABOVE.match(source))
    assert wrong == []


def test_a_table_is_read_as_it_is_written() -> None:
    (table,) = tables("text\n\n| command | source |\n| --- | --- |\n| `a|b` | one \\| two |\n\nmore\n")
    assert table == Table(3, ["command", "source"], [["`a¦b`", "one ¦ two"]])
