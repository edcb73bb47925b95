"""Old payloads, converted to the present form one version at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Lift = Callable[[dict[str, Any]], dict[str, Any]]


def _keep_payload(payload: dict[str, Any]) -> dict[str, Any]:
    """The next version only added fields with defaults."""
    return payload


def _with_topic(payload: dict[str, Any]) -> dict[str, Any]:
    """Add the topic of a question. Earlier versions read the data for an answer from ``subject``, ``motions``
    and the consequences of choices. This is done here, once."""
    topic = _upcast_topic(payload, payload["kind"], payload["subject"], payload.get("motions") or [])
    if topic is None:
        return payload
    common = {"run": payload.get("run", ""), "module": payload.get("module", "")}
    return {**payload, "topic": {**common, **topic}}


_OF_AN_ACTION = ("unknown_action", "planned_work", "discovered_action")
_OF_NO_FIELDS = ("doubtful_node", "outranked_node", "log_shorter", "device_waits", "second_person")


def _upcast_topic(
    payload: dict[str, Any], kind: str, subject: str, motions: list[Any]
) -> dict[str, Any] | None:
    choices = {choice["name"]: choice["consequence"] for choice in payload["choices"]}
    labware = payload.get("labware") or []
    if kind in _OF_AN_ACTION:
        return {"topic": kind, "action": subject}
    if kind in _OF_NO_FIELDS:
        return {"topic": kind}
    if kind == "lost_labware":
        return {"topic": kind, "action": subject, "motions": motions}
    if kind == "failed_run":
        return {"topic": "left_labware", "labware": labware, "lost_by": "" if payload.get("run") else subject}
    if kind == "lost_experiment":
        return {"topic": kind, "experiment": subject}
    if kind in ("late_step", "failed_step"):
        return {"topic": kind, "step": int(subject.rpartition("#")[2])}
    if kind == "closing_waits":
        return {"topic": kind, "user": ""}  # only the choices name it
    if kind == "barcode":
        reading = motions[0]
        read = {name: reading[name] for name in ("labware", "station", "barcode")}
        other = next((name for name in labware if name != reading["labware"]), "")
        return {"topic": kind, "action": subject, "other": other, **read}
    return _upcast_contradiction(subject, choices, labware, motions) if kind == "contradiction" else None


def _upcast_contradiction(
    subject: str, choices: dict[str, str], labware: list[str], motions: list[Any]
) -> dict[str, Any]:
    if not motions:
        return {"topic": "late_result", "action": subject}
    first, *others = motions
    if first["effect"] == "move":
        recorded = first["source"] if first["source"] != first["target"] else ""
        names = [needs["labware"] for needs in others]
        seen = {"station": first["target"], "labware": first["labware"], "recorded": recorded}
        return {"topic": "seen_elsewhere", **seen, "others": names}
    if first.get("labware"):
        return {"topic": "not_seen", "station": first["station"], "labware": labware}
    kind = choices.get("new", "").removeprefix("It is ").partition(" for ")[0]
    return {"topic": "unexpected", "station": first["station"], "type": kind}


def _with_no_anchor(payload: dict[str, Any]) -> dict[str, Any]:
    """If another run started a clock, the window has no anchor step in this run; this was written as -1."""
    return {**payload, "anchor": _negative_to_null(payload["anchor"])}


def _with_no_numbers_for_nothing(payload: dict[str, Any]) -> dict[str, Any]:
    """Missing anchors and resets were written as -1."""
    steps = [dict(step) for step in payload["steps"]]
    for step in steps:
        step["windows"] = [_with_no_anchor(window) for window in step.get("windows") or ()]
        retry = step.get("retry")
        if retry is not None:
            step["retry"] = {**retry, "reset": _negative_to_null(retry.get("reset", -1))}
    return {**payload, "steps": steps}


def _with_named_parts(payload: dict[str, Any]) -> dict[str, Any]:
    """The workflow itself was written as part -1, the ``on_cancel`` steps as part -2."""
    names = {-1: "main", -2: "on_cancel"}
    steps = [
        {**step, "part": names.get(part, part)}
        for step in payload["steps"]
        for part in [step.get("part", -1)]
    ]
    return {**payload, "steps": steps}


def _with_no_row(payload: dict[str, Any]) -> dict[str, Any]:
    """For a run without a campaign, the row was written as -1."""
    return {**payload, "row": _negative_to_null(payload.get("row", -1))}


def _negative_to_null(index: int) -> int | None:
    return index if index >= 0 else None


LIFTS: dict[tuple[str, int], Lift] = {
    ("plan.steps_recorded", 1): _keep_payload,
    ("plan.steps_recorded", 2): _with_no_numbers_for_nothing,
    ("plan.steps_recorded", 3): _with_named_parts,
    ("run.submitted", 1): _with_no_row,
    ("run.submitted", 2): _keep_payload,
    ("window.breached", 1): _with_no_anchor,
    ("module.taken_out", 1): _keep_payload,
    ("intervention.requested", 1): _with_topic,
}
"""(type, version) → a function that converts a payload of this version to the next version."""


def lift(type_: str, schema: int, target: int, payload: dict[str, Any]) -> dict[str, Any]:
    """Convert a payload from ``schema`` to ``target``. Raises KeyError if a conversion is missing."""
    for version in range(schema, target):
        payload = LIFTS[type_, version](payload)
    return payload
