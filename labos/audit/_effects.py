"""The effects of a thing: the same links in the other direction. Each function yields the links from effects
to a thing among the events from ``since`` to ``upto``, each with the position from which the effect itself
counts. A recall must not miss anything: a resource that an action has used up concerns all labware that it
processed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec

from labos.audit._calibrations import IN_FORCE
from labos.audit.graph import Entity, EntityKind, ProvenanceLink, well_of
from labos.audit.query import ReadConnection

Found = Iterator[tuple[ProvenanceLink, int]]
Rule = Callable[[ReadConnection, Entity, int, int], Found]


_POURED = "SELECT 1 FROM lot_uses WHERE action = ? AND lot = ? AND kind = 'liquid'"
"""An SQL condition: an action put a lot into wells, so that the wells are known."""


def find_lot_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    for kind, labware, action, position in asker.fetch(
        "SELECT kind, labware, action, position FROM lot_uses WHERE lot = ? AND position BETWEEN ? AND ? "
        "ORDER BY position, number",
        *(entity.name, since, upto),
    ):
        if kind == "labware":
            yield ProvenanceLink(Entity("labware", labware), "is of", entity, position), position
        elif kind == "liquid":
            for (well,) in asker.fetch(
                "SELECT DISTINCT well FROM transfers WHERE position = ? AND kind = 'in'", position
            ):
                yield ProvenanceLink(Entity("well", f"{labware}/{well}"), "holds", entity, position), position
        elif kind == "consumed" and action and not asker.fetch(_POURED, action, entity.name):
            yield ProvenanceLink(Entity("action", action), "used", entity, position), position


def find_well_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    labware, well = well_of(entity.name)
    for action, position in asker.fetch(
        "SELECT DISTINCT action, position FROM results WHERE labware = ? AND well = ? "
        "AND position BETWEEN ? AND ?",
        *(labware, well, since, upto),
    ):
        yield ProvenanceLink(Entity("result", action), "is of", entity, position), position
    for action, position in asker.fetch(
        # Results without wells, such as an image, are results of the whole plate.
        "SELECT a.action, a.ended_position FROM labware_touches t JOIN events e ON e.position = t.position "
        "JOIN actions a ON a.action = e.action WHERE t.labware = ? AND t.position BETWEEN ? AND ? "
        "AND e.type IN ('action.succeeded', 'action.reconciled') AND a.plate = t.labware "
        "AND a.result IS NOT NULL "
        "AND NOT EXISTS (SELECT 1 FROM results r WHERE r.action = a.action) ORDER BY a.ended_position",
        *(labware, since, upto),
    ):
        yield ProvenanceLink(Entity("result", action), "is of", entity, position), position
    for into, target, position in asker.fetch(
        "SELECT labware, well, position FROM transfers WHERE kind = 'in' AND position BETWEEN ? AND ? "
        "AND ((labware = ? AND liquid = ?) OR liquid = ?) ORDER BY position, number",
        *(since, upto, labware, well, entity.name),
    ):
        yield (
            ProvenanceLink(Entity("well", f"{into}/{target}"), "was filled from", entity, position),
            position,
        )


def find_labware_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    for action, position in asker.fetch(
        "SELECT e.action, t.position FROM labware_touches t JOIN events e ON e.position = t.position "
        "WHERE t.labware = ? AND t.position BETWEEN ? AND ? AND e.type = 'action.requested' "
        "ORDER BY t.position",
        *(entity.name, since, upto),
    ):
        yield ProvenanceLink(Entity("action", action), "worked on", entity, position), position


def find_action_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    for labware, returned, requested, ended in asker.fetch(
        "SELECT labware, result IS NOT NULL, requested_position, ended_position "
        "FROM actions WHERE action = ?",
        entity.name,
    ):
        for name in msgspec.json.decode(labware or "[]", type=list[str]):
            yield ProvenanceLink(Entity("labware", name), "was in the hands of", entity, requested), requested
        if returned and ended is not None and ended <= upto:
            yield ProvenanceLink(Entity("result", entity.name), "measured by", entity, ended), ended
    for digest, position in asker.fetch(
        "SELECT digest, position FROM files WHERE action = ? AND kind = 'returned' AND position <= ?",
        *(entity.name, upto),
    ):
        yield ProvenanceLink(Entity("file", digest), "was returned by", entity, position), position
    for labware, well, position in asker.fetch(
        "SELECT DISTINCT labware, well, position FROM transfers WHERE action = ? AND kind = 'in' "
        "AND position <= ? ORDER BY position, well",
        *(entity.name, upto),
    ):
        yield ProvenanceLink(Entity("well", f"{labware}/{well}"), "was filled by", entity, position), position


def _find_rows(kind: EntityKind, relation: str, table: str, position: str, column: str) -> Rule:
    """The rows of a table that name the thing in a column, each as a thing of its own kind."""
    query = (
        f"SELECT {kind}, {position} FROM {table} WHERE {column} = ? AND {position} <= ? ORDER BY {position}"
    )

    def links(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
        for name, at in asker.fetch(query, entity.name, upto):
            yield ProvenanceLink(Entity(kind, name), relation, entity, at), at

    return links


def find_driver_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    module, driver, version = entity.name.split(" ", 2)
    for action, position in asker.fetch(
        "SELECT action, requested_position FROM actions WHERE module = ? AND driver = ? "
        "AND driver_version = ? AND requested_position <= ? ORDER BY requested_position",
        *(module, driver, version, upto),
    ):
        yield ProvenanceLink(Entity("action", action), "carried out by", entity, position), position


def find_calibration_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    for action, position in asker.fetch(
        f"SELECT a.action, a.requested_position FROM calibrations c JOIN actions a ON {IN_FORCE} "
        "WHERE c.calibration = ? AND a.requested_position <= ? ORDER BY a.requested_position",
        *(entity.name, upto),
    ):
        yield ProvenanceLink(Entity("action", action), "relied on", entity, position), position


def find_sample_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    for labware, well, position in asker.fetch(
        "SELECT labware, well, position FROM samples WHERE sample = ? AND position <= ? "
        "ORDER BY position, well",
        *(entity.name, upto),
    ):
        yield ProvenanceLink(Entity("well", f"{labware}/{well}"), "holds", entity, position), position


def find_file_effects(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    for action, position in asker.fetch(
        "SELECT action, position FROM files WHERE digest = ? AND kind = 'given' AND position BETWEEN ? AND ?",
        *(entity.name, since, upto),
    ):
        yield ProvenanceLink(Entity("action", action), "was given", entity, position), position


EFFECTS: dict[EntityKind, Rule] = {
    "lot": find_lot_effects,
    "well": find_well_effects,
    "labware": find_labware_effects,
    "action": find_action_effects,
    "run": _find_rows("action", "step of", "actions", "requested_position", "run"),
    "experiment": _find_rows("run", "part of", "runs", "submitted_position", "experiment"),
    "user": _find_rows("run", "asked for by", "runs", "submitted_position", "user_id"),
    "workflow": _find_rows("run", "follows", "runs", "submitted_position", "plan"),
    "driver": find_driver_effects,
    "calibration": find_calibration_effects,
    "sample": find_sample_effects,
    "file": find_file_effects,
}
