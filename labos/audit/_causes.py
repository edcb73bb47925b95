"""The causes of a thing: user, action, time, spec, driver version, arguments and lots, among the events up to
a position. The position up to which a cause itself counts is often an earlier one: later changes of a plate
did not influence an earlier reading.
"""

from __future__ import annotations

from labos.audit._links import IN_FORCE, Found, Links, query
from labos.audit.graph import Entity, well_of
from labos.audit.liquids import find_source_well
from labos.audit.query import ReadConnection

_RELIED_ON = (
    "SELECT c.calibration, min(a.requested_position), c.position FROM actions a JOIN calibrations c "
    f"ON {IN_FORCE} WHERE a.{{}} = :name AND a.requested_position <= :upto "
    "GROUP BY c.calibration, c.position ORDER BY c.position"
)
_OF_WELL = "FROM transfers WHERE labware = :labware AND well = :well AND position <= :upto"

_find_labware_of_action = query(
    "SELECT labware, requested_position, requested_position - 1 FROM actions WHERE action = :name",
    is_list=True,
)


def _find_worked_on(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    """The labware of an action, without pieces that got their ids only during it."""
    for name, position, limit in _find_labware_of_action(asker, entity, since, upto):
        if asker.fetch("SELECT 1 FROM labware WHERE labware = ? AND placed_position <= ?", name, position):
            yield name, position, limit


def _find_source_wells(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
    """The wells whose names are those of the liquids in a well."""
    find_liquids = query(f"SELECT liquid, position, position - 1 {_OF_WELL} AND kind = 'in'")
    for liquid, position, limit in find_liquids(asker, entity, since, upto):
        if source := find_source_well(well_of(entity.name)[0], liquid):
            yield source, position, limit


CAUSES: Links = {
    "run": {
        "asked for by user": "SELECT user_id, submitted_position FROM runs WHERE run = :name",
        "follows workflow": "SELECT plan, submitted_position FROM runs WHERE run = :name",
        "part of experiment": "SELECT experiment, submitted_position FROM runs "
        "WHERE run = :name AND experiment <> ''",
        "approved by user": "SELECT a.answered_by, a.answered_position FROM runs r JOIN approvals a "
        "ON a.subject IN (r.run, r.campaign, r.experiment) AND a.subject <> '' "
        "WHERE r.run = :name AND a.answer = 'approved' AND a.answered_position <= :upto",
        "relied on calibration": _RELIED_ON.format("run"),
    },
    "experiment": {
        "started by user": "SELECT user_id, started_position FROM experiments WHERE experiment = :name",
    },
    "action": {
        "step of run": "SELECT run, requested_position FROM actions WHERE action = :name AND run <> ''",
        "asked for by user": "SELECT e.actor, e.position FROM actions a JOIN events e "
        "ON e.position = a.requested_position WHERE a.action = :name AND a.run = ''",
        "carried out by driver": "SELECT module || ' ' || driver || ' ' || driver_version, "
        "requested_position FROM actions WHERE action = :name AND driver <> ''",
        "relied on calibration": _RELIED_ON.format("action"),
        "worked on labware": _find_worked_on,
        "was given file": "SELECT digest, position, position - 1 FROM files "
        "WHERE action = :name AND kind = 'given'",
        "used lot": "SELECT DISTINCT u.lot, u.position FROM lot_uses u JOIN actions a "
        "ON a.action = u.action WHERE u.action = :name AND u.kind <> 'labware' "
        "AND u.position <= coalesce(a.ended_position, :upto)",
    },
    "result": {
        "measured by action": "SELECT action, coalesce(ended_position, :upto) FROM actions "
        "WHERE action = :name",
        "is of well": "SELECT DISTINCT r.labware || '/' || r.well, a.ended_position, a.ended_position - 1 "
        "FROM results r JOIN actions a ON a.action = r.action WHERE r.action = :name AND r.labware <> ''",
        "is of labware": "SELECT plate, coalesce(ended_position, :upto), coalesce(ended_position, :upto) - 1 "
        "FROM actions WHERE action = :name AND plate <> '' "
        "AND NOT EXISTS (SELECT 1 FROM results WHERE action = :name AND labware <> '')",
    },
    "labware": {
        "is of lot": "SELECT lot, placed_position FROM labware WHERE labware = :name AND lot <> ''",
        "was in the hands of action": "SELECT e.action, t.position FROM labware_touches t JOIN events e "
        "ON e.position = t.position WHERE t.labware = :name AND t.position <= :upto "
        "AND e.type = 'action.requested' ORDER BY t.position",
    },
    "well": {
        "holds sample": f"SELECT liquid, position {_OF_WELL} AND kind = 'sheet'",
        "was filled by action": f"SELECT action, position {_OF_WELL} AND kind = 'in' AND action <> ''",
        "was filled from well": _find_source_wells,
        "holds lot": query(f"SELECT lots, position {_OF_WELL} AND kind = 'in'", is_list=True),
    },
    "sample": {
        "registered by user": "SELECT DISTINCT actor, position FROM samples "
        "WHERE sample = :name AND position <= :upto",
        "named in file": "SELECT DISTINCT sheet, position FROM samples "
        "WHERE sample = :name AND position <= :upto",
    },
    "file": {
        "was returned by action": "SELECT action, position FROM files "
        "WHERE digest = :name AND kind = 'returned' AND position <= :upto",
    },
    "calibration": {
        "recorded by user": "SELECT recorded_by, position FROM calibrations WHERE calibration = :name",
        "is described by file": "SELECT file, position FROM calibrations "
        "WHERE calibration = :name AND file <> ''",
    },
    "lot": {
        "was put in by user": "SELECT e.actor, u.position FROM lot_uses u JOIN events e "
        "ON e.position = u.position WHERE u.lot = :name AND u.position <= :upto AND u.action = '' "
        "AND u.kind IN ('counted', 'replenished', 'loaded')",
    },
}
