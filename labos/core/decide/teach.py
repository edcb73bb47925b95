"""A manipulator learns where a station is."""

from __future__ import annotations

import math

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.ids import ModuleName, StationName, local
from labos.core.modules import LocationTaught
from labos.core.state import LabState


class TeachLocation(Command, frozen=True):
    module: ModuleName
    station: StationName
    pose: tuple[float, ...]
    by: str
    why: str = ""


@decides(TeachLocation)
def teach_location(state: LabState, command: TeachLocation) -> Decision:
    module = state.modules.by_name.get(command.module)
    if module is None:
        return Rejection("no_module", f"There is no module {local(command.module)}.")
    if command.station not in state.bench.stations:
        return Rejection("no_station", f"There is no station {local(command.station)}.")
    if module.in_flight:
        return Rejection(
            "module_in_use",
            f"{local(command.module)} is at work: its poses cannot be changed now.",
            "Wait until its action has ended.",
        )
    told = module.spec.config.get("poses", {}).get(local(command.station))
    known = module.taught.get(command.station)
    last = list(known.pose) if known is not None else told
    if not command.pose or not all(map(math.isfinite, command.pose)):
        return Rejection("bad_pose", "A pose is one finite number or more.")
    if last is not None and len(last) != len(command.pose):
        return Rejection(
            "bad_pose",
            f"A pose of {local(command.module)} has {len(last)} numbers there, not {len(command.pose)}.",
        )
    if known is not None and known.pose == command.pose:
        return []
    version = known.version + 1 if known is not None else 1
    return [LocationTaught(command.module, command.station, command.pose, version, command.by, command.why)]
