"""The entities of provenance, and links from an effect to its cause."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

EntityKind = Literal[
    "action",
    "calibration",
    "driver",
    "experiment",
    "file",
    "labware",
    "lot",
    "result",
    "run",
    "sample",
    "user",
    "well",
    "workflow",
]

ACTIVITIES = ("action", "experiment", "run")
AGENTS = ("driver", "user")


class Entity(msgspec.Struct, frozen=True):
    """``name`` is an id of its kind: for a well ``P7/B7``, for a driver ``module driver version``, for a file
    and a workflow its digest, for a result the action that returned it."""

    kind: EntityKind
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class ProvenanceLink(msgspec.Struct, frozen=True):
    """The effect depends on the cause; ``position`` is the event that shows this (0: no particular event)."""

    effect: Entity
    relation: str
    cause: Entity
    position: int = 0


class ProvenancePart(msgspec.Struct, frozen=True):
    """The part of a well's content from one origin. ``volume_ul`` and ``share`` are null if the volume is not
    known."""

    origin: Entity
    what: str
    volume_ul: float | None
    share: float | None
    certain: bool = True


class Graph(msgspec.Struct):
    """The result for a subject, at a position of the log. ``whole`` is false if there was more than the
    limit."""

    subject: Entity
    position: int
    facts: dict[str, Any] = {}
    contents: list[ProvenancePart] = []
    links: list[ProvenanceLink] = []
    entities: dict[str, dict[str, Any]] = {}
    whole: bool = True


def well_of(name: str) -> tuple[str, str]:
    """The plate and the well of ``P7/B7``."""
    plate, _, well = name.rpartition("/")
    return plate, well
