"""The page on security: each attack that it tells of has a test, and each test that it names is there."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import msgspec
import pytest

from tests.docs.markdown import DOCS, ROOT

TESTS = ROOT / "tests"
FILE = re.compile(r"(?:tests/)?((?:\w+/)*\w+\.py)")
NAME = re.compile(r"\btest_\w+\b(?!\.py)")
AGAIN = re.compile(r"\bthe same\b")


class Attack(msgspec.Struct, frozen=True):
    """A row of a table that says what was ``tried``; ``shown`` is the cell that names its test, ``files`` are
    those in which it may be."""

    line: int
    tried: str
    shown: str
    files: tuple[str, ...]


def attacks() -> list[Attack]:
    """Each with the files of tests that its section has named so far."""
    found: list[Attack] = []
    heads: list[str] = []
    files: list[str] = []
    for number, line in enumerate((DOCS / "security.md").read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("#"):
            files = []
        files += FILE.findall(line)
        if not line.startswith("|"):
            heads = []
            continue
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if not heads:
            heads = cells
        elif heads[0] == "tried" and not set(line) <= set("| -"):
            shown = cells[-1] if heads[-1] in ("test", "shown by") else ""
            found.append(Attack(number, cells[0], shown, tuple(files)))
    return found


ATTACKS = attacks()


@cache
def files_called(name: str) -> tuple[Path, ...]:
    """The files of tests whose path ends so."""
    return tuple(path for path in TESTS.rglob("*.py") if path.as_posix().endswith(f"/{name}"))


@cache
def functions_of(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, functions))


def test_the_page_tells_of_attacks() -> None:
    assert len(ATTACKS) > 100


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: f"{attack.line}")
def test_each_attack_has_a_test_that_is_there(attack: Attack) -> None:
    files = [path for name in attack.files for path in files_called(name)]
    for name in FILE.findall(attack.shown):
        assert files_called(name), f"there is no {name}"
    names = NAME.findall(attack.shown)
    assert FILE.search(attack.shown) or names or AGAIN.search(attack.shown), f"{attack.tried}: no test"
    assert files, f"{attack.tried}: no file of tests was named before it"
    for name in names:
        assert any(name in functions_of(path) for path in files), f"{name} is in none of {attack.files}"
