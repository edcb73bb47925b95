"""Where manipulators find stations: what they were taught, and being taught."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.decide.teach import TeachLocation
from labos.core.ids import local
from labos.core.model import LABWARE_TYPE
from labos.core.modules import Module
from labos.errors import BadInput
from labos.http.bodies import Taught
from labos.http.service import LabService


async def teach(service: LabService, name: str, told: Taught, by: str) -> int:
    """A new pose of a module; returns its version. Raises NotFound, BadInput, Refused."""
    module, station, kind = service.module(name), service.station(told.station), told.labware_type
    if kind:
        service.expect_labware(kind)
        _expect_types(service, service.kernel.state.modules.by_name[module])
    command = TeachLocation(module, station, tuple(told.pose), by, told.why, kind)
    if await service.kernel.execute(command, by):
        service.parts.follow_workcells([module])  # its node learns poses when it starts
    taught = service.kernel.state.modules.by_name[module].taught_for(station, kind)
    assert taught is not None
    return taught.version


def _expect_types(service: LabService, module: Module) -> None:
    """Raises BadInput for a module that does not hear what it carries."""
    driver = service.parts.descriptions.get(module.spec.driver)
    args = {arg.name for action in driver.actions for arg in action.args} if driver is not None else set()
    if LABWARE_TYPE not in args or "interface" in module.spec.config:
        raise BadInput(
            f"{local(module.spec.name)} has one pose for all labware at a station.",
            remedy="Teach it without a labware type: its driver, or foreign node, takes none.",
        )


def locations(module: Module) -> dict[str, dict[str, Any]]:
    """The poses of a module as they are now, by station; version 0 is the workcell file's. Where labware
    types have poses of their own, these stand below ``types``."""
    written = module.spec.config
    found: dict[str, dict[str, Any]] = {
        name: _as_written(pose) for name, pose in written.get("poses", {}).items()
    }
    for station, taught in module.taught.items():
        found[local(station)] = msgspec.to_builtins(taught)
    for kind, poses in written.get("poses_of", {}).items():
        for name, pose in poses.items():
            found[name].setdefault("types", {})[kind] = _as_written(pose)
    for station, kinds in module.taught_of.items():
        for kind, taught in kinds.items():
            # The workcell file may have lost the station's own pose since.
            own = found.setdefault(local(station), {"pose": [], "version": 0, "proven": False})
            own.setdefault("types", {})[kind] = msgspec.to_builtins(taught)
    return found


def _as_written(pose: list[float]) -> dict[str, Any]:
    return {"pose": pose, "version": 0, "proven": True}
