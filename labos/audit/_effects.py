"""The effects of a thing among the events from one position to another: the same links in the other
direction. A recall must not miss anything: a resource that an action has used up concerns all labware that it
processed.
"""

from __future__ import annotations

from labos.audit._links import IN_FORCE, Links, query

EFFECTS: Links = {
    "lot": {
        "is of labware": "SELECT labware, position FROM lot_uses "
        "WHERE lot = :name AND position BETWEEN :since AND :upto AND kind = 'labware'",
        "holds well": "SELECT DISTINCT u.labware || '/' || t.well, u.position FROM lot_uses u "
        "JOIN transfers t ON t.position = u.position AND t.kind = 'in' "
        "WHERE u.lot = :name AND u.position BETWEEN :since AND :upto AND u.kind = 'liquid'",
        # If the action put the lot into wells, the wells are known.
        "used action": "SELECT action, position FROM lot_uses u "
        "WHERE lot = :name AND position BETWEEN :since AND :upto AND kind = 'consumed' AND action <> '' "
        "AND NOT EXISTS (SELECT 1 FROM lot_uses p WHERE p.action = u.action AND p.lot = u.lot "
        "AND p.kind = 'liquid')",
    },
    "well": {
        "is of result": "SELECT DISTINCT action, position FROM results "
        "WHERE labware = :labware AND well = :well AND position BETWEEN :since AND :upto "
        # Results without wells, such as an image, are results of the whole plate.
        "UNION SELECT a.action, a.ended_position FROM labware_touches t "
        "JOIN events e ON e.position = t.position JOIN actions a ON a.action = e.action "
        "WHERE t.labware = :labware AND t.position BETWEEN :since AND :upto "
        "AND e.type IN ('action.succeeded', 'action.reconciled') AND a.plate = t.labware "
        "AND a.result IS NOT NULL AND NOT EXISTS (SELECT 1 FROM results r WHERE r.action = a.action) "
        "ORDER BY 2",
        "was filled from well": "SELECT labware || '/' || well, position FROM transfers "
        "WHERE kind = 'in' AND position BETWEEN :since AND :upto "
        "AND ((labware = :labware AND liquid = :well) OR liquid = :name) ORDER BY position, number",
    },
    "labware": {
        "worked on action": "SELECT e.action, t.position FROM labware_touches t JOIN events e "
        "ON e.position = t.position WHERE t.labware = :name AND t.position BETWEEN :since AND :upto "
        "AND e.type = 'action.requested' ORDER BY t.position",
    },
    "action": {
        "was in the hands of labware": query(
            "SELECT labware, requested_position FROM actions WHERE action = :name", is_list=True
        ),
        "measured by result": "SELECT action, ended_position FROM actions "
        "WHERE action = :name AND result IS NOT NULL AND ended_position <= :upto",
        "was returned by file": "SELECT digest, position FROM files "
        "WHERE action = :name AND kind = 'returned' AND position <= :upto",
        "was filled by well": "SELECT DISTINCT labware || '/' || well, position FROM transfers "
        "WHERE action = :name AND kind = 'in' AND position <= :upto ORDER BY 2, 1",
    },
    "run": {
        "step of action": "SELECT action, requested_position FROM actions "
        "WHERE run = :name AND requested_position <= :upto ORDER BY 2",
    },
    "experiment": {
        "part of run": "SELECT run, submitted_position FROM runs "
        "WHERE experiment = :name AND submitted_position <= :upto ORDER BY 2",
    },
    "user": {
        "asked for by run": "SELECT run, submitted_position FROM runs "
        "WHERE user_id = :name AND submitted_position <= :upto ORDER BY 2",
    },
    "workflow": {
        "follows run": "SELECT run, submitted_position FROM runs "
        "WHERE plan = :name AND submitted_position <= :upto ORDER BY 2",
    },
    "driver": {
        "carried out by action": "SELECT action, requested_position FROM actions WHERE module = :module "
        "AND driver = :driver AND driver_version = :version AND requested_position <= :upto ORDER BY 2",
    },
    "calibration": {
        "relied on action": "SELECT a.action, a.requested_position FROM calibrations c "
        f"JOIN actions a ON {IN_FORCE} WHERE c.calibration = :name AND a.requested_position <= :upto "
        "ORDER BY 2",
    },
    "sample": {
        "holds well": "SELECT labware || '/' || well, position FROM samples "
        "WHERE sample = :name AND position <= :upto ORDER BY position, well",
    },
    "file": {
        "was given action": "SELECT action, position FROM files "
        "WHERE digest = :name AND kind = 'given' AND position BETWEEN :since AND :upto",
    },
}
