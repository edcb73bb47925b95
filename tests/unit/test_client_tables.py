"""Tables in files of instruments, as they come."""

from __future__ import annotations

from typing import Any

import pytest

from labos.client._lab import rows_of


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("well,OD\nA1,0.25\nA2,1\n", [{"well": "A1", "OD": 0.25}, {"well": "A2", "OD": 1}]),
        ("well;OD\r\nA1;0,25\r\n", [{"well": "A1", "OD": 0.25}]),
        ("well\tsample\tOD\nA1\t1_000\t2e-3\n", [{"well": "A1", "sample": "1_000", "OD": 0.002}]),
        ('name,note\n"Meyer, Ada","two\nlines"\n', [{"name": "Meyer, Ada", "note": "two\nlines"}]),
        ("\n\nwell,OD\n\nA1,\n,\n", [{"well": "A1", "OD": ""}]),
        ("well,OD,file\nA1,1\n", [{"well": "A1", "OD": 1}]),
        ("one column\n3\n", [{"one column": 3}]),
        ("well,OD\n", []),
    ],
)
def test_rows(text: str, rows: list[dict[str, Any]]) -> None:
    assert rows_of(text) == rows


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "first line"),
        ("\n \n", "first line"),
        ("OD,OD\n1,2\n", "first line does not name each column once"),
        ("well,OD\nA1,1,2\n", "line 2 has 3 values for 2 columns"),
    ],
)
def test_what_is_no_table(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        rows_of(text)
