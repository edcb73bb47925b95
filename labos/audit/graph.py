"""What can be asked about, and how it hangs together: entities, and links from an effect to its cause."""

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
    """``name`` is an id of its kind: of a well ``P7/B7``, of a driver ``module driver version``, of a file
    and a workflow its digest, of a result the action that returned it."""

    kind: EntityKind
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class ProvenanceLink(msgspec.Struct, frozen=True):
    """The effect hangs on the cause; ``position`` is the event that says so (0: none in particular)."""

    effect: Entity
    relation: str
    cause: Entity
    position: int = 0


class ProvenancePart(msgspec.Struct, frozen=True):
    """What a well holds of one origin. ``volume_ul`` and ``share`` are null where nobody said how much."""

    origin: Entity
    what: str
    volume_ul: float | None
    share: float | None
    certain: bool = True


class Graph(msgspec.Struct):
    """What was found of a subject, as it was known at a position of the log. ``whole`` is false if there was
    more than was asked for."""

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
