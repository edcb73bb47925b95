"""Finds the files that arguments name, without leaving the folders they may stand in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from labos.core.canonical import digest

MAX_BYTES = 64 * 1024 * 1024


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
        """The file of that name. A path that leads out of a folder is not followed."""
        if name in self.given:
            return Found(self.given[name], digest(self.given[name]))
        problem = "was not found"
        for folder in self.folders:
            try:
                path = (folder / name).resolve()
                if not path.is_relative_to(folder):
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
