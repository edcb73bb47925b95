"""The differences between two positions of a log: places, runs, resources, questions, drivers."""

from __future__ import annotations

import msgspec

from labos.audit.query import ReadConnection

_PLACES = (
    "SELECT m.labware, m.kind, m.target, m.lies_on, m.maybe FROM labware_moves m JOIN "
    "(SELECT labware, max(position) AS last FROM labware_moves WHERE position <= ? GROUP BY labware) l "
    "ON l.last = m.position"
)
_LEVELS = (
    "SELECT c.module, c.resource, c.level FROM resource_changes c JOIN "
    "(SELECT module, resource, max(position) AS last FROM resource_changes WHERE position <= ? "
    "GROUP BY module, resource) l ON l.last = c.position"
)
_DRIVERS = (
    "SELECT n.module, n.driver, n.driver_version FROM nodes n JOIN "
    "(SELECT module, max(position) AS last FROM nodes WHERE position <= ? GROUP BY module) l "
    "ON l.last = n.position"
)
_RUNS = (
    "SELECT run, workflow, user_id, status, submitted_position, started_position, ended_position FROM runs "
    "WHERE submitted_position <= ? AND (ended_position IS NULL OR ended_position > ?) "
    "ORDER BY submitted_position"
)
_QUESTIONS = (
    "SELECT intervention, text, choice, resolved_by, asked_position, resolved_position FROM interventions "
    "WHERE asked_position <= ? AND (resolved_position IS NULL OR resolved_position > ?) "
    "ORDER BY asked_position"
)


class LabDifference(msgspec.Struct, frozen=True):
    """The value of ``what`` was ``before`` and is ``after``; empty for none. ``about`` is the part of the
    lab: labware, run, resource, question or driver."""

    about: str
    what: str
    before: str
    after: str


def list_differences(asker: ReadConnection, first: int, last: int) -> list[LabDifference]:
    """The differences between position ``first`` and position ``last``."""
    changes = _compare("labware", _find_places(asker, first), _find_places(asker, last))
    for run, workflow, user, status, *positions in asker.fetch(_RUNS, last, first):
        before, after = (_run_at(status, positions, at) for at in (first, last))
        changes += _compare(
            "run", {f"{run} ({workflow}, {user})": before}, {f"{run} ({workflow}, {user})": after}
        )
    changes += _compare("resource", _find_levels(asker, first), _find_levels(asker, last))
    for name, text, choice, by, asked, resolved in asker.fetch(_QUESTIONS, last, first):
        answered = resolved is not None and resolved <= last
        before = "open" if asked <= first else ""
        after = f"{choice}, by {by}" if answered else "open"
        changes += _compare("question", {f"{name}: {text}": before}, {f"{name}: {text}": after})
    return changes + _compare("driver", _find_drivers(asker, first), _find_drivers(asker, last))


def _compare(about: str, before: dict[str, str], after: dict[str, str]) -> list[LabDifference]:
    names = sorted({*before, *after}, key=_sort_key)
    pairs = [(name, before.get(name, ""), after.get(name, "")) for name in names]
    return [LabDifference(about, name, was, is_) for name, was, is_ in pairs if was != is_]


def _sort_key(name: str) -> tuple[str, int, str]:
    """A sort key that puts P9 before P10."""
    letters = name.rstrip("0123456789")
    digits = name[len(letters) :]
    return letters, int(digits) if digits else 0, name


def _find_places(asker: ReadConnection, position: int) -> dict[str, str]:
    found = {}
    for name, kind, target, lies_on, maybe in asker.fetch(_PLACES, position):
        if maybe is not None:
            places = msgspec.json.decode(maybe, type=list[str])
            found[name] = "not known: " + " or ".join(place or "gone" for place in places)
        elif kind != "removed":
            found[name] = f"on {lies_on}" if lies_on else target
    return found


def _find_levels(asker: ReadConnection, position: int) -> dict[str, str]:
    rows = asker.fetch(_LEVELS, position)
    return {f"{module}:{name}": "" if level is None else f"{level:.10g}" for module, name, level in rows}


def _find_drivers(asker: ReadConnection, position: int) -> dict[str, str]:
    return {module: f"{driver} {version}" for module, driver, version in asker.fetch(_DRIVERS, position)}


def _run_at(status: str, positions: list[int | None], at: int) -> str:
    submitted, started, ended = positions
    if submitted is None or submitted > at:
        return ""
    if ended is not None and ended <= at:
        return status
    return "active" if started is not None and started <= at else "queued"
