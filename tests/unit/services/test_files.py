"""Which files results name."""

from __future__ import annotations

from typing import Any

import pytest

from labos.http.routes.log import find_part
from labos.services.files import iterate_files

PICTURE = {"file": "plate.png", "sha256": "a" * 64, "bytes": 12}
TRACE = {"file": "trace.csv", "sha256": "b" * 64, "bytes": 3}


@pytest.mark.parametrize(
    ("result", "names"),
    [
        (None, []),
        (PICTURE, ["plate.png"]),
        ({"picture": PICTURE, "value": 3}, ["plate.png"]),
        ({"runs": [{"raw": [TRACE, PICTURE]}]}, ["trace.csv", "plate.png"]),
        ({"file": "x", "sha256": 7, "bytes": 1}, []),
        ({"file": "x"}, []),
    ],
)
def test_files_at_any_depth(result: Any, names: list[str]) -> None:
    assert [name for name, _, _ in iterate_files(result)] == names


@pytest.mark.parametrize(
    ("first", "last", "part"),
    [
        ("0", "", (0, 10)),
        ("2", "4", (2, 5)),
        ("2", "99", (2, 10)),
        ("", "3", (7, 10)),
        ("", "99", (0, 10)),
        ("10", "", None),
        ("5", "4", None),
        ("", "0", None),
        ("", "", None),
        ("9" * 19, "", None),
    ],
)
def test_ranges(first: str, last: str, part: tuple[int, int] | None) -> None:
    assert find_part(10, first, last) == part
