"""Changes a workcell while the lab runs: lists the differences and the obstacles, then applies all changes or
none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from labos.core.decide.lab import list_obstacles
from labos.core.ids import local
from labos.core.model import LabwareSpec, ModuleSpec, StationSpec, Workcell
from labos.errors import BadInput, Refused
from labos.http.bodies import WorkcellFile
from labos.http.service import LabService
from labos.settings import NODE_SETTINGS_FILE
from labos.spec import Finding, parse_workcell
from labos.spec.onsite import list_on_site
from labos.spec.tables import find_table


class Difference(msgspec.Struct, frozen=True):
    """Local names; ``poses`` as ``module: station``, with the labware type in brackets if the pose is for
    that type."""

    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()


OF_STEPS = ("on_error", "retry", "timeout_s")
"""The fields of a module that concern its steps."""


class WorkcellChange(msgspec.Struct, frozen=True):
    """The changes by a workcell file. ``blockers`` are the obstacles, with remedies. ``details`` are the
    changed fields of each module, by its local name; the fields that its steps use are shown with their
    values. ``findings`` are the warnings about its files."""

    workcell: str
    applied: bool
    modules: Difference
    stations: Difference
    poses: Difference
    labware: Difference
    blockers: tuple[str, ...] = ()
    details: dict[str, tuple[str, ...]] = {}
    findings: tuple[Finding, ...] = ()
    transfers: Difference = Difference()


async def apply_workcell(service: LabService, file: WorkcellFile, by: str) -> WorkcellChange:
    """Apply a workcell file to the running lab, or only report its effects. Raises SpecErrors, Refused."""
    service.expect_role(by, "admin")
    descriptions = service.parts.descriptions
    sent = {**file.labware, **file.files}
    size = len(file.text) + sum(map(len, sent.values()))
    compiled = await service.run_beside(size, parse_workcell, file.text, descriptions, file.name, sent)
    new = compiled.workcell
    _refuse_on_site(service, new)
    obstacles = list_obstacles(service.kernel.state, new)
    blockers = tuple(f"{found.message} {found.remedy}".strip() for found in obstacles)
    before = service.read_workcell(new.name)
    had, has = _sort_by_name(before.modules), _sort_by_name(new.modules)
    found = WorkcellChange(
        new.name,
        False,
        _make_difference(had, has),
        _make_difference(_sort_by_name(before.stations), _sort_by_name(new.stations)),
        _make_difference(_list_poses(before), _list_poses(new)),
        _make_difference(_sort_by_name(before.labware), _sort_by_name(new.labware)),
        blockers,
        _describe_changes(had, has),
        compiled.findings,
        _make_difference(_list_ways(before), _list_ways(new)),
    )
    if file.dry_run:
        return found
    if blockers:
        raise Refused(f"{new.name} cannot be changed: {blockers[0]}", remedy=" ".join(blockers[1:]))
    await service.apply(compiled, by, declare=service.parts.simulated)
    other_nodes = [
        module.name
        for name, module in had.items()
        if (spec := has.get(name)) is not None
        and (spec.driver, spec.config, spec.regrip) != (module.driver, module.config, module.regrip)
    ]
    service.parts.follow_workcells(other_nodes)
    return msgspec.structs.replace(found, applied=True)


def _refuse_on_site(service: LabService, new: Workcell) -> None:
    """Raises BadInput for a module that names files, programs or secrets of its node's computer, unless the
    lab already has the same module."""
    known, tables = service.kernel.state.modules.by_name, service.parts.descriptions
    for spec in new.modules:
        table = find_table(spec.driver, tables)
        keys = frozenset({table.key} if table is not None else ())
        named = list_on_site(spec.config.get("config", {}), keys)
        before = known.get(spec.name)
        if named and (before is None or _list_connection(before.spec) != _list_connection(spec)):
            raise BadInput(
                f"The module {local(spec.name)} has {' and '.join(named)}: a file, program or secret "
                "of its node's computer, which cannot be set over HTTP.",
                remedy=f"Set it in {NODE_SETTINGS_FILE} of the home folder on that computer, or start the "
                "lab with this file: labos up FILE",
            )


def _list_connection(spec: ModuleSpec) -> tuple[Any, ...]:
    """The fields that determine how a module's device is reached."""
    return (spec.driver, *map(spec.config.get, ("interface", "config", "about", "extends")))


def _sort_by_name(
    specs: Sequence[ModuleSpec] | Sequence[StationSpec] | Sequence[LabwareSpec],
) -> dict[str, Any]:
    return {local(spec.name): spec for spec in specs}


def _list_ways(cell: Workcell) -> dict[str, Any]:
    """The paths of transfers, by manipulator and pair of stations."""
    found: dict[str, Any] = {}
    for way in cell.transfers:
        name = f"{local(way.module)}.{way.action}"
        for word, stations in (("from", way.from_stations), ("to", way.to_stations)):
            name += f" {word} {', '.join(map(local, stations))}" if stations else ""
        found[name if name not in found else f"{name} #{len(found) + 1}"] = way
    return found


def _describe_changes(
    before: Mapping[str, ModuleSpec], after: Mapping[str, ModuleSpec]
) -> dict[str, tuple[str, ...]]:
    """The changes of modules that exist before and after. Settings of a driver may be secret: only their
    names are listed."""
    found = {}
    for name in sorted(before.keys() & after.keys()):
        was, is_ = msgspec.to_builtins(before[name]), msgspec.to_builtins(after[name])
        changed = tuple(
            f"{field}: {_show_value(was[field])} → {_show_value(is_[field])}" if field in OF_STEPS else field
            for field in is_
            if is_[field] != was[field]
        )
        if changed:
            found[name] = changed
    return found


def _show_value(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_show_value(part)}" for key, part in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value in ("", None) else str(value)


def _list_poses(cell: Workcell) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for module in cell.modules:
        name = local(module.name)
        for station, pose in module.config.get("poses", {}).items():
            found[f"{name}: {station}"] = pose
        for kind, poses in module.config.get("poses_of", {}).items():
            found |= {f"{name}: {station} ({kind})": pose for station, pose in poses.items()}
    return found


def _make_difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> Difference:
    return Difference(
        tuple(sorted(after.keys() - before.keys())),
        tuple(sorted(before.keys() - after.keys())),
        tuple(
            sorted(
                name
                for name in after.keys() & before.keys()
                if msgspec.to_builtins(after[name]) != msgspec.to_builtins(before[name])
            )
        ),
    )
