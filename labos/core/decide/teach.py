"""Teaching a manipulator the pose for a station."""

from __future__ import annotations

import math

from labos.core.decide._base import Command, Decision, Rejection, refuse_hotel
from labos.core.decide.lookups import decides_about, expect_module
from labos.core.ids import ModuleName, StationName, local
from labos.core.modules import LocationTaught, Module
from labos.core.state import LabState
from labos.core.words import Words


class TeachLocation(Command, frozen=True):
    """Record the pose with which a manipulator reaches a station. With a ``labware_type``, it is valid only
    for labware of that type."""

    module: ModuleName
    station: StationName
    pose: tuple[float, ...]
    by: str
    why: Words = ""
    labware_type: str = ""


@decides_about(TeachLocation, expect_module)
def teach_location(state: LabState, command: TeachLocation, module: Module) -> Decision:
    if command.station not in state.bench.stations:
        return Rejection("no_station", f"There is no station {local(command.station)}.")
    shelved = refuse_hotel(state, command.station)
    if shelved:
        return shelved
    if module.in_flight:
        return Rejection(
            "module_in_use",
            f"{local(command.module)} is at work: its poses cannot be changed now.",
            "Wait until its action has ended.",
        )
    kind, where = command.labware_type, local(command.station)
    general = module.find_pose(command.station)
    if kind and general is None:
        return Rejection(
            "no_pose",
            f"{local(command.module)} has no pose for {where} yet, so {kind} cannot have a different one.",
            "Teach the station first, without a labware type.",
        )
    last = module.find_pose(command.station, kind) if kind else general
    last = general if last is None else last
    if not command.pose or not all(map(math.isfinite, command.pose)):
        return Rejection("bad_pose", "A pose consists of finite numbers, at least one.")
    if last is not None and len(last) != len(command.pose):
        return Rejection(
            "bad_pose",
            f"A pose of {local(command.module)} has {len(last)} numbers there, not {len(command.pose)}.",
        )
    known = module.find_taught(command.station, kind)
    if known is not None and known.pose == command.pose:
        return []
    version = known.version + 1 if known is not None else 1
    ids = (command.module, command.station, command.pose, version)
    return [LocationTaught(*ids, command.by, command.why, kind)]
