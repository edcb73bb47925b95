"""The one shape in which errors leave the server: ``{error, remedy, code, details}``."""

from __future__ import annotations

import re
from typing import Any

import msgspec

from labos.errors import BadInput, BusError, LabosError, NodeError, NotFound, Refused, SpecError, StoreError
from labos.spec.findings import SpecErrors, finding_of


def status_of(error: LabosError) -> int:
    """The HTTP status for an error."""
    match error:
        case NotFound():
            return 404
        case Refused():
            return 409
        case SpecError() | SpecErrors():
            return 422
        case BadInput():
            return 400
        case StoreError():
            return 503
        case BusError() | NodeError():
            return 502
    return 500


def body_of(error: LabosError) -> dict[str, Any]:
    """``details`` holds one entry for each finding in a file, with its place."""
    findings = error.findings if isinstance(error, SpecErrors) else ()
    if isinstance(error, SpecError):
        findings = (finding_of(error),)
    return {
        "error": error.message if not isinstance(error, SpecError) else str(error),
        "remedy": "" if isinstance(error, SpecError) else error.remedy,
        "code": code_of(type(error)),
        "details": [msgspec.to_builtins(finding) for finding in findings],
    }


def code_of(kind: type[LabosError]) -> str:
    """``StoreUnavailable`` → ``store_unavailable``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
