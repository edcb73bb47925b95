"""The poses at which manipulators reach stations: lists and teaches them."""

from __future__ import annotations

import msgspec

from labos.core.decide.teach import TeachLocation
from labos.core.ids import local
from labos.core.model import LABWARE_TYPE
from labos.core.modules import Module
from labos.core.structs import make_from
from labos.errors import BadInput
from labos.http.bodies import NewPose
from labos.http.service import LabService


async def teach(service: LabService, name: str, new: NewPose, by: str) -> int:
    """Record a new pose of a module; returns its version. Raises NotFound, BadInput, Refused."""
    module, station, kind = service.module(name), service.station(new.station), new.labware_type
    if kind:
        service.expect_labware(kind)
        _expect_types(service, service.kernel.state.modules.by_name[module])
    command = TeachLocation(module, station, tuple(new.pose), by, new.why, kind)
    if await service.kernel.execute(command, by):
        service.parts.follow_workcells([module])  # its node reads the poses when it starts
    taught = service.kernel.state.modules.by_name[module].find_taught(station, kind)
    assert taught is not None
    return taught.version


def _expect_types(service: LabService, module: Module) -> None:
    """Raises BadInput for a module that is not informed about the labware type it carries."""
    driver = service.parts.descriptions.get(module.spec.driver)
    args = {arg.name for action in driver.actions for arg in action.args} if driver is not None else set()
    if LABWARE_TYPE not in args or "interface" in module.spec.config:
        raise BadInput(
            f"{local(module.spec.name)} has one pose for all labware at a station.",
            remedy="Teach it without a labware type: its driver, or foreign node, does not support labware "
            "types.",
        )


class TaughtPose(msgspec.Struct):
    """A pose; version 0 is the workcell file's. ``proven``: a move with it has succeeded since."""

    pose: tuple[float, ...] = ()
    version: int = 0
    proven: bool = False


class LocationPose(TaughtPose):
    """The pose for a station. ``types`` are poses for labware types, where they differ."""

    types: dict[str, TaughtPose] = {}


def make_locations(module: Module) -> dict[str, LocationPose]:
    """The present poses of a module, by station."""
    written = module.spec.config
    found = {name: LocationPose(tuple(pose), 0, True) for name, pose in written.get("poses", {}).items()}
    for station, lessons in module.taught.items():
        if "" in lessons:
            found[local(station)] = make_from(LocationPose, lessons[""])
    for kind, poses in written.get("poses_of", {}).items():
        for name, pose in poses.items():
            found[name].types[kind] = TaughtPose(tuple(pose), 0, True)
    for station, lessons in module.taught.items():
        # The workcell file may no longer have a pose for the station itself.
        own = found.setdefault(local(station), LocationPose())
        own.types |= {kind: make_from(TaughtPose, taught) for kind, taught in lessons.items() if kind}
    return found
