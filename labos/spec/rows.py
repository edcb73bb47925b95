"""The rows of a campaign: from a table, a list, a grid, columns, or a Latin hypercube."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Iterator, Mapping
from itertools import islice, product
from typing import TYPE_CHECKING, Any

import msgspec

from labos.errors import SpecError
from labos.spec.findings import FindingList, Remarks
from labos.spec.source import NOWHERE, Place, make_plain, parse

if TYPE_CHECKING:
    from labos.spec.campaign import CampaignFile, LatinHypercube


class TableLine(msgspec.Struct, frozen=True):
    """A row: its whole payload, and its place. ``columns`` are the columns of its own values by key, where
    they have any."""

    payload: dict[str, Any]
    file: str = ""
    at: Place = NOWHERE
    columns: Mapping[str, int] = {}

    def place_of(self, field: str) -> Place:
        """The place of the value of a payload's field, as far as it is known."""
        key = field.removeprefix("payload.")
        for name, column in self.columns.items():
            if field.startswith("payload.") and (key == name or key.startswith(f"{name}.")):
                return Place(self.at.line, column)
        return self.at


KINDS = {
    "table": "table",
    "list_": "list",
    "grid": "grid",
    "zip_": "zip",
    "latin_hypercube": "latin_hypercube",
}
"""The kinds of sources for rows, by the field of the model."""


def expand(file: CampaignFile, remarks: Remarks, files: Mapping[str, bytes]) -> list[TableLine]:
    """The rows of a campaign; their faults go to the remarks."""
    from labos.spec.campaign import MOST_ROWS

    source, report = remarks.source, remarks.report
    given = [name for field, name in KINDS.items() if getattr(file.rows, field)]
    if len(given) != 1:
        what = f"Rows come from {' and '.join(given)}." if given else "The source of the rows is missing."
        remarks.error(what, ("rows",), f"Write one of {', '.join(KINDS.values())}.")
        return []
    if file.rows.table:
        return _read_table(file, remarks, files)
    values: Iterator[dict[str, Any]]
    match given[0]:
        case "list":
            values = iter(file.rows.list_)
        case "grid":
            values = (
                dict(zip(file.rows.grid, row, strict=True)) for row in product(*file.rows.grid.values())
            )
        case "zip":
            if len({len(column) for column in file.rows.zip_.values()}) > 1:
                lengths = ", ".join(f"{key}: {len(column)}" for key, column in file.rows.zip_.items())
                remedy = "Give each the same number of values, or write `grid:`."
                remarks.error(f"The columns differ in length ({lengths}).", ("rows", "zip"), remedy)
                return []
            columns = file.rows.zip_
            values = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
        case _:
            assert file.rows.latin_hypercube is not None
            values = draw_latin_hypercube(file.rows.latin_hypercube)
    found = list(islice(values, MOST_ROWS + 1))
    if len(found) > MOST_ROWS:
        remarks.error(f"There are more than {MOST_ROWS} rows.", ("rows",), "Split the campaign.")
        return []
    lines = []
    for number, own in enumerate(found):
        place = source.place(("rows", *(("list", number) if given[0] == "list" else (given[0],))))
        payload = _merge(file.payload, own, report, source.file, place, number)
        if payload is not None:
            lines.append(TableLine(payload, source.file, place))
    return lines


def draw_latin_hypercube(design: LatinHypercube) -> Iterator[dict[str, Any]]:
    """The rows of a Latin hypercube (McKay, Beckman and Conover 1979): each span is divided into as many
    slices as there are rows, and each slice is used exactly once. The order of the slices and the value
    within a slice come from SHA-256 of seed, key and number. So they are the same on every computer and with
    every version."""
    orders: dict[str, list[int]] = {}
    for key in design.spans:
        marks = [_draw(design.seed, key, "order", i) for i in range(design.samples)]
        orders[key] = sorted(range(design.samples), key=marks.__getitem__)
    for row in range(design.samples):
        found: dict[str, Any] = {}
        for key, span in design.spans.items():
            share = (orders[key][row] + _draw(design.seed, key, "place", row)) / design.samples
            if span.whole:
                least, most = math.ceil(span.from_), math.floor(span.to)
                found[key] = min(least + int(share * (most - least + 1)), most)
            else:
                found[key] = span.from_ + share * (span.to - span.from_)
        yield found


def _draw(seed: int, key: str, what: str, number: int) -> float:
    """A number from 0 (inclusive) to 1 (exclusive)."""
    drawn = hashlib.sha256(f"{seed}/{key}/{what}/{number}".encode()).digest()
    return int.from_bytes(drawn[:7], "big") / 2**56


def _read_table(file: CampaignFile, remarks: Remarks, files: Mapping[str, bytes]) -> list[TableLine]:
    name, report = file.rows.table, remarks.report
    content = files.get(name)
    if content is None:
        remedy = "Put the file beside the campaign file, or correct the name."
        remarks.error(f"The table {name!r} cannot be found.", ("rows", "table"), remedy)
        return []
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        report.error("The table is not text.", Place(1, 1), file=name, remedy="Save it in UTF-8.")
        return []
    if name.lower().endswith((".yaml", ".yml", ".json")):
        return _read_list(file, name, text, report)
    return _read_csv(file, name, text, report)


def _read_list(file: CampaignFile, name: str, text: str, report: FindingList) -> list[TableLine]:
    """Rows of a YAML or JSON file: a list of tables."""
    if name.lower().endswith(".json"):
        try:
            rows = json.loads(text)
        except (ValueError, RecursionError) as error:
            at = Place(getattr(error, "lineno", 1), getattr(error, "colno", 1))
            report.error(f"This is not JSON: {error}.", at, file=name, remedy="Write a list of tables.")
            return []
        places = [NOWHERE] * len(rows) if isinstance(rows, list) else []
    else:
        try:
            rows_source = parse(_put_below_key(text), name)
        except SpecError as error:
            place = Place(max(error.line - 1, 1), error.column)
            report.error(error.message, place, file=name, remedy=error.remedy)
            return []
        found = rows_source.data.get("rows")
        rows = make_plain(found)
        places = [Place(place.line - 1, place.column) for place in getattr(found, "values_at", [])]
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        report.error(
            "The file is not a list of tables.", Place(1, 1), file=name, remedy="Write `- key: value`."
        )
        return []
    lines = []
    for number, (row, place) in enumerate(zip(rows, places, strict=True)):
        payload = _merge(file.payload, row, report, name, place, number)
        if payload is not None:
            lines.append(TableLine(payload, name, place))
    return lines


def _put_below_key(text: str) -> str:
    """A YAML list as the value of a key, one line further down, because ``parse`` reads only tables."""
    if text.lstrip().startswith("["):
        return "rows:\n " + text.replace("\n", "\n ")
    return f"rows:\n{text}"


def _read_csv(file: CampaignFile, name: str, text: str, report: FindingList) -> list[TableLine]:
    """Rows of a CSV file with commas, semicolons or tabs. Columns in messages are numbers of fields."""
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    lines: list[TableLine] = []
    header: list[str] = []
    columns: dict[str, int] = {}
    try:
        for cells in reader:
            line = reader.line_num
            if not any(cell.strip() for cell in cells):
                continue
            if not header:
                header = [cell.strip() for cell in cells]
                columns = {key: column for column, key in enumerate(header, 1)}
                _check_header(header, name, line, report)
                if report.errors:
                    return []
                continue
            if len(cells) != len(header):
                what = f"Row {len(lines) + 1} has {len(cells)} fields; the first line names {len(header)}."
                remedy = "Give each row as many fields as there are columns."
                report.error(what, Place(line, min(len(cells), len(header)) + 1), file=name, remedy=remedy)
                continue
            own = {key: _read_value(cell) for key, cell in zip(header, cells, strict=True) if cell.strip()}
            payload = _merge(file.payload, own, report, name, Place(line, 1), len(lines))
            if payload is not None:
                lines.append(TableLine(payload, name, Place(line, 1), columns))
    except csv.Error as error:
        report.error(
            f"This is not CSV: {error}.", Place(reader.line_num, 1), file=name, remedy="Check quotes."
        )
    return lines


def _check_header(header: list[str], name: str, line: int, report: FindingList) -> None:
    for column, key in enumerate(header, 1):
        at = Place(line, column)
        if not key:
            report.error("A column has no name.", at, file=name, remedy="Name it after a payload key.")
        elif header.index(key) != column - 1:
            report.error(f"The column {key!r} is there twice.", at, file=name, remedy="Remove one of them.")


def _read_value(cell: str) -> Any:
    """The value of a field by the rules of YAML: a number, true or false, a list or table in brackets,
    otherwise a text."""
    text = cell.strip()
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if text[0] in "[{":
        try:
            return json.loads(text)
        except (ValueError, RecursionError):
            return text
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        if math.isfinite(number) and "_" not in text:
            return number
    return text


def _merge(
    base: dict[str, Any],
    own: Mapping[str, Any],
    report: FindingList,
    file: str,
    at: Place,
    number: int,
) -> dict[str, Any] | None:
    """A row's values, added to the common payload of all rows; ``a.b`` is the key ``b`` in the table
    ``a``."""
    payload = msgspec.json.decode(msgspec.json.encode(base))
    for key, value in own.items():
        here = payload
        *tables, last = str(key).split(".")
        for part in tables:
            here = here.setdefault(part, {})
            if not isinstance(here, dict):
                what = f"Row {number + 1}: {key!r} leads into {part!r}, which is a value."
                report.error(what, at, file=file, field=key, remedy="Name either of them.")
                return None
        here[last] = value
    return dict(payload)
