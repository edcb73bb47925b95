"""Finds the files that arguments name, without leaving the folders they may stand in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from labos.core.canonical import digest

MAX_BYTES = 64 * 1024 * 1024

MOST_FILES, HEAD = 50, 64 * 1024
"""How many files of a folder, and how much of each, are looked at to find a workcell among them."""


LEVELS = 3
"""How many folders above a workflow's may be the lab's."""

_STEPS = re.compile(r"^(flowdef|steps):", re.MULTILINE)
_WORKCELL = re.compile(r"^(modules|workcell_nodes|nodes):", re.MULTILINE)


def lab_folder(folder: Path) -> Path:
    """The nearest folder, up to three above, that holds a workcell file: paths in a workflow may lead through
    it, as ``../protocols/mix.py`` does. The workflow's own folder if none does."""
    found = find_workcells(folder)
    return found[0].parent if found else folder


def find_workcells(folder: Path) -> list[Path]:
    """The workcell files of the nearest folder, up to three above, that holds any."""
    for around in (folder, *folder.parents[:LEVELS]):
        if found := [path for path in sorted(around.glob("*.y*ml"))[:MOST_FILES] if _is_workcell(path)]:
            return found
    return []


def is_within(path: Path, folder: Path) -> bool:
    """Whether a path stays in a workflow's folder, or in the lab's folder around it."""
    return path.is_relative_to(folder) or path.is_relative_to(lab_folder(folder))


def _is_workcell(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8", errors="replace") as stream:
            text = stream.read(HEAD)
    except OSError:
        return False
    # Workflows of WEI list their modules too.
    return _WORKCELL.search(text) is not None and not _STEPS.search(text)


class Found(msgspec.Struct, frozen=True):
    """A file's content and digest, or why there is none."""

    content: bytes | None = None
    digest: str = ""
    problem: str = ""


class FileFinder:
    """Looks first among the files that were handed in, then in the folders."""

    def __init__(self, given: Mapping[str, bytes], folders: Sequence[Path]) -> None:
        self.given = given
        self.folders = [folder.resolve() for folder in folders]

    def find(self, name: str) -> Found:
        """The file of that name. A path that leads out of a folder, and out of the lab's folder around it, is
        not followed."""
        if name in self.given:
            return Found(self.given[name], digest(self.given[name]))
        problem = "was not found"
        for folder in self.folders:
            try:
                path = (folder / name).resolve()
                if not is_within(path, folder):
                    problem = "lies outside the workflow's folder"
                    continue
                if not path.is_file():
                    continue
                if path.stat().st_size > MAX_BYTES:
                    return Found(problem=f"is larger than {MAX_BYTES // 1024 // 1024} MB")
                content = path.read_bytes()
            except (OSError, ValueError, RuntimeError) as error:
                problem = f"cannot be read ({error})"
                continue
            return Found(content, digest(content))
        return Found(problem=problem)
