"""Tables as lines of text: as wide as they are, or folded to the width of a terminal.

In a terminal no cell is broken in the middle of a word, and what is no prose (a time, an id, a name)
keeps together. What does not fit loses, in this order: empty columns and the milliseconds of times; then
the last column is wrapped at its words; if the others alone are too wide, a row takes several lines, each
further one indented.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

GAP = 2
INDENT = 4
NARROWEST = 20
"""A last column that would have to be narrower than this gets a line of its own."""

_MS = re.compile(r"(\d\d:\d\d:\d\d)\.\d{3}")

Row = Sequence[str]


def plain_lines(columns: Row, rows: Sequence[Row]) -> list[str]:
    """Header and rows, each on one line, however long."""
    table = [columns, *rows]
    return list(_side_by_side(table, [_widest(table, at) for at in range(len(columns))]))


def folded_lines(columns: Row, rows: Sequence[Row], width: int) -> list[tuple[str, bool]]:
    """Header and rows in lines of ``width`` cells at the most, each with whether it is of the header."""
    table = [list(columns), *(list(row) for row in rows)]
    if _width(table) > width:
        kept = [at for at in range(len(columns)) if any(row[at] for row in rows)] or [0]
        table = [[_MS.sub(r"\1", row[at]) for at in kept] for row in table]
    last = len(table[0]) - 1
    widths = [_widest(table, at) for at in range(last + 1)]
    before = sum(widths[:-1]) + GAP * last
    if before + widths[-1] > width and before + min(widths[-1], NARROWEST) <= width:
        widths[-1] = width - before
    lines = _on_lines(widths, width)
    found = []
    for number, row in enumerate(table):
        for columns_here in lines:
            indent = 0 if columns_here[0] == 0 else INDENT
            cells = [row[at] for at in columns_here]
            if indent and not any(cells):
                continue
            room = [min(widths[at], width - indent) for at in columns_here]
            for line in _row_lines(cells, room):
                found.append((f"{' ' * indent}{line}".rstrip(), number == 0))
    return found


def _on_lines(widths: Sequence[int], width: int) -> list[list[int]]:
    """Which columns stand on which line of a row."""
    lines: list[list[int]] = [[]]
    left = width
    for at, wide in enumerate(widths):
        if lines[-1] and wide > left:
            lines.append([])
            left = width - INDENT
        lines[-1].append(at)
        left -= wide + GAP
    return lines


def _row_lines(cells: Sequence[str], widths: Sequence[int]) -> Iterator[str]:
    """Cells side by side, each wrapped to its width."""
    wrapped = [_wrapped(cell, width) for cell, width in zip(cells, widths, strict=True)]
    for at in range(max(map(len, wrapped))):
        parts = [lines[at] if at < len(lines) else "" for lines in wrapped]
        yield from _side_by_side([parts], widths)


def _wrapped(cell: str, width: int) -> list[str]:
    """A cell in lines, broken between words; a word that is too long itself is cut with …"""
    if _len(cell) <= width:
        return [cell]
    lines, line = [], ""
    for word in cell.split():
        if _len(word) > width:
            while word and _len(word) > width - 1:
                word = word[:-1]
            word += "…"
        if line and _len(line) + 1 + _len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}" if line else word
    return [*lines, line]


def _side_by_side(table: Sequence[Row], widths: Sequence[int]) -> Iterator[str]:
    for row in table:
        padded = (cell + " " * (width - _len(cell)) for cell, width in zip(row, widths, strict=True))
        yield (" " * GAP).join(padded).rstrip()


def _width(table: Sequence[Row]) -> int:
    return sum(_widest(table, at) + GAP for at in range(len(table[0]))) - GAP


def _widest(table: Sequence[Row], at: int) -> int:
    return max(_len(row[at]) for row in table)


def _len(text: str) -> int:
    """So many cells of a terminal a text takes."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)
