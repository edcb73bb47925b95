"""The facts of an entity that are shown wherever it is named: user, time, arguments and versions."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.audit._links import IN_FORCE
from labos.audit.graph import Entity, well_of
from labos.audit.query import ReadConnection
from labos.core.ids import local

_COLUMNS = {
    "action": "run step key module name args driver driver_version about simulated requested_at ended_at "
    "status effects error result requested_position ended_position",
    "run": "workflow workcell user_id experiment status plan pins payload submitted_at ended_at "
    "submitted_position ended_position",
    "labware": "type lot barcode placed_at placed_position",
    "experiment": "name user_id status started_at ended_at started_position ended_position",
    "calibration": "module what certificate recorded_by at until file",
}
"""The facts of a thing: columns of the view of its kind."""
_VIEWS = {"labware": "labware"}
_FILE_NAMES = ("file", "bytes", "kind")
_FILE = (
    f"SELECT {', '.join(_FILE_NAMES)} FROM files WHERE digest = ? AND position <= ? ORDER BY position LIMIT 1"
)
_RELIED_ON = {
    column: "SELECT DISTINCT c.calibration, c.position FROM actions a JOIN calibrations c "
    f"ON {IN_FORCE} WHERE a.{column} = ? AND a.requested_position <= ? ORDER BY c.position"
    for column in ("action", "run")
}

_JSON = ("args", "result", "pins", "payload")
_OF_THE_END = ("ended_at", "ended_position", "effects", "error", "result")
"""Facts that are known only at the end."""


def facts_of(asker: ReadConnection, entity: Entity, upto: int) -> dict[str, Any]:
    """The facts of an entity at a position, without empty ones, except the ``calibrations`` of a run or an
    action."""
    match entity.kind:
        case "action" | "result" | "run":
            kind = "run" if entity.kind == "run" else "action"
            facts = _read_facts(asker, kind, entity.name)
            relied_on = asker.fetch(_RELIED_ON[kind], entity.name, upto)
            facts["calibrations"] = [str(name) for name, _ in relied_on]
        case "labware" | "experiment" | "calibration":
            facts = _read_facts(asker, entity.kind, entity.name)
        case "file":
            facts = _make_facts(_FILE_NAMES, asker.fetch(_FILE, entity.name, upto))
        case "driver":
            facts = dict(zip(("module", "driver", "driver_version"), entity.name.split(" ", 2), strict=True))
        case "well":
            plate, well = well_of(entity.name)
            facts = {"labware": plate, "well": well}
        case _:
            facts = {}
    return _as_of(facts, upto)


def describe_entity(entity: Entity, facts: dict[str, Any]) -> str:
    """A short description of an entity."""
    match entity.kind:
        case "action" | "result":
            where = f"{facts.get('run', '')} #{facts.get('step')}" if facts.get("run") else entity.name
            key = f" {facts['key']!r}" if facts.get("key") else ""
            act = f"{local(str(facts.get('module', '')))}.{facts.get('name', '')}"
            return f"result of {where}{key}" if entity.kind == "result" else f"{act} ({where}{key})"
        case "run" if facts.get("workflow"):
            return f"run {entity.name} ({facts['workflow']})"
        case "labware" if facts.get("type"):
            return f"{facts['type']} {entity.name}"
        case "file":
            return f"file {facts.get('file', '')} {entity.name[:12]}…".replace("  ", " ")
        case "workflow":
            return f"workflow {entity.name[:12]}…"
        case "well":
            return f"well {entity.name}"
        case "driver":
            module, driver, version = entity.name.split(" ", 2)
            return f"driver {driver} {version} ({local(module)})"
        case "calibration" if facts.get("module"):
            of = f"{facts.get('what', '')} of {local(str(facts['module']))}".removeprefix(" of ")
            certificate = f", certificate {facts['certificate']}" if facts.get("certificate") else ""
            until = f", valid until {facts['until']}" if facts.get("until") else ""
            return f"calibration {entity.name.rpartition('@')[2]} ({of}{certificate}{until})"
    return str(entity)


def _read_facts(asker: ReadConnection, kind: str, name: str) -> dict[str, Any]:
    names = tuple(_COLUMNS[kind].split())
    query = f"SELECT {', '.join(names)} FROM {_VIEWS.get(kind, f'{kind}s')} WHERE {kind} = ?"
    return _make_facts(names, asker.fetch(query, name))


def _make_facts(names: tuple[str, ...], rows: list[Any]) -> dict[str, Any]:
    if not rows:
        return {}
    facts = dict(zip(names, rows[0], strict=True))
    for name in _JSON:
        if isinstance(facts.get(name), str):
            facts[name] = msgspec.json.decode(facts[name])
    return {name: value for name, value in facts.items() if value not in (None, "", {}, [])}


def _as_of(facts: dict[str, Any], upto: int) -> dict[str, Any]:
    """Remove the facts that the log did not have yet."""
    ended = facts.get("ended_position")
    if ended is None or ended <= upto:
        return facts
    left = {name: value for name, value in facts.items() if name not in _OF_THE_END}
    return {**left, "status": "not ended"}
