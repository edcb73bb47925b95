"""The only form of errors in answers: problem documents (RFC 9457).

``PROBLEMS`` names each kind once, with its status; the description of the API and its reference page are
generated from it.
"""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.texts import make_code
from labos.errors import LabosError, SpecError
from labos.spec.findings import Finding, SpecErrors, make_finding

MEDIA_TYPE = "application/problem+json"


class ProblemKind(msgspec.Struct, frozen=True):
    """A kind of problem: its HTTP status and its general description."""

    status: int
    title: str


PROBLEMS: dict[str, ProblemKind] = {
    "bad_input": ProblemKind(400, "The request cannot be used"),
    "not_signed_in": ProblemKind(401, "The request is not authenticated"),
    "forbidden": ProblemKind(403, "The user does not have this right"),
    "not_found": ProblemKind(404, "There is nothing with this name"),
    "method_not_allowed": ProblemKind(405, "The path does not support this method"),
    "too_slow": ProblemKind(408, "The body was not sent in time"),
    "refused": ProblemKind(409, "The rules forbid this in the present state"),
    "key_reused": ProblemKind(409, "The Idempotency-Key belongs to another request"),
    "already_done": ProblemKind(
        409, "The request was carried out before, and its answer is no longer stored"
    ),
    "too_large": ProblemKind(413, "The request is too large"),
    "uri_too_long": ProblemKind(414, "The path or the query is too long"),
    "unsupported_media_type": ProblemKind(415, "The body is not JSON"),
    "range_not_satisfiable": ProblemKind(416, "The file does not have these bytes"),
    "spec_error": ProblemKind(422, "A file has an error"),
    "spec_errors": ProblemKind(422, "A file has errors"),
    "too_many_tries": ProblemKind(429, "There were too many attempts to sign in"),
    "internal": ProblemKind(500, "LabOS failed on this request"),
    "labos_error": ProblemKind(500, "LabOS has failed"),
    "internal_fault": ProblemKind(500, "LabOS failed on a command; nothing of it was done"),
    "invariant_broken": ProblemKind(500, "The command would break what must always hold; nothing was done"),
    "bus_error": ProblemKind(502, "The message bus failed"),
    "no_answer": ProblemKind(502, "A node did not answer"),
    "node_error": ProblemKind(502, "A node or its device failed"),
    "device_error": ProblemKind(502, "A device reported a failure"),
    "store_error": ProblemKind(503, "The event store failed"),
    "store_unavailable": ProblemKind(503, "The event store cannot be reached or written"),
    "log_damaged": ProblemKind(503, "A record or a file of the log is wrong"),
    "fenced": ProblemKind(503, "Another kernel has taken over"),
    "commit_in_doubt": ProblemKind(
        503,
        "The outcome of the request is unknown",
    ),
    "kernel_away": ProblemKind(503, "The kernel gave no answer to this process"),
    "behind": ProblemKind(503, "This process has not reached the position of the request yet"),
    "too_many": ProblemKind(503, "The lab gets too many requests at once"),
}


class Problem(msgspec.Struct, frozen=True):
    """A problem of a request. ``type`` and ``code`` name the kind of problem, ``title`` says it in general,
    ``detail`` what happened here, and ``remedy`` what to do. ``details`` has one entry for each finding in a
    file, with its place."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    remedy: str = ""
    details: tuple[Finding, ...] = ()


def make_problem(code: str, detail: str, remedy: str = "", details: tuple[Finding, ...] = ()) -> Problem:
    """A problem of a kind."""
    kind = PROBLEMS[code]
    return Problem(f"urn:labos:problem:{code}", kind.title, kind.status, detail, code, remedy, details)


def make_problem_of_error(error: LabosError) -> Problem:
    """The problem for an error. Its code is the error's own; its status and title are those of the nearest
    known kind."""
    findings = error.findings if isinstance(error, SpecErrors) else ()
    if isinstance(error, SpecError):
        return make_problem("spec_error", str(error), "", (make_finding(error),))
    codes = [make_code(kind.__name__) for kind in type(error).__mro__ if issubclass(kind, LabosError)]
    near, code = next(code for code in codes if code in PROBLEMS), codes[0]
    found = make_problem(near, error.message, error.remedy, tuple(findings))
    return msgspec.structs.replace(found, code=code, type=f"urn:labos:problem:{code}")


def describe_error(error: LabosError) -> dict[str, Any]:
    """An error in the JSON form of commands: ``{error, remedy, code, details}``."""
    found = make_problem_of_error(error)
    details = msgspec.to_builtins(found.details)
    return {"error": found.detail, "remedy": found.remedy, "code": found.code, "details": details}
