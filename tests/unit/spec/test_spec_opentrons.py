"""Labware as Opentrons defines it."""

from __future__ import annotations

import json
from typing import Any

import pytest
from spec_bench import DESCRIPTIONS

from labos.errors import SpecError
from labos.spec import load_labware, parse_source
from labos.spec.dialects import detect_kind
from labos.spec.importing import import_spec


def definition(columns: int, rows: int, *, dx: float = 9.0, dy: float = 9.0, **more: Any) -> dict[str, Any]:
    names = [[f"{'ABCDEFGH'[row]}{column + 1}" for row in range(rows)] for column in range(columns)]
    wells = {
        name: {"x": 14.38 + c * dx, "y": 74.24 - r * dy, "z": 1, "depth": 10, "totalLiquidVolume": 360}
        for c, column in enumerate(names)
        for r, name in enumerate(column)
    }
    return {
        "ordering": names,
        "metadata": {"displayName": "A plate"},
        "dimensions": {"xDimension": 127.76, "yDimension": 85.48, "zDimension": 14.22},
        "parameters": {"loadName": "plate_0.36ml"},
        "wells": wells,
        "namespace": "opentrons",
        "version": 2,
        "schemaVersion": 2,
        **more,
    }


def test_a_plate() -> None:
    source = parse_source(json.dumps(definition(12, 8)), "plate.json")
    assert detect_kind(source) == ("labware", "opentrons")
    found = import_spec(source, DESCRIPTIONS)
    assert (found.counts, found.findings) == ({"types": 1}, ())
    [(name, plate)] = load_labware(source).items()
    assert (name, plate.description) == ("plate_0_36ml", "A plate")
    assert plate.footprint.height_mm == 14.22
    assert plate.wells is not None
    assert (plate.wells.rows, plate.wells.columns, plate.wells.pitch_mm) == (8, 12, 9.0)
    assert (plate.wells.a1_x_mm, plate.wells.a1_y_mm, plate.wells.volume_ul) == (14.38, 11.24, 360)
    assert load_labware(parse_source(found.text, "own.yaml")) == load_labware(source)


@pytest.mark.parametrize(("columns", "rows", "dx", "dy"), [(12, 1, 9, 9), (1, 8, 9, 9), (1, 1, 9, 9)])
def test_reservoirs(columns: int, rows: int, dx: float, dy: float) -> None:
    text = json.dumps(definition(columns, rows, dx=dx, dy=dy))
    [plate] = load_labware(parse_source(text)).values()
    assert plate.wells is not None
    assert (plate.wells.rows, plate.wells.columns) == (rows, columns)


@pytest.mark.parametrize(
    "odd", [definition(4, 2, dx=20, dy=18), definition(2, 2, ordering=[["A1", "B1"], ["A2"]])]
)
def test_wells_in_no_grid_are_left_out(odd: dict[str, Any]) -> None:
    found = import_spec(parse_source(json.dumps(odd, indent=1), "odd.json"), DESCRIPTIONS)
    assert [("not in a regular grid" in finding.message, finding.line > 1) for finding in found.findings] == [
        (True, True)
    ]
    [plate] = load_labware(parse_source(found.text)).values()
    assert plate.wells is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"dimensions": {"xDimension": "wide"}}, "`xDimension` is not a number"),
        ({"dimensions": 5}, "must be a table"),
        ({"ordering": 5}, "must be a list"),
        ({"wells": {"A1": {"x": 1}}}, "`y` is not a number"),
    ],
)
def test_what_is_not_understood(change: dict[str, Any], says: str) -> None:
    source = parse_source(json.dumps(definition(2, 2, **change), indent=1), "odd.json")
    with pytest.raises(SpecError, match=says) as caught:
        load_labware(source)
    assert caught.value.line > 1
