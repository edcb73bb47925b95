"""Which results are tables by well."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from labos.services.results import COLUMNS, Reading, ValueTable, iterate_tables
from tests.docs.markdown import REFERENCE, blocks


@pytest.mark.parametrize(
    ("result", "found"),
    [
        ({"wells": {"A1": 0.5}, "quantity": "OD600", "unit": "OD"}, [ValueTable("OD600", "OD", {"A1": 0.5})]),
        ({"a01": 1, "B2": 2}, [ValueTable("value", "", {"A1": 1, "B2": 2})]),
        (
            {"wells": {"A1": {"red": 3, "green": 4}}, "units": {"red": "1"}},
            [ValueTable("red", "1", {"A1": 3}), ValueTable("green", "", {"A1": 4})],
        ),
        ([{"wells": {"A1": True}}], [ValueTable("value", "", {"A1": True})]),
        ({"tables": [{"wells": {"A1": "clear"}}]}, [ValueTable("value", "", {"A1": "clear"})]),
        ({"wells": {"A1": None, "rest": 1}}, []),
        ("OD_0001.csv", []),
        ({"$too_large": 70000}, []),
        ({}, []),
        (None, []),
        ([1, 2], []),
    ],
)
def test_tables(result: Any, found: list[ValueTable]) -> None:
    assert list(iterate_tables(result)) == found


def test_the_wells_of_a_table_stand_in_the_order_of_the_plate() -> None:
    (table,) = iterate_tables({"wells": {"B1": 4, "A10": 3, "A1": 1, "A2": 2}})
    assert list(table.values) == ["A1", "A2", "A10", "B1"]


def test_the_reference_is_right() -> None:
    page = (REFERENCE / "samples.md").read_text()
    (examples,) = (block.text for block in blocks(page) if block.language == "json")
    for line in examples.strip().splitlines():
        assert list(iterate_tables(msgspec.json.decode(line))), line
    assert list(COLUMNS) == list(Reading.__struct_fields__)
    assert all(f"`{name}`" in page for name in COLUMNS)
