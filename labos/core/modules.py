"""Modules: which node represents them, whether they may be used, and the values of their variables."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import msgspec

from labos.core.actions import (
    ActionEnd,
    ActionFailed,
    ActionRejected,
    ActionReported,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.algebra import list_away_from_rest
from labos.core.calibrations import Calibration
from labos.core.effects import AnyEffect, find_types_at, list_places
from labos.core.ids import ActionId, ModuleName, StationName, local
from labos.core.lab import WorkcellApplied
from labos.core.model import LABWARE_TYPE, PLATE_TYPE, ModuleSpec
from labos.core.registry import Event, event
from labos.core.structs import make_from
from labos.core.words import Words


class ModuleEvent(Event, frozen=True):
    STREAM = "module"
    module: ModuleName


@event("node.joined")
class NodeJoined(ModuleEvent, frozen=True):
    """The module's node has joined. ``about`` is the digest of its description."""

    journal: str
    instance: str
    driver: str
    version: str
    about: str
    status: str
    simulated: bool = False


@event("node.left")
class NodeLeft(ModuleEvent, frozen=True):
    """The node has ended, or does not answer. ``stopped``: LabOS itself ended it, because the lab was closed
    or the workcell changed."""

    why: str
    stopped: bool = False


@event("node.state_changed")
class NodeStateChanged(ModuleEvent, frozen=True):
    """The node changed its state without an action: to ERROR, to BUSY by itself, or back to IDLE."""

    status: str
    error: str = ""


@event("module.variable_set")
class VariableSet(ModuleEvent, frozen=True):
    """A variable of the module, such as its lid, has a new value; null if it is no longer known."""

    variable: str
    value: Any
    by: str = ""


@event("module.setpoint_claimed")
class SetpointClaimed(ModuleEvent, frozen=True):
    """The module was set to a value, and a run needs it to stay at that value. It is null if an action failed
    and the value is unknown."""

    setpoint: str
    value: Any
    by: str


@event("module.setpoint_released")
class SetpointReleased(ModuleEvent, frozen=True):
    """A run no longer needs the module's setpoint."""

    setpoint: str
    by: str


@event("module.taken_out", schema=2)
class ModuleTakenOut(ModuleEvent, frozen=True):
    """The module is out of service. A person puts it back, or it comes back at the time ``until`` (UTC ns; 0:
    only a person puts it back). If LabOS took it out of service (*quarantine*), ``failures`` is the number of
    failures before; if a person did, it is 0."""

    why: Words
    until: int = 0
    failures: int = 0


@event("module.put_back")
class ModulePutBack(ModuleEvent, frozen=True):
    """The module is in service again."""


@event("module.emergency_stopped")
class EmergencyStopped(ModuleEvent, frozen=True):
    """A person stopped the module in an emergency. The event is written afterwards, as soon as the log can be
    written. ``stopped_at`` is the time by the node's clock (UTC ns)."""

    by: str
    stopped_at: int


@event("lab.stop_reported")
class StopReported(Event, frozen=True):
    """The result of an emergency stop: the modules that confirmed that they stopped, with the time (UTC ns),
    and the other modules, each with a reason. The event is written after the stop."""

    by: str
    target: str
    stopped: dict[ModuleName, int]
    silent: dict[ModuleName, str]


@event("location.taught")
class LocationTaught(ModuleEvent, frozen=True):
    """A manipulator has a new pose for a station. ``version`` counts the poses, from 1. With a
    ``labware_type``, the pose is only for labware of that type."""

    station: StationName
    pose: tuple[float, ...]
    version: int
    by: str
    why: Words = ""
    labware_type: str = ""


@event("module.calibrated")
class ModuleCalibrated(ModuleEvent, frozen=True):
    """A person recorded a calibration of the module, or of a part or quantity of it (``what``). The event has
    the certificate, the digest of the report (``file``), and the last day on which the calibration is valid
    (``until``, such as ``2027-01-01``, in UTC). It replaces the previous calibration of the same ``what``,
    and may correct it. A field for which no value was given is empty."""

    by: str
    what: str = ""
    certificate: str = ""
    file: str = ""
    until: str = ""
    why: Words = ""


class Taught(msgspec.Struct):
    """The last taught pose of a manipulator for a station, or for a type of labware there. ``proven``: a move
    with it has succeeded."""

    pose: tuple[float, ...]
    version: int
    proven: bool = False


def describe_stop(name: str) -> str:
    """The error of a module that was stopped in an emergency."""
    return f"Stopped in an emergency{f' by {name}' if name else ''}; reset the module to go on."


class Failure(msgspec.Struct):
    """A failure of a module: its time (UTC ns), a description, and the actions and the step concerned."""

    at: int
    what: str
    actions: tuple[ActionId, ...] = ()
    run: str = ""
    step: int | None = None


class Setpoint(msgspec.Struct):
    """The value to which a module is set, and the runs that need this value."""

    value: Any
    holders: dict[str, bool] = {}


class Variable(msgspec.Struct):
    """The value of a module's variable, such as its lid (None: not known), and the run that changed it last,
    for holding."""

    value: Any
    by: str = ""


class Flight(msgspec.Struct, omit_defaults=True):
    """An action under way on a module. ``proving`` are the new poses that it tries slowly: stations, with a
    labware type if the pose is only for this type. ``setup_s`` is the additional time for the set-up of the
    module before it (lab seconds)."""

    exclusive: bool
    proving: tuple[tuple[StationName, str], ...] = ()
    setup_s: float = 0.0


class ModuleStatus(StrEnum):
    """The state that a module's node reports; ``GONE`` if no node answers."""

    IDLE = "IDLE"
    BUSY = "BUSY"
    ERROR = "ERROR"
    GONE = "GONE"


class Module(msgspec.Struct):
    """An instrument or manipulator. ``status`` is the last reported one. ``stopped_at`` is the time of its
    last emergency stop (UTC ns); ``stopped`` is true from then until the module is idle. ``reached`` are the
    stations of its last exclusive action (the module itself, if it has a zone of its own), until it is known
    to have come back from there. ``doubted`` is true after a failure, a stop or an unknown outcome, until an
    observer has confirmed a motion (the action ``watched``). ``failures`` are the last ones since it was put
    back into service. ``joined``: its node has joined since the kernel started. ``person``: it represents a
    person who does planned work. ``gone_at`` is the time since which its node is GONE (UTC ns). ``cut_off``:
    the node went away during an action, so the position of the device is unknown. ``error_at`` is the time
    since which it reports ERROR (UTC ns). ``asked``: a person was asked about an action that stands still
    because of this. ``taught`` are the poses for stations, by labware type (empty: for any labware).
    ``calibrations`` are the last ones, by what was calibrated. ``set_up_for`` is the value
    for which it is set up, or being set up, if its set-ups take time; None if the value is unknown."""

    spec: ModuleSpec
    status: ModuleStatus = ModuleStatus.GONE
    error: str = ""
    journal: str = ""
    instance: str = ""
    driver: str = ""
    version: str = ""
    about: str = ""
    simulated: bool = False
    out_of_service: str = ""
    stopped_at: int = 0
    stopped: bool = False
    variables: dict[str, Variable] = {}
    in_flight: dict[ActionId, Flight] = {}
    setpoints: dict[str, Setpoint] = {}
    reached: tuple[StationName, ...] = ()
    taught: dict[StationName, dict[str, Taught]] = {}
    calibrations: dict[str, Calibration] = {}
    doubted: bool = False
    watched: ActionId = ActionId("")
    failures: list[Failure] = []
    joined: bool = False
    person: bool = False
    gone_at: int = 0
    cut_off: bool = False
    error_at: int = 0
    asked: bool = False
    set_up_for: Any = None

    def find_value(self, variable: str) -> Any:
        """The value of a variable; None if it is not known."""
        known = self.variables.get(variable)
        return known.value if known is not None else None

    @property
    def values(self) -> dict[str, Any]:
        """The values of its variables."""
        return {name: variable.value for name, variable in self.variables.items()}

    def list_away_from_rest(self) -> dict[str, Variable]:
        """Doors and lids that are not in the positions at which others may use the module."""
        rest = self.spec.rest
        if not rest:
            return {}
        now = {name: self.find_value(name) for name in rest}
        return {name: self.variables.get(name) or Variable(None) for name in list_away_from_rest(now, rest)}

    def find_pose(self, station: StationName, labware_type: str = "") -> tuple[float, ...] | None:
        """The pose for a station with labware of a type (None if the type has no pose of its own), or without
        a type."""
        known = self.find_taught(station, labware_type)
        if known is not None:
            return known.pose
        written = self.spec.config
        if labware_type:
            written = {"poses": written.get("poses_of", {}).get(labware_type, {})}
        pose = written.get("poses", {}).get(local(station))
        return tuple(pose) if pose is not None else None

    def list_poses(self) -> dict[str, list[float]]:
        """Taught poses for any labware, by the stations' local names."""
        return {local(name): list(poses[""].pose) for name, poses in self.taught.items() if "" in poses}

    def list_poses_by_type(self) -> dict[str, dict[str, list[float]]]:
        """Taught poses for single labware types, by type and by the stations' local names."""
        found = {kind: dict(poses) for kind, poses in self.spec.config.get("poses_of", {}).items()}
        for station, by_type in self.taught.items():
            for kind, taught in by_type.items():
                if kind:
                    found.setdefault(kind, {})[local(station)] = list(taught.pose)
        return found

    def find_taught(self, station: StationName, labware_type: str = "") -> Taught | None:
        """The pose for exactly this station and type that was taught since the workcell file."""
        return self.taught.get(station, {}).get(labware_type)

    @property
    def busy(self) -> bool:
        """Whether an exclusive action is in flight."""
        return bool(self.in_flight) and any(flight.exclusive for flight in self.in_flight.values())


class Modules(msgspec.Struct):
    """``back_at`` are the modules that come back into service by themselves, with the time (UTC ns);
    ``in_cell`` is an index by workcell."""

    by_name: dict[ModuleName, Module] = {}
    back_at: dict[ModuleName, int] = {}
    in_cell: dict[str, list[ModuleName]] = {}

    def list_in_cell(self, cell: str) -> list[tuple[ModuleName, Module]]:
        """The modules of a workcell."""
        return [(name, self.by_name[name]) for name in self.in_cell.get(cell, ())]


def fold_workcell_applied(modules: Modules, event: WorkcellApplied, at: int) -> None:
    present = {spec.name for spec in event.modules}
    known_here = modules.in_cell.get(event.name, [])
    for name in [name for name in known_here if name not in present]:
        del modules.by_name[name]
        modules.back_at.pop(name, None)
    for spec in event.modules:
        known = modules.by_name.get(spec.name)
        if known is None:
            known = modules.by_name[spec.name] = Module(spec=spec)
        known.spec = spec
        known.variables = {n: Variable(value) for n, value in spec.variables.items()} | known.variables
    here = dict.fromkeys([*known_here, *(spec.name for spec in event.modules)])
    modules.in_cell[event.name] = [name for name in here if name in present]


def fold_node_joined(modules: Modules, event: NodeJoined, at: int) -> None:
    module = modules.by_name[event.module]
    module.status, module.error, module.gone_at = ModuleStatus(event.status), "", 0
    module.cut_off = False
    module.journal, module.instance = event.journal, event.instance
    module.driver, module.version, module.about = event.driver, event.version, event.about
    module.simulated = event.simulated
    _come_back(module)


def fold_node_left(modules: Modules, event: NodeLeft, at: int) -> None:
    module = modules.by_name[event.module]
    module.status, module.error, module.gone_at = ModuleStatus.GONE, event.why, at
    module.error_at, module.asked = 0, False
    module.cut_off = module.busy


def fold_node_state_changed(modules: Modules, event: NodeStateChanged, at: int) -> None:
    module = modules.by_name[event.module]
    if event.status != ModuleStatus.ERROR:
        module.error_at, module.asked = 0, False
    elif module.status != ModuleStatus.ERROR:
        module.error_at = at
    module.status, module.error = ModuleStatus(event.status), event.error
    _come_back(module)


def _come_back(module: Module) -> None:
    if module.status == ModuleStatus.IDLE:
        module.stopped = False
        if not module.busy:
            module.reached = ()


def fold_variable_set(modules: Modules, event: VariableSet, at: int) -> None:
    modules.by_name[event.module].variables[event.variable] = Variable(event.value, event.by)


def fold_setpoint_claimed(modules: Modules, event: SetpointClaimed, at: int) -> None:
    setpoints = modules.by_name[event.module].setpoints
    held = setpoints.setdefault(event.setpoint, Setpoint(event.value))
    held.value = event.value
    held.holders[event.by] = True


def fold_setpoint_released(modules: Modules, event: SetpointReleased, at: int) -> None:
    held = modules.by_name[event.module].setpoints.get(event.setpoint)
    if held is not None:
        held.holders.pop(event.by, None)


def fold_module_taken_out(modules: Modules, event: ModuleTakenOut, at: int) -> None:
    modules.by_name[event.module].out_of_service = event.why
    modules.back_at.pop(event.module, None)
    if event.until:
        modules.back_at[event.module] = event.until


def fold_module_put_back(modules: Modules, event: ModulePutBack, at: int) -> None:
    module = modules.by_name[event.module]
    module.out_of_service = ""
    modules.back_at.pop(event.module, None)


def fold_emergency_stopped(modules: Modules, event: EmergencyStopped, at: int) -> None:
    module = modules.by_name[event.module]
    module.stopped_at, module.stopped = event.stopped_at, True
    module.doubted = True
    if module.status != ModuleStatus.GONE:
        module.status, module.error = ModuleStatus.ERROR, describe_stop(event.by)


def fold_action_requested(modules: Modules, event: ActionRequested, at: int) -> None:
    module = modules.by_name[event.module]
    flight = module.in_flight[event.action] = Flight(event.exclusive)
    if event.exclusive:
        reached = list_places(event.effects)
        if module.status != ModuleStatus.IDLE:
            reached.update(module.reached)
        if module.spec.zone:
            reached.add(StationName(event.module))
        module.reached = tuple(sorted(reached))
    setup = module.spec.setup
    if setup is not None and setup.argument in event.args:
        others = [module.in_flight[name] for name in event.together if name in module.in_flight]
        others = [other for other in others if other is not flight]  # one set-up serves all of them
        flight.setup_s = others[0].setup_s if others else setup.compute_cost_s(module.set_up_for, event.args)
        module.set_up_for = event.args[setup.argument]
    if event.args.get("slow") is True:
        flight.proving = find_unproven(module, event.effects, event.args)


def fold_action_reported(modules: Modules, event: ActionReported, at: int) -> None:
    modules.by_name[event.module].watched = event.action


def fold_action_unknown(modules: Modules, event: ActionUnknown, at: int) -> None:
    modules.by_name[event.module].doubted = True


_CAME_BACK = (ActionSucceeded, ActionRejected)


def fold_action_ended(modules: Modules, event: ActionEnd, at: int) -> None:
    module = modules.by_name[event.module]
    flight = module.in_flight.pop(event.action, None) or Flight(False)
    if flight.exclusive and isinstance(event, _CAME_BACK):
        module.reached = ()
    if module.spec.setup is not None and flight.exclusive and not isinstance(event, ActionSucceeded):
        module.set_up_for = None
    if isinstance(event, ActionFailed) and event.effects != "none":
        module.doubted = True
    elif isinstance(event, ActionSucceeded) and event.action == module.watched:
        module.doubted = False
    for station, labware_type in flight.proving:
        taught = module.find_taught(station, labware_type)
        if isinstance(event, ActionSucceeded) and taught is not None:
            taught.proven = True


def fold_location_taught(modules: Modules, event: LocationTaught, at: int) -> None:
    module = modules.by_name[event.module]
    poses = module.taught.setdefault(event.station, {})
    poses[event.labware_type] = Taught(event.pose, event.version)
    for flight in module.in_flight.values():
        flight.proving = ()  # the action under way tries the pose first


def fold_module_calibrated(modules: Modules, event: ModuleCalibrated, at: int) -> None:
    modules.by_name[event.module].calibrations[event.what] = make_from(Calibration, event, at=at)


def find_unproven(
    module: Module, effects: tuple[AnyEffect, ...], args: Mapping[str, Any]
) -> tuple[tuple[StationName, str], ...]:
    """The stations of effects whose newly taught pose no move has tried yet, each with the labware type if
    the pose is only for this type. The arguments of an action determine the pose: the type's own if there is
    one, otherwise the station's."""
    types = find_types_at(effects, str(args.get(LABWARE_TYPE) or ""), str(args.get(PLATE_TYPE) or ""))
    found = []
    for name in sorted(list_places(effects)):
        kind = types.get(name, "")
        kind = kind if module.find_pose(name, kind) is not None else ""
        taught = module.find_taught(name, kind)
        if taught is not None and not taught.proven:
            found.append((name, kind))
    return tuple(found)
