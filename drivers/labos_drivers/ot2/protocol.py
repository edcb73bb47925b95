"""The interface of the OT-2's robot server: its requests, and the words of its answers.

HTTP on port 31950, JSON, no authentication; each request has the header ``Opentrons-Version``.
Source: Opentrons/opentrons, robot-server (its OpenAPI is at ``/openapi.json`` of each robot), version
8.1; AD-SDL/ot2_module, src/ot2_interface/ot2_driver_http.py.
"""

from __future__ import annotations

import pprint
from collections.abc import Mapping
from typing import Any

PORT = 31950
HEADERS = {"Opentrons-Version": "3"}

IDLE = "idle"
SUCCEEDED, FAILED, STOPPED = "succeeded", "failed", "stopped"
TERMINAL = (SUCCEEDED, FAILED, STOPPED)
"""All other states, also those of later versions, are on the way to one of these."""

WAITS_FOR = {
    "paused": "the run is paused: find the reason, then resume it",
    "blocked-by-open-door": "its door or top window is open: close it, then resume the run",
    "awaiting-recovery": (
        "an error occurred that a person can correct: check the robot, correct the error, then resume the run"
    ),
    "awaiting-recovery-paused": "its recovery is paused: resume the run",
    "awaiting-recovery-blocked-by-open-door": (
        "an error occurred, and its door or top window is open: correct the error, close the door, "
        "then resume the run"
    ),
}
"""States in which a run goes on only when a person has done something, and what."""

RESUMED_BY = {
    "paused": "play",
    "awaiting-recovery-paused": "resume-from-recovery",
    "awaiting-recovery": "resume-from-recovery",
}
"""The action by which it goes on."""

MARK = b"\n\n# The values of this run.\nLABOS = "


def with_values(protocol: bytes, values: Mapping[str, Any]) -> bytes:
    """A protocol in Python with the values of the run in its global ``LABOS``. They can stand at the end,
    because the protocol reads them only when its ``run`` is called."""
    return protocol + MARK + pprint.pformat(dict(values), width=100).encode() + b"\n"


def find_reason(body: Any, status: int) -> str:
    """The server's reason for its refusal of a request; the HTTP status if it gives none."""
    if isinstance(body, dict):
        errors = body.get("errors")
        if isinstance(errors, list) and errors and isinstance(errors[0], dict):
            return str(errors[0].get("detail") or errors[0].get("title") or errors[0].get("id"))
        if body.get("message"):
            return str(body["message"])
    return f"status {status}"


def find_innermost(errors: Any) -> str:
    """The innermost error of a run, as text. The errors around it only pass it on."""
    error = errors[0] if isinstance(errors, list) and errors else {}
    while isinstance(error, dict) and error.get("wrappedErrors"):
        error = error["wrappedErrors"][0]
    if not isinstance(error, dict) or not error:
        return "without a reason"
    return (
        f"{error.get('errorType', 'error')} {error.get('errorCode', '')}: {error.get('detail', '')}".strip()
    )
