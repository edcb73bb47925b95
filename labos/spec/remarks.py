"""Findings at places in one file, given by their paths."""

from __future__ import annotations

from labos.spec.findings import Assumed, FindingList
from labos.spec.source import Path_, Source


class Remarks:
    """Reports a fault at a path of a file; ``key`` points at the key instead of the value."""

    def __init__(self, source: Source, report: FindingList) -> None:
        self.source, self.report = source, report

    def error(self, message: str, path: Path_, remedy: str, *, key: bool = False) -> None:
        place, field = self.source.place(path, key=key), self.source.name_field(path)
        self.report.error(message, place, field=field, remedy=remedy)

    def add_warning(
        self, message: str, path: Path_, remedy: str, *, key: bool = False, assumed: Assumed = ""
    ) -> None:
        place, field = self.source.place(path, key=key), self.source.name_field(path)
        self.report.add_warning(message, place, field=field, remedy=remedy, assumed=assumed)
