"""Old payloads, lifted to the present shape one version at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Lift = Callable[[dict[str, Any]], dict[str, Any]]


def _as_it_was(payload: dict[str, Any]) -> dict[str, Any]:
    """A version that only added fields, each with a default."""
    return payload


LIFTS: dict[tuple[str, int], Lift] = {
    ("plan.steps_recorded", 1): _as_it_was,
    ("module.taken_out", 1): _as_it_was,
}
"""(type, version) → a function that turns that version's payload into the next one's."""


def lift(type_: str, schema: int, target: int, payload: dict[str, Any]) -> dict[str, Any]:
    """Raise a payload from ``schema`` to ``target``. Raises KeyError where a lift is missing."""
    for version in range(schema, target):
        payload = LIFTS[type_, version](payload)
    return payload
