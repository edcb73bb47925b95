"""The house rules that a machine can check."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOP_LEVEL = {
    ".ci",
    ".gitignore",
    "CHANGELOG.md",
    "LICENSE",
    "README.md",
    "deploy",
    "docs",
    "drivers",
    "labos",
    "migrations",
    "pyproject.toml",
    "specs",
    "tests",
}
LONGEST_FILE = 700


def list_tracked(*patterns: str) -> list[Path]:
    done = subprocess.run(
        ["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / line for line in done.stdout.splitlines() if (ROOT / line).exists()]


def test_nothing_else_stands_at_the_top() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in list_tracked()} <= TOP_LEVEL


def test_files_do_not_become_two_things() -> None:
    long = {str(path): len(path.read_text().splitlines()) for path in list_tracked("*.py")}
    assert {path: lines for path, lines in long.items() if lines > LONGEST_FILE} == {}


def test_every_module_says_what_it_is() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for path in list_tracked("labos/**/*.py", "labos/*.py", "drivers/**/*.py")
        if path.read_text().strip() and not ast.get_docstring(ast.parse(path.read_text()))
    ]
    assert silent == []


def test_the_taken_name_is_never_installed() -> None:
    wrong = re.compile(r"pip3? install (-\S+ )*[\"']?labos(?!-sdl)\b")
    found = [
        str(path)
        for path in list_tracked()
        if path.suffix in (".md", ".py", ".yaml", ".toml")
        and path != Path(__file__)
        and wrong.search(path.read_text(errors="ignore"))
    ]
    assert found == []


def test_nobody_reaches_into_the_stores_private_files() -> None:
    inside = re.compile(r"labos\.store\._|labos\.store import _")
    found = [
        str(path.relative_to(ROOT))
        for path in list_tracked("labos/**/*.py", "drivers/**/*.py")
        if ROOT / "labos" / "store" not in path.parents and inside.search(path.read_text())
    ]
    assert found == []


def test_code_bears_no_reminders() -> None:
    marks = re.compile(r"\b(TODO|FIXME|XXX|HACK)\b")
    found = [
        str(path)
        for path in list_tracked("*.py")
        if path != Path(__file__) and marks.search(path.read_text())
    ]
    assert found == []


def test_own_code_is_never_mocked() -> None:
    found = [
        str(path)
        for path in list_tracked("*.py")
        if path != Path(__file__) and re.search(r"unittest\.mock|MagicMock", path.read_text())
    ]
    assert found == []
