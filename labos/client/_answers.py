"""A lab's answers: data, or the error that it reports."""

from __future__ import annotations

from typing import Any

import msgspec

from labos import errors
from labos.core.texts import make_code
from labos.errors import BadInput, LabosError

AS_BAD_INPUT = ("spec_errors", "spec_error", "too_large", "too_slow", "uri_too_long")
"""Codes of problems that are raised as ``BadInput``."""


class LabUnreachable(LabosError):
    """No lab answers."""


class ProblemDocument(msgspec.Struct):
    """The fields of a problem document that are read here."""

    code: str = ""
    detail: str = ""
    remedy: str = ""


def answer_of(status: int, content: bytes) -> dict[str, Any]:
    """The data of an answer. Raises the error that the lab reports."""
    try:
        data = msgspec.json.decode(content)
    except msgspec.MsgspecError:
        data = None
    if not isinstance(data, dict):
        raise LabUnreachable(
            f"The server at this address is not a lab (status {status}).",
            remedy="Check the address of the lab.",
        )
    if status < 400:
        return data
    problem = decode_problem(content)
    raise _list_errors().get(problem.code, LabosError)(problem.detail, remedy=problem.remedy)


def make_cannot_write_error(content: bytes) -> LabUnreachable:
    """The error for a lab that answers and cannot write, with the lab's own reason and remedy."""
    problem = decode_problem(content)
    reason = f": {problem.detail}" if problem.detail else "."
    return LabUnreachable(f"The lab cannot write its log at the moment{reason}", remedy=problem.remedy)


def decode_problem(content: bytes) -> ProblemDocument:
    """The problem that the lab reports; its fields are empty if it reports none."""
    try:
        return msgspec.json.decode(content, type=ProblemDocument)
    except msgspec.MsgspecError:
        return ProblemDocument()


def _list_errors() -> dict[str, type[LabosError]]:
    """Error classes by their code; a class with fields of its own is replaced by its parent."""
    found: dict[str, type[LabosError]] = dict.fromkeys(AS_BAD_INPUT, BadInput)
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, LabosError) and kind.__init__ is LabosError.__init__:
            found[make_code(name)] = kind
    return found
