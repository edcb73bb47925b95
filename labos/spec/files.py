"""Finds the files that arguments name, only within the allowed folders."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath

import msgspec

from labos.core.canonical import digest

MAX_BYTES = 64 * 1024 * 1024

MOST_FILES, HEAD = 50, 64 * 1024
"""The most files of a folder, and the most bytes of each, that are read to find a workcell."""


LEVELS = 3
"""The lab's folder is at most this number of levels above the workflow's folder."""

_LOGICAL = re.compile(r"(?:[\w.-]+/)+[\w-]+")

_STEPS = re.compile(r"^(flowdef|steps):", re.MULTILINE)
_WORKCELL = re.compile(r"^(modules|workcell_nodes|nodes):", re.MULTILINE)


def find_lab_folder(folder: Path) -> Path:
    """The nearest folder, up to three levels above, with a workcell file, or with workcell files in a folder
    ``workcells``, as in the packaged specs. Paths in a workflow may go through it, as ``../protocols/mix.py``
    does. The workflow's own folder if there is none."""
    for around in (folder, *folder.parents[:LEVELS]):
        if _list_workcells_in(around) or _list_workcells_in(around / "workcells"):
            return around
    return folder


def find_workcells(folder: Path) -> list[Path]:
    """The workcell files of the nearest folder, up to three levels above, that has any."""
    for around in (folder, *folder.parents[:LEVELS]):
        if found := _list_workcells_in(around):
            return found
    return []


def _list_workcells_in(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.glob("*.y*ml"))[:MOST_FILES] if _is_workcell(path)]


def is_within(path: Path, folder: Path) -> bool:
    """Whether a path stays in a workflow's folder, or in the lab's folder around it."""
    return path.is_relative_to(folder) or path.is_relative_to(find_lab_folder(folder))


def _is_workcell(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8", errors="replace") as stream:
            text = stream.read(HEAD)
    except OSError:
        return False
    # Workflows of WEI list their modules too.
    return _WORKCELL.search(text) is not None and not _STEPS.search(text)


class FileLookup(msgspec.Struct, frozen=True):
    """A file's content and digest, or the reason why it was not found."""

    content: bytes | None = None
    digest: str = ""
    problem: str = ""


def find_logical(name: str, folder: Path) -> str:
    """The file to which a logical name refers, such as ``protocols/mix`` for ``protocols/mix.py``: the only
    file of that name in its folder, with any suffix. Otherwise (a suffix, no folder, no or several such
    files) the name itself."""
    if not is_logical(name):
        return name
    try:
        found = [path.name for path in sorted((folder / name).parent.glob(f"{PurePath(name).name}.*"))]
    except (OSError, ValueError):
        return name
    return str(PurePath(name).with_name(found[0])) if len(found) == 1 else name


def is_logical(name: str) -> bool:
    """Whether a text may be the name of a file without its suffix."""
    return _LOGICAL.fullmatch(name) is not None


class FileFinder:
    """Searches the files that were handed in first, and then the folders."""

    def __init__(self, given: Mapping[str, bytes], folders: Sequence[Path]) -> None:
        self.given = given
        self.folders = [folder.resolve() for folder in folders]

    def find_full_name(self, name: str) -> str:
        """The full name for a logical name: from the files that were handed in, otherwise from the
        folders."""
        if name in self.given or not is_logical(name):
            return name
        given = [full for full in self.given if str(PurePath(full).with_suffix("")) == name]
        if given:
            return given[0] if len(given) == 1 else name
        return next((full for f in self.folders if (full := find_logical(name, f)) != name), name)

    def find(self, name: str) -> FileLookup:
        """The file of that name. A path that leads out of its folder, and out of the lab's folder around it,
        is refused."""
        if name in self.given:
            return FileLookup(self.given[name], digest(self.given[name]))
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
                    return FileLookup(problem=f"is larger than {MAX_BYTES // 1024 // 1024} MB")
                content = path.read_bytes()
            except (OSError, ValueError, RuntimeError) as error:
                problem = f"cannot be read ({error})"
                continue
            return FileLookup(content, digest(content))
        return FileLookup(problem=problem)
