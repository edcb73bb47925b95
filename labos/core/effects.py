"""What an action does to the bench, as values that the scheduler can reason about.

A driver declares effects with ``{argument}`` place-holders; at submission they are filled in
(``resolve``) and frozen in the run; when a step starts, ``decide`` writes in which labware it
touches. Stations are written ``workcell/module.name`` once resolved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, get_args

import msgspec

from labos.core.ids import LabwareId, StationName


class Effect(msgspec.Struct, frozen=True, tag_field="effect", forbid_unknown_fields=True, gc=False):
    """One thing that an action does or needs."""


class Move(Effect, frozen=True, tag="move"):
    """Labware goes from one station to another, in the gripper of the module that acts.

    ``via`` is the station where the grip is changed, if it must be. A move to a waste station
    ends the labware.
    """

    source: StationName
    target: StationName
    source_grip: str = ""
    target_grip: str = ""
    via: StationName = StationName("")
    labware: LabwareId = LabwareId("")


class Unlid(Move, frozen=True, tag="unlid"):
    """The lid of the plate at ``source`` goes to ``target``, a nest or stack for lids. The plate
    stays; ``labware`` is the lid."""

    plate: LabwareId = LabwareId("")


class Relid(Move, frozen=True, tag="relid"):
    """The lid at ``source`` goes onto the plate at ``target``; ``labware`` is the lid."""

    plate: LabwareId = LabwareId("")


class Take(Effect, frozen=True, tag="take"):
    """The topmost item of a stack becomes labware of its own at ``target``."""

    stack: StationName
    target: StationName
    labware: LabwareId = LabwareId("")


class Needs(Effect, frozen=True, tag="needs"):
    """Labware that this run may use stands at the station (default: at any of the module's)."""

    station: StationName = StationName("")
    labware: LabwareId = LabwareId("")


class Requires(Effect, frozen=True, tag="requires"):
    """A variable of the module, or of the labware it works on, has a value before the start.

    ``of`` is ``module`` or ``labware``. A labware variable that was never set counts as false;
    ``lidded`` is never set, but follows from where lids are.
    """

    of: str
    variable: str
    value: Any
    labware: LabwareId = LabwareId("")


class Sets(Effect, frozen=True, tag="sets"):
    """A variable of the module, or of the labware it works on, has a value afterwards. The value
    ``{result}`` or ``{result.field}`` is what the device reports when it has done it."""

    of: str
    variable: str
    value: Any
    labware: LabwareId = LabwareId("")


class Consumes(Effect, frozen=True, tag="consumes"):
    """The module uses up an amount of a resource, in that resource's unit. A driver may state it as
    a place-holder (``{wells.count}``); in a plan it is a number."""

    resource: str
    amount: float | str


class Replaces(Effect, frozen=True, tag="replaces"):
    """What is left of a resource of ``module`` is taken out, and a full pack put in: what a person does
    with a roll of foil or a rack of tips. Nothing, if no module is named."""

    module: str
    resource: str
    lot: str = ""
    expires: str = ""


class Claims(Effect, frozen=True, tag="claims"):
    """The module is set to a value that its run needs to stay: runs that want the same value
    share it, others wait until the last holder has let go or ended."""

    setpoint: str
    value: Any


class Releases(Effect, frozen=True, tag="releases"):
    """The run does not need the module's setpoint any more."""

    setpoint: str


class Reads(Effect, frozen=True, tag="reads"):
    """The module reads the barcode of the labware it works on; the result is that text, or an
    object that holds it as ``barcode``. ``station`` and ``barcode`` are known afterwards only."""

    labware: LabwareId = LabwareId("")
    station: StationName = StationName("")
    barcode: str = ""


class Transfers(Effect, frozen=True, tag="transfers"):
    """Liquid goes into wells of the labware that the module works on: one volume (µL) a well.
    ``liquid`` is the well or reservoir it comes from, ``resource`` the consumable whose lot it is
    of, if it is one. Lists may come from an earlier step's result."""

    liquid: str
    wells: Any
    volumes_ul: Any
    resource: str = ""
    labware: LabwareId = LabwareId("")


class Draws(Effect, frozen=True, tag="draws"):
    """Liquid leaves wells of the labware that the module works on: one volume (µL) a well. Lists may
    come from an earlier step's result."""

    wells: Any
    volumes_ul: Any
    labware: LabwareId = LabwareId("")


AnyEffect = (
    Move
    | Unlid
    | Relid
    | Take
    | Needs
    | Requires
    | Sets
    | Consumes
    | Replaces
    | Claims
    | Releases
    | Reads
    | Transfers
    | Draws
)


_WORKED_ON, _LIDS = (Move, Needs), (Unlid, Relid)
_PLACES = {
    kind: [name for name in ("source", "target", "via", "stack", "station") if name in kind.__struct_fields__]
    for kind in get_args(AnyEffect)
}
"""The fields of each kind of effect that name stations."""


def emptied(effect: Move) -> StationName:
    """The station that a motion leaves emptier; none if only a lid is taken off."""
    return StationName("") if isinstance(effect, Unlid) else effect.source


def filled(effect: Move) -> StationName:
    """The station where a motion takes up room at its end; none if a lid comes onto its plate."""
    return StationName("") if isinstance(effect, Relid) else effect.target


QUARTER = {("narrow", "wide"): 90, ("wide", "narrow"): -90}
"""How far labware is turned (degrees) by changing the grip on it."""


def turn(effect: Move, source_rotation: int, target_rotation: int) -> int:
    """How far a motion turns labware in its nest, in degrees from 0 to 270."""
    by_grip = QUARTER.get((effect.source_grip, effect.target_grip), 0)
    return (target_rotation - source_rotation + by_grip) % 360


def places(effects: Iterable[AnyEffect]) -> set[StationName]:
    """All stations that effects name."""
    found: set[StationName] = set()
    for effect in effects:
        for field in _PLACES[type(effect)]:
            place = getattr(effect, field)
            if place:
                found.add(place)
    return found


def types_at(effects: Iterable[AnyEffect], carried: str, plate: str) -> dict[StationName, str]:
    """Of what type the labware is that an arm meets at each station: what it carries, but where a lid is on
    its plate, the plate."""
    found: dict[StationName, str] = {}
    for effect in effects:
        if isinstance(effect, Move):
            found[effect.via] = found[effect.source] = found[effect.target] = carried
            if isinstance(effect, Unlid):
                found[effect.source] = plate
            elif isinstance(effect, Relid):
                found[effect.target] = plate
        elif isinstance(effect, Take):
            found[effect.stack] = found[effect.target] = carried
    return found


def is_reported(value: Any) -> bool:
    """Whether a value is to be read from the result: ``{result}`` or ``{result.field}``."""
    return isinstance(value, str) and (
        value == "{result}" or (value.startswith("{result.") and value.endswith("}"))
    )


def reported(value: Any, result: Any) -> Any:
    """A value as it is once the result is known; null where the result does not say."""
    if not is_reported(value):
        return value
    for field in value[1:-1].split(".")[1:]:
        result = result.get(field) if isinstance(result, dict) else None
    return result


def resolve(effect: AnyEffect, args: Mapping[str, Any], station: Callable[[str], StationName]) -> AnyEffect:
    """Fill ``{argument}`` place-holders from ``args``; ``station`` turns a written place into
    a station's full name. Raises KeyError for an argument that is not there."""

    def written(value: Any) -> Any:
        if isinstance(value, str) and "{" in value and not is_reported(value):
            whole = value[1:-1]
            if value.startswith("{") and value.endswith("}") and "{" not in whole:
                return args[whole]
            return value.format_map(args)
        return value

    changes: dict[str, Any] = {}
    for field in effect.__struct_fields__:
        value = written(getattr(effect, field))
        if field in ("source", "target", "via", "stack", "station") and value:
            value = station(str(value))
        changes[field] = value
    return msgspec.structs.replace(effect, **changes)


def hand_of(module: str) -> StationName:
    """A manipulator's hand, as a place where labware may be."""
    return StationName(f"{module}.gripper")


def arrivals(effects: tuple[AnyEffect, ...]) -> list[StationName]:
    """Stations at which an action will put labware down, for good or to change its grip."""
    places: list[StationName] = []
    for effect in effects:
        if isinstance(effect, Move):
            place = filled(effect)
            if place:
                places.append(place)
            if effect.via:
                places.append(effect.via)
        elif isinstance(effect, Take):
            places.append(effect.target)
    return places


def touched(effects: tuple[AnyEffect, ...]) -> list[LabwareId]:
    """Labware that exists before the action and that the action carries or works on."""
    names: list[LabwareId] = []
    plates: list[LabwareId] = []
    for effect in effects:
        if isinstance(effect, _WORKED_ON) and effect.labware:
            names.append(effect.labware)
            if isinstance(effect, _LIDS) and effect.plate:
                plates.append(effect.plate)
    return names + plates
