"""The causes of a thing: user, action, time, spec, driver version, arguments and lots. Each function yields
the links from a thing to its causes among the first ``upto`` events, each with the position up to which the
cause itself counts: later changes of a plate did not influence an earlier reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec

from labos.audit._calibrations import IN_FORCE
from labos.audit.graph import Entity, EntityKind, ProvenanceLink, well_of
from labos.audit.liquids import find_source_well
from labos.audit.query import ReadConnection

Found = Iterator[tuple[ProvenanceLink, int]]
Rule = Callable[[ReadConnection, Entity, int], Found]

_APPROVED = (
    "SELECT answered_by, answered_position FROM approvals WHERE subject IN (?, ?, ?) "
    "AND answer = 'approved' AND subject <> '' AND answered_position <= ? ORDER BY answered_position"
)


_RELIED_ON = {
    column: "SELECT c.calibration, min(a.requested_position), c.position FROM actions a JOIN calibrations c "
    f"ON {IN_FORCE} WHERE a.{column} = ? AND a.requested_position <= ? "
    "GROUP BY c.calibration, c.position ORDER BY c.position"
    for column in ("action", "run")
}


def find_run_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for user, experiment, campaign, plan, position in asker.fetch(
        "SELECT user_id, experiment, campaign, plan, submitted_position FROM runs WHERE run = ?", entity.name
    ):
        yield ProvenanceLink(entity, "asked for by", Entity("user", user), position), position
        yield ProvenanceLink(entity, "follows", Entity("workflow", plan), position), position
        if experiment:
            yield ProvenanceLink(entity, "part of", Entity("experiment", experiment), position), position
        for who, at in asker.fetch(_APPROVED, entity.name, campaign, experiment, upto):
            yield ProvenanceLink(entity, "approved by", Entity("user", who), at), at
    yield from _find_calibrations(asker, "run", entity, upto)


def _find_calibrations(asker: ReadConnection, column: str, entity: Entity, upto: int) -> Found:
    for name, position, recorded in asker.fetch(_RELIED_ON[column], entity.name, upto):
        yield ProvenanceLink(entity, "relied on", Entity("calibration", name), position), recorded


def find_calibration_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for user, file, position in asker.fetch(
        "SELECT recorded_by, file, position FROM calibrations WHERE calibration = ?", entity.name
    ):
        yield ProvenanceLink(entity, "recorded by", Entity("user", user), position), position
        if file:
            yield ProvenanceLink(entity, "is told by", Entity("file", file), position), position


def find_experiment_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for user, position in asker.fetch(
        "SELECT user_id, started_position FROM experiments WHERE experiment = ?", entity.name
    ):
        yield ProvenanceLink(entity, "started by", Entity("user", user), position), position


def find_action_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for run, module, driver, version, labware, position, ended in asker.fetch(
        "SELECT run, module, driver, driver_version, labware, requested_position, ended_position "
        "FROM actions WHERE action = ?",
        entity.name,
    ):
        if run:
            yield ProvenanceLink(entity, "step of", Entity("run", run), position), position
        else:
            actor = asker.fetch("SELECT actor FROM events WHERE position = ?", position)[0][0]
            yield ProvenanceLink(entity, "asked for by", Entity("user", actor), position), position
        if driver:
            name = f"{module} {driver} {version}"
            yield ProvenanceLink(entity, "carried out by", Entity("driver", name), position), position
        yield from _find_calibrations(asker, "action", entity, position)
        for name in msgspec.json.decode(labware or "[]", type=list[str]):
            if asker.fetch(
                "SELECT 1 FROM labware WHERE labware = ? AND placed_position <= ?", name, position
            ):
                yield ProvenanceLink(entity, "worked on", Entity("labware", name), position), position - 1
        for digest, at in asker.fetch(
            "SELECT digest, position FROM files WHERE action = ? AND kind = 'given'", entity.name
        ):
            yield ProvenanceLink(entity, "was given", Entity("file", digest), at), position - 1
        for lot, at in asker.fetch(
            "SELECT DISTINCT lot, position FROM lot_uses "
            "WHERE action = ? AND kind <> 'labware' AND position <= ?",
            entity.name,
            ended or upto,
        ):
            yield ProvenanceLink(entity, "used", Entity("lot", lot), at), at


def find_result_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    ended = asker.fetch("SELECT ended_position, plate FROM actions WHERE action = ?", entity.name)
    for position, plate in ended:
        position = position or upto
        yield ProvenanceLink(entity, "measured by", Entity("action", entity.name), position), position
        wells = asker.fetch(
            "SELECT DISTINCT labware, well FROM results WHERE action = ? AND labware <> ''", entity.name
        )
        for labware, well in wells:
            yield ProvenanceLink(entity, "is of", Entity("well", f"{labware}/{well}"), position), position - 1
        if plate and not wells:
            yield ProvenanceLink(entity, "is of", Entity("labware", plate), position), position - 1


def find_labware_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for lot, position in asker.fetch(
        "SELECT lot, placed_position FROM labware WHERE labware = ? AND lot <> ''", entity.name
    ):
        yield ProvenanceLink(entity, "is of", Entity("lot", lot), position), position
    for action, position in asker.fetch(
        "SELECT e.action, t.position FROM labware_touches t JOIN events e ON e.position = t.position "
        "WHERE t.labware = ? AND t.position <= ? AND e.type = 'action.requested' ORDER BY t.position",
        entity.name,
        upto,
    ):
        yield ProvenanceLink(entity, "was in the hands of", Entity("action", action), position), position


def find_well_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    labware, well = well_of(entity.name)
    for kind, liquid, lots, action, position in asker.fetch(
        "SELECT kind, liquid, lots, action, position FROM transfers WHERE labware = ? AND well = ? "
        "AND position <= ? AND kind <> 'out' ORDER BY position, number",
        labware,
        well,
        upto,
    ):
        if kind == "sheet":
            yield ProvenanceLink(entity, "holds", Entity("sample", liquid), position), position
            continue
        if action:
            yield ProvenanceLink(entity, "was filled by", Entity("action", action), position), position
        source = find_source_well(labware, liquid)
        if source:
            yield ProvenanceLink(entity, "was filled from", Entity("well", source), position), position - 1
        for lot in msgspec.json.decode(lots or "[]", type=list[str]):
            yield ProvenanceLink(entity, "holds", Entity("lot", lot), position), position


def find_sample_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for user, sheet, position in asker.fetch(
        "SELECT DISTINCT actor, sheet, position FROM samples WHERE sample = ? AND position <= ?",
        entity.name,
        upto,
    ):
        yield ProvenanceLink(entity, "registered by", Entity("user", user), position), position
        yield ProvenanceLink(entity, "named in", Entity("file", sheet), position), position


def find_file_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for action, position in asker.fetch(
        "SELECT action, position FROM files WHERE digest = ? AND kind = 'returned' AND position <= ?",
        entity.name,
        upto,
    ):
        yield ProvenanceLink(entity, "was returned by", Entity("action", action), position), position


def find_lot_causes(asker: ReadConnection, entity: Entity, upto: int) -> Found:
    for user, position in asker.fetch(
        "SELECT e.actor, u.position FROM lot_uses u JOIN events e ON e.position = u.position "
        "WHERE u.lot = ? AND u.position <= ? AND u.kind IN ('counted', 'replenished', 'loaded') "
        "AND u.action = ''",
        entity.name,
        upto,
    ):
        yield ProvenanceLink(entity, "was put in by", Entity("user", user), position), position


CAUSES: dict[EntityKind, Rule] = {
    "run": find_run_causes,
    "experiment": find_experiment_causes,
    "action": find_action_causes,
    "result": find_result_causes,
    "labware": find_labware_causes,
    "well": find_well_causes,
    "sample": find_sample_causes,
    "file": find_file_causes,
    "calibration": find_calibration_causes,
    "lot": find_lot_causes,
}
