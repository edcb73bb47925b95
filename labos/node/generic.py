"""A simulated module that is made from its description alone, for instruments without a driver's simulator.

It takes the time of an action, and carries out the action's effects on the simulated bench. It measures
nothing: the result of an action is the one in its description, or the barcode that it reads.
"""

from __future__ import annotations

import asyncio
import inspect
import random  # noqa: TID251 (seeded by Setup: the same seed gives the same durations)
from collections.abc import Iterable
from typing import Any, ClassVar

import msgspec

from labos.core.amounts import set_duration
from labos.core.effects import (
    AnyEffect,
    Consumes,
    Move,
    Needs,
    Reads,
    Relid,
    Requires,
    Sets,
    Take,
    Unlid,
    is_reported,
    list_carried,
    resolve,
)
from labos.core.ids import StationName, local
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError
from labos.node.files import Attachment
from labos.node.node import ActionMethod, Node, Setup, current_together
from labos.node.world import World, lid_of

SCATTER = 0.1
"""Durations differ from the nominal one by at most this fraction of it."""

WASTE = ("trash", "waste")

VERBS = {("sealed", True): "seal", ("sealed", False): "peel"}
"""The simulated bench's words for setting a variable of labware; otherwise the action's name is used."""


def attach_files(result: Any) -> Any:
    """A result from a description, with its files in the form ``{file: name, text: content}`` as
    attachments."""
    if isinstance(result, dict) and result.keys() == {"file", "text"}:
        return Attachment(str(result["file"]), str(result["text"]).encode())
    if isinstance(result, dict):
        return {name: attach_files(value) for name, value in result.items()}
    return [attach_files(value) for value in result] if isinstance(result, list) else result


class GenericDevice:
    """Carries out effects of actions on the simulated bench. Raises DeviceError without a bench."""

    def __init__(self, setup: Setup, description: Description) -> None:
        if setup.world is None:
            raise DeviceError(
                f"{setup.name} is only simulated: no driver and no interface reaches its device.",
                effects="none",
                remedy="Write its `interface:` and address in the workcell file, or a `driver:`.",
            )
        self.name, self.world = setup.name, setup.world
        self._setup, self._description = setup, description
        self._random = random.Random(f"{setup.seed}/{setup.name}")
        self._at_work: asyncio.Future[None] | None = None
        self._is_stopped = False
        self.variables = {**description.variables, **_set_before(setup.world, setup.name)}
        self._move_gates()
        self.world.leave(self.name)

    async def carry_out(self, spec: ActionSpec, args: dict[str, Any]) -> Any:
        """Carry out an action's effects, within its duration. Raises DeviceError, Crash."""
        if not spec.exclusive:
            await asyncio.sleep(self._draw_duration_s(spec.duration_s) / self._setup.pace)
            return self._work(spec, self._resolve(spec, args))
        if self._is_stopped:
            raise DeviceError(f"{self.name} is stopped.", effects="none", remedy="Reset it.")
        if self._at_work is not None:
            raise DeviceError(f"{self.name} is busy.", effects="none", remedy="Wait until it is idle.")
        effects = self._resolve(spec, args)
        self._check(effects)
        motions = list_carried(effects)
        share_s = spec.duration_s / max(len(motions), 1)
        self.world.enter(self.name, self.name)
        for motion in motions:
            await self._move(motion, share_s)
        if not motions:
            await self._take_time(share_s)
        result = self._work(spec, effects)
        self.world.leave(self.name)
        return result

    def is_idle(self) -> bool:
        return self._at_work is None

    def stop(self) -> None:
        """Stop all motion at once; labware in the hand stays in it."""
        self._is_stopped = True
        if self._at_work is not None:
            self._at_work.cancel()

    def reset(self) -> None:
        self._is_stopped = False
        self.world.leave(self.name)

    def find_held_plate(self) -> str:
        """The plate in the hand; empty if there is none."""
        return self._find_top(f"hand:{self.name}")

    # -- what an action does -----------------------------------------------------------------

    def _resolve(self, spec: ActionSpec, args: dict[str, Any]) -> list[AnyEffect]:
        given = {
            arg.name: args.get(arg.name, "" if arg.default is None else arg.default) for arg in spec.args
        }
        return [
            resolve(effect, given, lambda text: StationName(self._place(text))) for effect in spec.effects
        ]

    def _check(self, effects: Iterable[AnyEffect]) -> None:
        """Raises DeviceError before anything has moved."""
        for effect in effects:
            if not isinstance(effect, Requires) or effect.of != "module":
                continue
            value = self.variables.get(effect.variable, effect.value)
            if value != effect.value:
                raise DeviceError(
                    f"{self.name}: {effect.variable} is {value}, not {effect.value}.", effects="none"
                )

    async def _move(self, effect: Move | Take, took_s: float) -> None:
        source, target = self._find_ends(effect)
        if source != f"hand:{self.name}":
            self.world.enter(self.name, source)
            await self._take_time(0.4 * took_s)
            self.world.grip(self.name, self._find_lid_at(source, effect, Unlid), effect.source_grip)
        await self._take_time(0.3 * took_s)
        if target != f"hand:{self.name}":
            self.world.enter(self.name, target)
            self._put_down(self._find_lid_at(target, effect, Relid), effect.target_grip)
            await self._take_time(0.3 * took_s)

    def _find_ends(self, effect: Move | Take) -> tuple[str, str]:
        """The start and the end of a motion; the module's own hand is a possible place."""
        hand = {f"{self.name}.{s.name}" for s in self._description.stations if s.kind == "gripper"}
        ends = (effect.source, effect.target)
        return tuple(f"hand:{self.name}" if place in hand else place for place in ends)  # type: ignore[return-value]

    def _find_lid_at(self, place: str, effect: Move | Take, kind: type[Move]) -> str:
        """The place of the plate's lid if the effect carries the lid from or to there; otherwise the place
        itself."""
        return lid_of(self._find_top(place)) if isinstance(effect, kind) else place

    def _put_down(self, place: str, grip: str) -> None:
        chutes = {self._place(name) for name in self._setup.config.get("waste", ())}
        if place in chutes or place.rpartition(".")[2] in WASTE:
            self.world.discard(self.name, place)
        else:
            self.world.release(self.name, place, grip)

    def _work(self, spec: ActionSpec, effects: Iterable[AnyEffect]) -> Any:
        """Carry out the effects that carry nothing."""
        at, result = "", attach_files(spec.returns)
        changed: dict[str, Any] = {}
        for effect in effects:
            match effect:
                case Needs():
                    at = effect.station or self._find_own_place()
                case Consumes() if not isinstance(effect.amount, str):
                    self.world.use(self.name, effect.resource, effect.amount)
                case Reads():
                    result = {"barcode": self.world.barcode(self._find_top(at or self._find_own_place()))}
                case Sets(of="labware") if not is_reported(effect.value):
                    self.world.work(self.name, VERBS.get((effect.variable, effect.value), spec.name), at)
                case Sets(of="module") if not is_reported(effect.value):
                    changed[effect.variable] = effect.value
        if changed:
            self.variables |= changed
            self.world.work(self.name, "set", **changed)
            self._move_gates()
        elif current_together.get():  # it is done to all labware in the device
            for place in self._list_taken():
                self.world.work(self.name, spec.name, place)
        else:
            self.world.work(self.name, spec.name, at)
        return result

    def _move_gates(self) -> None:
        """Close the places that can be reached only while a variable has a certain value, if it has another
        value."""
        for station in self._description.stations:
            place = self._setup.place(station.name)
            is_shut = any(self.variables.get(name) != value for name, value in station.access.items())
            if station.access and is_shut != self.world.is_shut(place):
                self.world.gate(self.name, place, shut=is_shut)

    # -- inside ------------------------------------------------------------------------------

    async def _take_time(self, nominal_s: float) -> None:
        """Wait for lab seconds. Raises DeviceError if the device is stopped during this time."""
        self._at_work = asyncio.ensure_future(
            asyncio.sleep(self._draw_duration_s(nominal_s) / self._setup.pace)
        )
        try:
            await asyncio.wait({self._at_work})
        finally:
            self._at_work.cancel()
            self._at_work = None
        if self._is_stopped:
            raise DeviceError(f"{self.name} was stopped in mid-motion.", remedy="Check it, then reset it.")

    def _draw_duration_s(self, nominal_s: float) -> float:
        """A random duration for this execution, in lab seconds."""
        return nominal_s * self._random.uniform(1 - SCATTER, 1 + SCATTER)

    def _place(self, text: str) -> str:
        """The bench's name of a place: ``module.place``, without the workcell."""
        bare = local(StationName(text)).replace(".positions.", ".")
        return bare if "." in bare else self._setup.place(bare)

    def _find_own_place(self) -> str:
        """The module's own station with labware; empty if there is none."""
        taken, own = self._list_taken(), self._list_own()
        return taken[0] if taken else own[0] if own else ""

    def _list_own(self) -> list[str]:
        return [self._setup.place(s.name) for s in self._description.stations if s.kind != "gripper"]

    def _list_taken(self) -> list[str]:
        """The module's own stations, and their shelves, with labware."""
        own = self._list_own()
        shelves = [f"{place}." for place in own]
        return [
            place
            for place, plates in self.world.list_contents().items()
            if plates and (place in own or place.startswith(tuple(shelves)))
        ]

    def _find_top(self, place: str) -> str:
        plates = self.world.at(place)
        return plates[-1] if plates else ""


def _set_before(world: World, device: str) -> dict[str, Any]:
    """The variables that a device has set before its restart."""
    found: dict[str, Any] = {}
    for motion in world.motions("set"):
        if motion.device == device:
            found |= motion.facts
    return found


class GenericNode(Node):
    """The node of a module that is simulated by its description."""

    described: ClassVar[Description]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.device = GenericDevice(setup, self.described)

    @classmethod
    def describe(cls) -> Description:
        return cls.described

    def methods(self) -> dict[str, ActionMethod]:
        return {
            spec.name: self.reset if spec.name == "reset" else _make_method(self.device, spec)
            for spec in self.described.actions
        }

    async def is_idle(self) -> bool:
        return self.device.is_idle()

    async def stop(self) -> None:
        self.device.stop()

    async def reset(self) -> None:
        self.device.reset()

    async def observe(self) -> dict[str, Any]:
        return dict(self.device.variables)


def make_generic_node(description: Description) -> type[Node]:
    """The node class of a simulated module with this description, which has the action ``reset``."""
    return type("GenericNode", (GenericNode,), {"described": description, "driver": description.driver})


def extend_node(base: type[Node], description: Description) -> type[Node]:
    """A driver's simulated node with additional actions. ``description`` is that of the driver with the
    additions. Actions that the driver does not have are simulated by their effects. Arguments that it does
    not know are not passed to it."""
    known = {spec.name: spec for spec in base.describe().actions}
    # The driver controls doors and variables: the generic device moves none of them.
    stations = tuple(msgspec.structs.replace(station, access={}) for station in description.stations)
    added = msgspec.structs.replace(description, stations=stations, variables={})
    devices: dict[int, GenericDevice] = {}

    def methods(self: Any) -> dict[str, ActionMethod]:
        theirs = base.methods(self)
        device = devices[id(self)] = GenericDevice(self.setup, added)
        return {
            spec.name: _make_method(device, spec)
            if spec.name not in known or _replaces_action(spec, known[spec.name])
            else _drop_new_arguments(theirs[spec.name], spec, known[spec.name])
            for spec in description.actions
        }

    async def is_idle(self: Any) -> bool:
        return devices[id(self)].is_idle() and await base.is_idle(self)

    async def stop(self: Any) -> None:
        devices[id(self)].stop()
        await base.stop(self)

    async def reset(self: Any) -> None:
        await base.reset(self)
        devices[id(self)].reset()

    offers = {"describe": classmethod(lambda cls: description), "methods": methods}
    return type(base.__name__, (base,), {**offers, "is_idle": is_idle, "stop": stop, "reset": reset})


def _replaces_action(spec: ActionSpec, known: ActionSpec) -> bool:
    """Whether an action replaces the driver's action of that name."""
    lacks = {arg.name for arg in known.args} - {arg.name for arg in spec.args}
    return bool(lacks) or spec.effects != known.effects


def _drop_new_arguments(method: ActionMethod, spec: ActionSpec, known: ActionSpec) -> ActionMethod:
    """A driver's method for an action with more arguments than the driver knows."""
    new = {arg.name for arg in spec.args} - {arg.name for arg in known.args}

    def without(args: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in args.items() if name not in new}

    async def carry_out(**args: Any) -> Any:
        return await method(**without(args))

    def carry_out_blocking(**args: Any) -> Any:
        return method(**without(args))

    if not new:
        return method
    return carry_out if inspect.iscoroutinefunction(method) else carry_out_blocking


def _make_method(device: GenericDevice, spec: ActionSpec) -> ActionMethod:
    async def carry_out(**args: Any) -> Any:
        return await device.carry_out(set_duration(spec, args), args)

    return carry_out
