"""What a lab answers: data, or the error that it tells of."""

from __future__ import annotations

from typing import Any

import msgspec

from labos import errors
from labos.errors import BadInput, LabosError

AS_BAD_INPUT = ("spec_errors", "spec_error", "too_large", "too_slow", "uri_too_long")
"""Codes of what comes back as ``BadInput``."""


class LabUnreachable(LabosError):
    """No lab answers."""


class ProblemDocument(msgspec.Struct):
    """A problem document, as far as it is read here."""

    code: str = ""
    detail: str = ""
    remedy: str = ""


def answer_of(status: int, content: bytes) -> dict[str, Any]:
    """What the lab said. Raises the error it told of."""
    try:
        data = msgspec.json.decode(content)
    except msgspec.MsgspecError:
        data = None
    if not isinstance(data, dict):
        raise LabUnreachable(
            f"What answers is no lab (status {status}).", remedy="Check the address of the lab."
        )
    if status < 400:
        return data
    problem = decode_problem(content)
    raise _list_errors().get(problem.code, LabosError)(problem.detail, remedy=problem.remedy)


def make_cannot_write_error(content: bytes) -> LabUnreachable:
    """What is told of a lab that is there and cannot write, with the lab's own reason and remedy."""
    problem = decode_problem(content)
    reason = f": {problem.detail}" if problem.detail else "."
    return LabUnreachable(f"The lab cannot write its log at the moment{reason}", remedy=problem.remedy)


def decode_problem(content: bytes) -> ProblemDocument:
    """The problem that the lab told of; its fields are empty if it told of none."""
    try:
        return msgspec.json.decode(content, type=ProblemDocument)
    except msgspec.MsgspecError:
        return ProblemDocument()


def _list_errors() -> dict[str, type[LabosError]]:
    """Error classes by their code; those with fields of their own come back as their parents."""
    found: dict[str, type[LabosError]] = dict.fromkeys(AS_BAD_INPUT, BadInput)
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, LabosError) and kind.__init__ is LabosError.__init__:
            code = "".join(f"_{c.lower()}" if c.isupper() and at else c.lower() for at, c in enumerate(name))
            found[code] = kind
    return found
