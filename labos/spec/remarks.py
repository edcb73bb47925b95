"""Findings at places in one file, given by their paths."""

from __future__ import annotations

from typing import Any

from labos.spec.findings import Assumed, FindingList
from labos.spec.source import Path_, Source


class Remarks:
    """Reports a fault at a path of a file; ``key`` points at the key instead of the value."""

    def __init__(self, source: Source, report: FindingList) -> None:
        self.source, self.report = source, report

    def error(self, message: str, path: Path_, remedy: str, *, key: bool = False) -> None:
        self.report.error(message, remedy=remedy, **self._locate(path, key))

    def add_warning(
        self, message: str, path: Path_, remedy: str, *, key: bool = False, assumed: Assumed = ""
    ) -> None:
        self.report.add_warning(message, remedy=remedy, assumed=assumed, **self._locate(path, key))

    def _locate(self, path: Path_, key: bool) -> dict[str, Any]:
        source, at, name = self.find_source(path)
        place, field = source.place(at, key=key), source.name_field(at) + name
        return {"place": place, "field": field, "file": source.file}

    def find_source(self, path: Path_) -> tuple[Source, Path_, str]:
        """The file in which a path is written, the path there, and a text after the name of the field."""
        return self.source, path, ""
