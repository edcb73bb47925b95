"""``rest:`` of a module's config: a table with the requests to any HTTP device.

Texts may contain ``{action}`` (the device's name of the action), ``{args}`` (all arguments), ``{id}`` (LabOS'
id of the action, or the id that the device gave to the job) and ``{argument}``. A text that consists of only
one of these is replaced by the value itself.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ValidationError

from labos.spec.parts import Part
from labos.spec.validation import describe_flaw


class Request(Part):
    """One request. ``params`` go into the URL, ``json`` into the body."""

    method: Literal["GET", "POST", "PUT", "PATCH", "DELETE"] = "POST"
    path: str
    params: dict[str, Any] = {}
    json_: Any = None


class Reading(Part):
    """How an answer says how an action ended. Fields are named by their path, as ``job.status``;
    without ``status``, any 2xx is a success. A status in none of the lists says nothing. ``refused`` are
    HTTP statuses (4xx) with which the device says, also at once, that it has not begun."""

    status: str = ""
    done: list[Any] = ["succeeded"]
    running: list[Any] = []
    not_started: list[Any] = []
    failed: list[Any] = ["failed", "error", "aborted", "cancelled", "canceled"]
    refused: list[int] = []
    error: str = ""
    result: str = ""


class Job(Part):
    """Actions that continue after the answer. The job's ``id`` is in the answer to the start, and ``path``
    returns its state. Without ``id``, the job has LabOS' id, which was sent with the start."""

    path: str
    id: str = ""


class State(Part):
    """How the device says that it is busy or in error. With ``idle``, a status in none of the lists is not
    idle; an answer that tells no status never is."""

    path: str
    status: str = ""
    busy: list[Any] = []
    idle: list[Any] = []
    error: list[Any] = []
    why: str = ""


class Levels(Part):
    """Where the device tells the levels of its resources."""

    path: str
    at: str = ""


class RestMapping(Part):
    """A device's HTTP interface. ``actions`` says what differs for single actions."""

    action: dict[str, Any] | None = None
    actions: dict[str, dict[str, Any]] = {}
    outcome: Reading = Reading()
    job: Job | None = None
    state: State | None = None
    reset: dict[str, Any] | None = None
    stop: dict[str, Any] | None = None
    resources: Levels | None = None

    def request(self, action: str) -> Request | None:
        """The request that starts an action; None if the table has none."""
        fields = self.actions.get(action) or self.action
        return None if fields is None else request_of(fields)


def request_of(fields: dict[str, Any]) -> Request:
    """A request in the form of the file: pydantic's models reserve the name ``json``."""
    return Request.model_validate({"json_" if key == "json" else key: value for key, value in fields.items()})


def find_flaw(table: Any) -> str:
    """The fault of a mapping, as text; empty if it has none."""
    try:
        mapping = RestMapping.model_validate(table)
        for written in (mapping.action, mapping.reset, mapping.stop, *mapping.actions.values()):
            if written is not None:
                request_of(written)
    except ValidationError as errors:
        return describe_flaw(errors)
    if mapping.action is None and not mapping.actions:
        return "`action` or `actions` is needed, to define how an action is started"
    return ""
