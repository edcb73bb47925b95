"""Tables in files, as instruments write them."""

from __future__ import annotations

import csv
import io
from typing import Any


def rows_of(text: str) -> list[dict[str, Any]]:
    """The rows of a CSV file by the names in its first line; numbers are converted. Raises ValueError for a
    text without such a line, and for a row that has more values than it names."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    comma = max(",;\t", key=first.count)
    lines = csv.reader(io.StringIO(text.lstrip("\r\n")), delimiter=comma)
    names = [name.strip() for name in next(lines, [])]
    if not any(names) or len(set(names)) < len(names):
        raise ValueError("its first line does not name each column once")
    rows = []
    for number, values in enumerate(lines, 2):
        if not any(value.strip() for value in values):
            continue
        if len(values) > len(names):
            raise ValueError(f"line {number} has {len(values)} values for {len(names)} columns")
        rows.append(dict(zip(names, [_value(value.strip(), comma) for value in values], strict=False)))
    return rows


def _value(text: str, comma: str) -> Any:
    """A comma that does not separate columns may be a decimal separator."""
    for convert in (int, float) if "_" not in text else ():
        try:
            return convert(text.replace(",", ".") if comma != "," else text)
        except ValueError:
            continue
    return text
