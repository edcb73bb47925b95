"""Opentrons' labware definitions, schema 2: one labware type per file.

``dimensions``, ``ordering`` (columns of well names), ``wells[x, y, totalLiquidVolume]`` in mm and µL from the
front left corner, ``parameters.loadName``, ``metadata.displayName``.
"""

from __future__ import annotations

import re

from labos.spec.dialects._reader import Reader, is_number
from labos.spec.findings import FindingList
from labos.spec.source import Source, SourceList, SourceMapping

TOLERANCE_MM = 0.05


def is_labware(source: Source) -> bool:
    """Whether the file is a labware definition."""
    return "labos" not in source.data and {"dimensions", "ordering", "wells"} <= source.data.keys()


def rewrite_labware(source: Source, report: FindingList) -> Source:
    """Rewrite a labware definition. Raises SpecError for an unknown form."""
    reader = Reader(source, report)
    data, at = source.data, source.data.at
    parameters = reader.expect_table(data.get("parameters"), ("parameters",), "`parameters`")
    metadata = reader.expect_table(data.get("metadata"), ("metadata",), "`metadata`")
    written = str(parameters.get("loadName") or "labware")
    name = re.sub(r"[^A-Za-z0-9_ ()\-]", "_", written)
    kind = SourceMapping(at)
    if isinstance(metadata.get("displayName"), str):
        kind.take(metadata, "displayName", "description")
    kind.put("footprint", _read_footprint(reader), *data.find_places("dimensions"))
    wells = _read_wells(reader, kind["footprint"])
    if wells is not None:
        kind.put("wells", wells, *data.find_places("wells"))
    version = data.get("version")
    kind.put("source", f"Opentrons, {data.get('namespace', 'unknown')}/{written}, version {version}")
    return reader.finish(SourceMapping(at, {"labware": SourceMapping(at, {name: kind})}))


def _read_number(reader: Reader, table: SourceMapping, key: str, path: tuple[str, ...]) -> float:
    value = table.get(key)
    if not is_number(value):
        raise reader.source.error(f"`{key}` is not a number.", (*path, key), remedy="Write it in mm or µL.")
    return float(value)  # type: ignore[arg-type]


def _read_footprint(reader: Reader) -> SourceMapping:
    path = ("dimensions",)
    written = reader.expect_table(reader.source.data["dimensions"], path, "`dimensions`")
    sides = {"length_mm": "xDimension", "width_mm": "yDimension", "height_mm": "zDimension"}
    sizes = {name: _read_number(reader, written, key, path) for name, key in sides.items()}
    return SourceMapping(written.at, sizes)


def _read_wells(reader: Reader, footprint: SourceMapping) -> SourceMapping | None:
    """The grid of wells; None, with a warning, if the wells are not in a grid with one pitch."""
    columns = reader.expect_row("ordering", "the columns")
    written = reader.expect_table(reader.source.data["wells"], ("wells",), "`wells`")
    names = [[str(name) for name in column] if isinstance(column, SourceList) else [] for column in columns]
    spots = {
        name: (
            _read_number(reader, well, "x", ("wells", name)),
            _read_number(reader, well, "y", ("wells", name)),
        )
        for name, well in written.items()
        if isinstance(well, SourceMapping)
    }
    pitch = _measure_pitch(names, spots, footprint["length_mm"])
    volume = 0.0
    if pitch > 0:
        volume = _read_number(reader, written[names[0][0]], "totalLiquidVolume", ("wells", names[0][0]))
    if volume <= 0:
        reader.add_warning(
            "The wells are not in a regular grid; they are left out.",
            ("wells",),
            "Write them yourself.",
        )
        return None
    x, y = spots[names[0][0]]
    grid = {
        "rows": len(names[0]),
        "columns": len(names),
        "pitch_mm": round(pitch, 3),
        "a1_x_mm": x,
        "a1_y_mm": round(footprint["width_mm"] - y, 3),
        "volume_ul": volume,
    }
    return SourceMapping(written.at, grid)


def _measure_pitch(names: list[list[str]], spots: dict[str, tuple[float, float]], alone: float) -> float:
    """The distance from one well to the next, in mm; 0 if it is not constant, ``alone`` for a single well."""
    rows = len(names[0]) if names else 0
    if not rows or any(len(column) != rows or not spots.keys() >= set(column) for column in names):
        return 0.0
    x, y = spots[names[0][0]]
    pitch = alone
    if len(names) > 1:
        pitch = spots[names[1][0]][0] - x
    elif rows > 1:
        pitch = y - spots[names[0][1]][1]
    for number, column in enumerate(names):
        for row, name in enumerate(column):
            off = (spots[name][0] - x - number * pitch, y - spots[name][1] - row * pitch)
            if max(map(abs, off)) > TOLERANCE_MM:
                return 0.0
    return pitch
