"""The origin of something, and its effects, at any past position of the log."""

from __future__ import annotations

import re
from typing import Literal, cast

from labos.audit._causes import CAUSES
from labos.audit._effects import EFFECTS
from labos.audit._facts import facts_of
from labos.audit._links import find_links
from labos.audit.graph import Entity, EntityKind, Graph, ProvenanceLink, well_of
from labos.audit.liquids import trace_contents
from labos.audit.query import ReadConnection
from labos.errors import NotFound

Direction = Literal["up", "down"]

MOST_LINKS = 2000
"""The default limit of an answer, which reports that there is more; ``most`` sets another limit."""

_DIGEST = re.compile(r"[0-9a-f]{64}")
_STEP = re.compile(r"([^#\s]+)\s*#(\d+)")
_PREFIXES: dict[EntityKind, str] = {
    "run": "SELECT 1 FROM runs WHERE run = ? AND submitted_position <= ?",
    "labware": "SELECT 1 FROM labware WHERE labware = ? AND placed_position <= ?",
    "experiment": "SELECT 1 FROM experiments WHERE experiment = ? AND started_position <= ?",
    "sample": "SELECT 1 FROM samples WHERE sample = ? AND position <= ?",
    "lot": "SELECT 1 FROM lot_uses WHERE lot = ? AND position <= ?",
    "file": "SELECT 1 FROM files WHERE digest = ? AND position <= ?",
    "workflow": "SELECT 1 FROM runs WHERE plan = ? AND submitted_position <= ?",
    "action": "SELECT 1 FROM actions WHERE action = ? AND requested_position <= ?",
    "calibration": "SELECT 1 FROM calibrations WHERE calibration = ? AND position <= ?",
    "user": "SELECT 1 FROM events WHERE actor = ? AND position <= ?",
    "result": "SELECT 1 FROM actions WHERE action = ? AND result IS NOT NULL AND ended_position <= ?",
}
"""Kinds of entities in the order in which a name without a kind is looked up, with the look-ups. The name of
a result is that of an action, which is found before."""


def subject_of(asker: ReadConnection, text: str, upto: int) -> Entity:
    """Find the entity that a user names: ``P7``, ``P7/B7``, ``R1``, ``R1#3`` (the result of its step 3), the
    digest of a file, a sample, a lot. A prefix such as ``lot:`` or ``sample:`` sets the kind. Raises
    NotFound."""
    prefix, _, name = text.partition(":")
    kind = cast(EntityKind, prefix)
    if name and kind == "driver" and name.count(" ") == 2:
        return Entity("driver", name)
    if name and kind in _PREFIXES and asker.fetch(_PREFIXES[kind], name, upto):
        return Entity(kind, name)
    step = _STEP.fullmatch(text)
    if step is not None:
        found = asker.fetch(
            "SELECT action, result IS NOT NULL AND ended_position <= ? FROM actions WHERE run = ? "
            "AND step = ? AND requested_position <= ? ORDER BY requested_position DESC LIMIT 1",
            *(upto, step[1], int(step[2]), upto),
        )
        if found:
            return Entity("result" if found[0][1] else "action", found[0][0])
    plate, well = well_of(text)
    if plate and asker.fetch(_PREFIXES["labware"], plate, upto):
        return Entity("well", f"{plate}/{well.upper()}")
    for bare, query in _PREFIXES.items():
        if asker.fetch(query, text, upto):
            return Entity(bare, text)
    raise NotFound(
        f"Nothing in this log has the name {text!r}.",
        remedy="Name labware (P7), a well (P7/B7), a run (R1), the result of a step (R1#3), a sample, a "
        "file's digest or a lot; lot:NAME and sample:NAME say which is meant.",
    )


def trace(
    asker: ReadConnection, subject: Entity, upto: int, direction: Direction, most: int = MOST_LINKS
) -> Graph:
    """The causes of an entity (up), or its effects (down), with the contents of a well. Only earlier events
    count as causes: an action on a plate after a reading is not a cause of the reading."""
    graph = Graph(subject, upto)
    up = direction == "up"
    links = CAUSES if up else EFFECTS
    seen = {subject: upto if up else 0}
    found: dict[ProvenanceLink, bool] = {}
    waiting = [(subject, seen[subject])]
    while waiting and graph.whole:
        entity, bound = waiting.pop(0)
        since, until = (0, bound) if up else (bound, upto)
        for relation, other, position, limit in find_links(asker, entity, links, since, until):
            cause, effect = (other, entity) if up else (entity, other)
            link = ProvenanceLink(effect, relation, cause, position)
            if position <= upto and link not in found:
                found[link] = True
                if len(found) >= most:
                    graph.whole = False
                    break
            known = seen.get(other)
            further = known is None or (limit > known if up else limit < known)
            if further and position <= upto:
                seen[other] = limit
                waiting.append((other, limit))
    graph.links = sorted(found, key=lambda link: (link.position, str(link.effect), str(link.cause)))
    if subject.kind == "well":
        graph.contents = trace_contents(asker, *well_of(subject.name), upto)
    entities = {entity: True for link in graph.links for entity in (link.effect, link.cause)}
    graph.entities = {str(entity): facts_of(asker, entity, upto) for entity in entities}
    graph.facts = graph.entities.get(str(subject)) or facts_of(asker, subject, upto)
    return graph
