"""The page on the bench's rules names tests that there are, and each mutant switches something off."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROW = re.compile(r"`(test_\w+\.py)::(test_\w+)`")
ROWS = [
    line
    for line in (ROOT / "docs" / "bench-rules.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("|") and "::" in line
]


def functions(file: str) -> dict[str, ast.FunctionDef]:
    path = ROOT / "tests" / "simulation" / file
    assert path.is_file(), f"there is no {path}"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip())
def test_every_rule_has_a_test_and_what_it_names_is_there(row: str) -> None:
    _, rule, held, switched_off, breaks, _ = (cell.strip() for cell in row.split("|"))
    assert rule
    assert breaks
    assert ROW.search(held)
    for file, name in ROW.findall(held + switched_off):
        assert name in functions(file), f"{file} has no {name}"
