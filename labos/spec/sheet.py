"""Sample sheets: CSV files with the sample in each well, read with the places of their values.

Columns, in any order, by name: ``plate`` (an id or a barcode; may be left out for a single plate), ``well``,
``sample``, ``volume`` and ``unit`` (µL if there is none). Separated by commas, semicolons (then with decimal
commas, as spreadsheets of many countries write them) or tabs; UTF-8.
"""

from __future__ import annotations

import re

import msgspec

from labos.core.labware import Sample
from labos.core.model import WellGrid
from labos.core.wells import normalise_well, parse_well, row_name
from labos.spec.findings import FindingList, suggest_name
from labos.spec.models import Wells
from labos.spec.source import Place

COLUMNS = ("plate", "well", "sample", "volume", "unit")
MICROLITRES = {"nl": 1e-3, "ul": 1.0, "µl": 1.0, "μl": 1.0, "ml": 1e3, "l": 1e6}
LONGEST_NAME = 200
MOST_ROWS = 50_000
MOST_COLUMNS = 20
MOST_FAULTS = 100
"""The most faults that are reported; after them, the rest of the sheet is not read."""


class SheetLine(msgspec.Struct, frozen=True):
    """One row of a sheet; ``at`` is where the row's well is written."""

    plate: str
    sample: Sample
    at: Place
    plate_at: Place


class Cell(msgspec.Struct, frozen=True):
    text: str
    at: Place


def read_sheet(text: str, report: FindingList) -> list[SheetLine]:
    """The rows of a sheet; faults go to the report."""
    lines = [(number, line) for number, line in enumerate(_split_lines(text), 1) if line.strip()]
    if not lines:
        report.error("The sheet is empty.", Place(1, 1), remedy=f"Begin it with: {','.join(COLUMNS)}")
        return []
    if len(lines) > MOST_ROWS:
        report.error(
            f"The sheet has {len(lines)} rows; {MOST_ROWS} are allowed.",
            Place(lines[MOST_ROWS][0], 1),
            remedy="Divide it.",
        )
        return []
    number, first = lines[0]
    separator = max(",;\t", key=first.count)
    header = [Cell(c.text.lower(), c.at) for c in _split_cells(first, number, separator, report)]
    if not _check_header(header, report):
        return []
    names = [cell.text for cell in header]
    found: list[SheetLine] = []
    seen: dict[tuple[str, str], int] = {}
    for number, line in lines[1:]:
        if report.errors >= MOST_FAULTS:
            break
        cells = _split_cells(line, number, separator, report)
        if len(cells) != len(names):
            report.error(
                f"This row has {len(cells)} columns, the first one {len(names)}.",
                Place(number, 1),
                remedy="Put text that contains the separator in double quotes.",
            )
            continue
        row = _read_row(dict(zip(names, cells, strict=True)), separator, report)
        if row is None:
            continue
        before = seen.setdefault((row.plate, row.sample.well), number)
        if before != number:
            where = f"{row.sample.well} of {row.plate}" if row.plate else row.sample.well
            report.error(
                f"The well {where} is listed twice; the first is in line {before}.",
                row.at,
                field="well",
                remedy="Remove or correct one of them.",
            )
        found.append(row)
    return found


def check_wells(
    rows: list[SheetLine], labware: str, wells: WellGrid | Wells | None, report: FindingList
) -> None:
    """Check that the wells exist on a labware type, and can hold their volumes."""
    for row in rows:
        if report.errors >= MOST_FAULTS:
            return
        if wells is None:
            report.error(f"A {labware} has no wells.", row.at, field="well", remedy="Name another plate.")
            return
        across, down = parse_well(row.sample.well)[::-1]
        if down >= wells.rows or across >= wells.columns:
            last = f"{row_name(wells.rows - 1)}{wells.columns}"
            message = f"There is no well {row.sample.well} on a {labware}."
            report.error(message, row.at, field="well", remedy=f"Its wells are A1 to {last}.")
        elif row.sample.volume_ul is not None and row.sample.volume_ul > wells.volume_ul:
            report.error(
                f"{row.sample.well} cannot hold {row.sample.volume_ul:g} µL.",
                row.at,
                field="volume",
                remedy=f"A well of a {labware} holds {wells.volume_ul:g} µL.",
            )


def _split_lines(text: str) -> list[str]:
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _split_cells(line: str, number: int, separator: str, report: FindingList) -> list[Cell]:
    """The cells of a line with their places. A quoted cell may hold the separator."""
    cells: list[Cell] = []
    at = 0
    while True:
        begin = at
        while line[begin : begin + 1] == " ":
            begin += 1
        if line[begin : begin + 1] == '"':
            text, at = _read_quoted(line, begin, number, report)
            rest = line.find(separator, at)
            end = len(line) if rest < 0 else rest
            text += line[at:end].strip()
        else:
            rest = line.find(separator, begin)
            end = len(line) if rest < 0 else rest
            text = line[begin:end].strip()
        cells.append(Cell(text, Place(number, begin + 1)))
        if end >= len(line):
            return cells
        if len(cells) > MOST_COLUMNS:
            report.error("The row has too many columns.", Place(number, 1), remedy=f"Write {MOST_COLUMNS}.")
            return cells
        at = end + 1


def _read_quoted(line: str, begin: int, number: int, report: FindingList) -> tuple[str, int]:
    """The text between quotes, and the index of its end; two quotes inside it stand for one."""
    parts: list[str] = []
    at = begin + 1
    while True:
        end = line.find('"', at)
        if end < 0:
            report.error("A quote is not closed.", Place(number, begin + 1), remedy='Close it with ".')
            return "".join((*parts, line[at:])), len(line)
        parts.append(line[at:end])
        if line[end + 1 : end + 2] != '"':
            return "".join(parts), end + 1
        parts.append('"')
        at = end + 2


def _check_header(header: list[Cell], report: FindingList) -> bool:
    errors = report.errors
    seen: set[str] = set()
    for cell in header:
        if cell.text not in COLUMNS:
            report.error(
                f"The column {cell.text!r} is not known.",
                cell.at,
                remedy=suggest_name(cell.text, COLUMNS, "column"),
            )
        elif cell.text in seen:
            report.error(f"The column {cell.text!r} is there twice.", cell.at, remedy="Remove one.")
        seen.add(cell.text)
    for name in ("well", "sample"):
        if name not in seen:
            report.error(f"The column {name!r} is missing.", header[0].at, remedy="Add it to the first line.")
    if "unit" in seen and "volume" not in seen:
        report.error("There is a unit, but no volume.", header[0].at, remedy="Add the column 'volume'.")
    return report.errors == errors


def _read_row(cells: dict[str, Cell], separator: str, report: FindingList) -> SheetLine | None:
    well, sample = cells["well"], cells["sample"]
    errors = report.errors
    name = ""
    try:
        name = normalise_well(well.text)
    except ValueError as error:
        report.error(f"{error}.".capitalize(), well.at, field="well", remedy="Write A1, B12 …")
    if not sample.text:
        report.error(
            "The sample is missing.", sample.at, field="sample", remedy="Leave the row out if it is empty."
        )
    elif len(sample.text) > LONGEST_NAME:
        remedy = f"Use at most {LONGEST_NAME} characters."
        report.error("The name of the sample is too long.", sample.at, field="sample", remedy=remedy)
    volume = _read_volume(cells.get("volume"), cells.get("unit"), separator, report)
    plate = cells.get("plate", Cell("", well.at))
    if report.errors > errors:
        return None
    return SheetLine(plate.text, Sample(name, sample.text, volume), well.at, plate.at)


def _read_volume(volume: Cell | None, unit: Cell | None, separator: str, report: FindingList) -> float | None:
    if volume is None or not volume.text:
        return None
    factor = MICROLITRES.get(unit.text.lower() or "ul", 0.0) if unit is not None else 1.0
    if unit is not None and not factor:
        remedy = "Write nL, µL (or uL), mL or L."
        report.error(f"The unit {unit.text!r} is not known.", unit.at, field="unit", remedy=remedy)
    text = volume.text.replace(",", ".") if separator != "," else volume.text
    if not re.fullmatch(r"\+?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,2})?", text):
        remedy = "Write a number; its unit goes into a column 'unit'."
        report.error(f"{volume.text!r} is not a volume.", volume.at, field="volume", remedy=remedy)
        return None
    return round(float(text) * factor, 6)
