"""Faults of a file, with the place and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any, Literal, TypedDict, Unpack

import msgspec

from labos.errors import BadInput, SpecError
from labos.spec.source import NOWHERE, Path_, Place, Source

Severity = Literal["error", "warning"]

MOST = 200
"""The most findings of one severity that are kept for a file."""

LONGEST = 1000
"""The most characters of a finding's message."""

Assumed = Literal["", "module", "driver", "action", "place", "pose"]
ASSUMED = ("module", "driver", "action", "place", "pose", "")
"""The kinds of assumptions in warnings, the most important first: the kind of a module, its driver, the
meaning of an action, the meaning of a place, a missing pose, anything else."""


class Finding(msgspec.Struct, frozen=True):
    """One remark on a file. An error forbids its use; a warning does not."""

    severity: Severity
    message: str
    file: str = ""
    line: int = 0
    column: int = 0
    field: str = ""
    remedy: str = ""
    assumed: Assumed = ""

    def as_error(self) -> SpecError:
        where = {"file": self.file, "line": self.line, "column": self.column, "field": self.field}
        return SpecError(self.message, **where, remedy=self.remedy)  # type: ignore[arg-type]

    def __str__(self) -> str:
        return f"{self.as_error()} ({self.severity})"


def make_finding(error: SpecError) -> Finding:
    """A SpecError as a finding."""
    return Finding("error", error.message, error.file, error.line, error.column, error.field, error.remedy)


class SpecErrors(BadInput):
    """A file has errors. ``errors`` has all errors; ``findings`` also has the warnings."""

    def __init__(self, findings: Iterable[Finding]) -> None:
        self.findings = tuple(findings)
        self.errors = tuple(f.as_error() for f in self.findings if f.severity == "error")
        super().__init__("\n".join(str(error) for error in self.errors))


def list_findings(error: SpecError | SpecErrors) -> list[Finding]:
    """The findings of a file that cannot be used."""
    return list(error.findings) if isinstance(error, SpecErrors) else [make_finding(error)]


class FindingFields(TypedDict, total=False):
    """What else may be said of a finding."""

    field: str
    remedy: str
    file: str
    assumed: Assumed


class FindingList:
    """Collects findings while a file is read."""

    def __init__(self, file: str = "") -> None:
        self.file = file
        self.findings: list[Finding] = []
        self._known: set[Finding] = set()
        self._count: dict[Severity, int] = {"error": 0, "warning": 0}

    def error(self, message: str, place: Place = NOWHERE, **more: Unpack[FindingFields]) -> None:
        self._add("error", message, place, **more)

    def add_warning(self, message: str, place: Place = NOWHERE, **more: Unpack[FindingFields]) -> None:
        self._add("warning", message, place, **more)

    def take(self, other: FindingList) -> None:
        """Add the findings of another file."""
        for finding in other.findings:
            self.keep(finding)

    def _add(
        self,
        severity: Severity,
        message: str,
        place: Place,
        field: str = "",
        remedy: str = "",
        file: str = "",
        assumed: Assumed = "",
    ) -> None:
        message = message if len(message) <= LONGEST else f"{message[:LONGEST]} …"
        where = (file or self.file, place.line, place.column, field[-LONGEST:])
        self.keep(Finding(severity, message, *where, remedy[:LONGEST], assumed))

    def keep(self, finding: Finding) -> None:
        """Add a finding unchanged."""
        if self._count[finding.severity] >= MOST:
            self._count[finding.severity] += 1
        elif finding not in self._known:
            self._known.add(finding)
            self._count[finding.severity] += 1
            self.findings.append(finding)

    def keep_error(self, error: SpecError) -> None:
        """Add an error, which names its own place."""
        self.keep(make_finding(error))

    @property
    def errors(self) -> int:
        """The number of errors until now."""
        return self._count["error"]

    def sort_findings(self) -> tuple[Finding, ...]:
        """By place in the file."""
        return tuple(sorted(self.findings, key=lambda f: (f.file, f.line, f.column)))

    def raise_if_failed(self) -> None:
        if self.errors:
            raise SpecErrors(self.sort_findings())


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


def suggest_name(name: str, known: Iterable[str], what: str = "name") -> str:
    """A remedy that names the known name nearest to the written one, or the few names that contain it."""
    names = sorted(set(known))
    if similar := suggest_similar(name, names):
        return similar
    if not names:
        return f"There is no {what} here."
    shown = ", ".join(names[:12]) + (", …" if len(names) > 12 else ".")
    return f"Known: {shown}"


def suggest_similar(name: str, known: Iterable[str]) -> str:
    """A remedy that names the similar known names; empty if there are none."""
    names = sorted(set(known))
    alike = [candidate for candidate in names if candidate.lower() == name.lower()]
    if alike:
        return f"Did you mean {' or '.join(map(repr, alike))}? Upper and lower case count."
    by_lower = {candidate.lower(): candidate for candidate in names}
    found = difflib.get_close_matches(name[:LONGEST].lower(), by_lower, n=2, cutoff=0.6)
    if found:
        return f"Did you mean {' or '.join(repr(by_lower[match]) for match in found)}?"
    part = [candidate for candidate in names if len(name) >= 3 and name.lower() in candidate.lower()]
    return f"Did you mean {' or '.join(map(repr, part))}?" if 1 <= len(part) <= 3 else ""
