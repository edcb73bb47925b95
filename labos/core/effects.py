"""Effects: the changes that an action makes to the bench, as values that the scheduler can use.

A driver declares effects with ``{argument}`` place-holders. At submission they are filled in (``resolve``)
and stored in the run. When a step starts, ``decide`` writes the ids of its labware into them. Stations are
written ``workcell/module.name`` once resolved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeGuard, get_args

import msgspec

from labos.core.ids import LabwareId, StationName

Lid = Literal["", "off", "on"]
"""The change of a lid: none, it is taken off its plate, or it is put onto one."""


class Effect(msgspec.Struct, frozen=True, tag_field="effect", forbid_unknown_fields=True, gc=False):
    """One thing that an action does or needs."""

    if TYPE_CHECKING:

        @property
        def room(self) -> tuple[StationName, ...]:
            """Where room is needed for one piece more, for good or while the action lasts."""

        @property
        def cleared(self) -> tuple[StationName, ...]:
            """Where one piece less stands after the action than during it; those that are empty mean
            nowhere."""

        @property
        def stock(self) -> StationName:
            """The stack from which an item without an id is taken; empty if none is taken."""

    else:  # attributes of the class: they are read faster than properties
        room = cleared = ()
        stock = ""


NOWHERE = StationName("")


class Carrying(Effect, frozen=True):
    """An effect that carries labware. Its requirements and results are declared here, once for each kind;
    ``algebra`` uses them for all checks. The properties below are those of a plain move; other kinds override
    them.

    The hand takes the labware at ``source`` and puts it down at ``target``; at ``via`` it changes its grip
    (empty: nowhere). ``lid``: a lid is taken ``off`` its plate or put ``on`` one."""

    lid: ClassVar[Lid] = ""

    if TYPE_CHECKING:

        @property
        def source(self) -> StationName: ...
        @property
        def target(self) -> StationName: ...
        @property
        def via(self) -> StationName: ...
        @property
        def labware(self) -> LabwareId: ...
        @property
        def source_grip(self) -> str: ...
        @property
        def target_grip(self) -> str: ...

    @property
    def stands(self) -> tuple[StationName, ...]:
        """The places where labware with an id has to stand; on a stack, as the topmost."""
        return (self.source,)

    @property
    def plate_at(self) -> StationName:
        """The station of the plate whose lid is carried; empty if no lid is carried."""
        return NOWHERE

    @property
    def plate(self) -> LabwareId:
        """The plate whose lid is carried; empty if no lid is carried, or if the plate is not known yet."""
        return LabwareId("")

    @property
    def entered(self) -> tuple[StationName, ...]:
        """The stations into which the hand reaches."""
        return (self.source, self.via, self.target) if self.via else (self.source, self.target)

    @property
    def emptied(self) -> StationName:
        """The place that has one piece less afterwards; empty if there is none."""
        return self.source

    @property
    def filled(self) -> StationName:
        """The place that has one piece more afterwards; empty if there is none."""
        return self.target

    @property
    def room(self) -> tuple[StationName, ...]:
        """The places that need room for one more piece, at the end or while the grip is changed."""
        return (self.target, self.via) if self.via else (self.target,)

    @property
    def cleared(self) -> tuple[StationName, ...]:
        return (self.emptied, self.via)


class Move(Carrying, frozen=True, tag="move"):
    """Labware moves from one station to another, in the gripper of the module that acts. ``via`` is the
    station where the grip is changed, if that is necessary. After a move to a waste station, the labware is
    no longer on the bench.
    """

    source: StationName
    target: StationName
    source_grip: str = ""
    target_grip: str = ""
    via: StationName = NOWHERE
    labware: LabwareId = LabwareId("")


class Unlid(Move, frozen=True, tag="unlid"):
    """The lid of the plate at ``source`` moves to ``target``, a nest or stack for lids. The plate stays;
    ``labware`` is the lid."""

    plate: LabwareId = LabwareId("")

    lid: ClassVar[Lid] = "off"

    @property
    def plate_at(self) -> StationName:
        return self.source

    @property
    def emptied(self) -> StationName:
        return NOWHERE


class Relid(Move, frozen=True, tag="relid"):
    """The lid at ``source`` moves onto the plate at ``target``; ``labware`` is the lid."""

    plate: LabwareId = LabwareId("")

    lid: ClassVar[Lid] = "on"

    @property
    def plate_at(self) -> StationName:
        return self.target

    @property
    def stands(self) -> tuple[StationName, ...]:
        return (self.target, self.source)

    @property
    def filled(self) -> StationName:
        return NOWHERE

    @property
    def room(self) -> tuple[StationName, ...]:
        return (self.via,) if self.via else ()


class Take(Carrying, frozen=True, tag="take"):
    """The topmost piece of a stack moves to ``target`` and gets an id."""

    stack: StationName
    target: StationName
    labware: LabwareId = LabwareId("")

    via: ClassVar[StationName] = NOWHERE
    source_grip: ClassVar[str] = ""
    target_grip: ClassVar[str] = ""

    @property
    def source(self) -> StationName:
        return self.stack

    @property
    def stock(self) -> StationName:
        return self.stack

    @property
    def stands(self) -> tuple[StationName, ...]:
        return ()


class Needs(Effect, frozen=True, tag="needs"):
    """Labware that this run may use stands at the station (default: at any station of the module)."""

    station: StationName = NOWHERE
    labware: LabwareId = LabwareId("")


class Requires(Effect, frozen=True, tag="requires"):
    """A variable of the module, or of the labware in it, must have a value before the start. ``of`` is
    ``module`` or ``labware``. A labware variable that was never set counts as false. ``lidded`` is never set;
    it follows from the places of lids.
    """

    of: str
    variable: str
    value: Any
    labware: LabwareId = LabwareId("")


class Sets(Effect, frozen=True, tag="sets"):
    """A variable of the module, or of the labware in it, has a value after the action. The value ``{result}``
    or ``{result.field}`` stands for the result that the device reports."""

    of: str
    variable: str
    value: Any
    labware: LabwareId = LabwareId("")


class Consumes(Effect, frozen=True, tag="consumes"):
    """The module uses up an amount of a resource, in the unit of the resource. A driver may declare it as a
    placeholder (``{wells.count}``); in a plan it is a number."""

    resource: str
    amount: float | str


class Replaces(Effect, frozen=True, tag="replaces"):
    """A person takes out the rest of a resource of ``module`` and puts in a full pack, such as a roll of foil
    or a rack of tips. Without a module, it has no effect."""

    module: str
    resource: str
    lot: str = ""
    expires: str = ""


class Claims(Effect, frozen=True, tag="claims"):
    """The module is set to a value that its run needs it to keep. Runs that need the same value share it.
    Others wait until the last of these runs has released it or ended."""

    setpoint: str
    value: Any


class Releases(Effect, frozen=True, tag="releases"):
    """The run no longer needs the module's setpoint."""

    setpoint: str


class Reads(Effect, frozen=True, tag="reads"):
    """The module reads the barcode of the labware in it. The result is the barcode, or an object with the
    field ``barcode``. ``station`` and ``barcode`` are known only after the action."""

    labware: LabwareId = LabwareId("")
    station: StationName = StationName("")
    barcode: str = ""


class Transfers(Effect, frozen=True, tag="transfers"):
    """Liquid goes into wells of the labware in the module: one volume (µL) per well. ``liquid`` is the well
    or reservoir from which it comes. If the liquid is a consumable, ``resource`` names it and gives the lot.
    Lists may come from an earlier step's result."""

    liquid: str
    wells: Any
    volumes_ul: Any
    resource: str = ""
    labware: LabwareId = LabwareId("")


class Draws(Effect, frozen=True, tag="draws"):
    """Liquid leaves wells of the labware in the module: one volume (µL) per well. Lists may come from an
    earlier step's result."""

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


def _find_kinds(*of: type[Effect]) -> frozenset[type[Effect]]:
    """The kinds of effects in a union. A fold needs this very often, and ``isinstance`` is slow for
    structs."""
    return frozenset(kind for kind in get_args(AnyEffect) if issubclass(kind, of))


_CARRYING, _MOVES = _find_kinds(Carrying), _find_kinds(Move)
_WORKED_ON = _find_kinds(Move, Needs)
_PLACES = {
    kind: [name for name in ("source", "target", "via", "stack", "station") if name in kind.__struct_fields__]
    for kind in get_args(AnyEffect)
}
"""The fields of each kind of effect that name stations."""


def list_carried(effects: Iterable[AnyEffect]) -> list[Move | Take]:
    """The effects that carry something."""
    return [effect for effect in effects if type(effect) in _CARRYING]  # type: ignore[misc]


def list_moved(effects: Iterable[AnyEffect]) -> list[Move]:
    """The effects that carry labware which had an id before."""
    return [effect for effect in effects if type(effect) in _MOVES]  # type: ignore[misc]


QUARTER = {("narrow", "wide"): 90, ("wide", "narrow"): -90}
"""The rotation of labware (degrees) by a change of the grip on it."""


def turn(effect: Carrying, source_rotation: int, target_rotation: int) -> int:
    """The rotation of labware in its nest by a motion, in degrees from 0 to 270."""
    by_grip = QUARTER.get((effect.source_grip, effect.target_grip), 0)
    return (target_rotation - source_rotation + by_grip) % 360


def list_places(effects: Iterable[AnyEffect]) -> set[StationName]:
    """All stations that effects name."""
    found = {getattr(effect, field) for effect in effects for field in _PLACES[type(effect)]}
    found.discard(NOWHERE)
    return found


def find_types_at(effects: Iterable[AnyEffect], kind: str, plate: str) -> dict[StationName, str]:
    """The type of the labware that an arm meets at each station: ``kind``, which it carries; but where a lid
    is on its plate, ``plate``."""
    found: dict[StationName, str] = {}
    for effect in list_carried(effects):
        found |= dict.fromkeys(effect.entered, kind)
        if effect.lid:
            found[effect.plate_at] = plate
    return found


def is_reported(value: Any) -> bool:
    """Whether a value is read from the result: ``{result}`` or ``{result.field}``."""
    return isinstance(value, str) and (
        value == "{result}" or (value.startswith("{result.") and value.endswith("}"))
    )


def resolve_value(value: Any, result: Any) -> Any:
    """The value after the result is known; null if the result does not have it."""
    if not is_reported(value):
        return value
    for field in value[1:-1].split(".")[1:]:
        result = result.get(field) if isinstance(result, dict) else None
    return result


def resolve(effect: AnyEffect, args: Mapping[str, Any], station: Callable[[str], StationName]) -> AnyEffect:
    """Fill ``{argument}`` place-holders from ``args``; ``station`` converts a place as it is written into a
    station's full name. Raises KeyError for a missing argument."""

    def fill_in(value: Any) -> Any:
        if isinstance(value, str) and "{" in value and not is_reported(value):
            whole = value[1:-1]
            if value.startswith("{") and value.endswith("}") and "{" not in whole:
                return args[whole]
            return value.format_map(args)
        return value

    changes: dict[str, Any] = {}
    for field in effect.__struct_fields__:
        value = fill_in(getattr(effect, field))
        if field in _PLACES[type(effect)] and value:
            value = station(str(value))
        changes[field] = value
    return msgspec.structs.replace(effect, **changes)


def rename_places(effect: AnyEffect, rename: Callable[[StationName], StationName]) -> AnyEffect:
    """An effect with other names for the stations that it names."""
    names = {field: getattr(effect, field) for field in _PLACES[type(effect)]}
    changed = {field: rename(name) for field, name in names.items() if name}
    return msgspec.structs.replace(effect, **changed) if changed else effect


def name_hand(module: str) -> StationName:
    """The name of a manipulator's hand as a place for labware."""
    return StationName(f"{module}.gripper")


def list_arrivals(effects: Iterable[Effect]) -> list[StationName]:
    """Stations at which an action needs room: to put labware down, at the end or to change its grip, or to
    have it free."""
    return [place for effect in effects for place in effect.room]


def changes_labware(effects: Iterable[AnyEffect]) -> bool:
    """Whether an action changes the labware that it works on."""
    return any(map(_changes_labware, effects))


def find_labware_changed(effects: Iterable[AnyEffect]) -> set[LabwareId]:
    """The labware that an action carries or changes, or whose lid it takes off or puts on. If it only needs
    the labware or draws liquid from it, the owner does not change."""
    found: set[LabwareId] = set()
    for effect in effects:
        if isinstance(effect, Carrying):
            found |= {effect.labware, effect.plate}
        elif _changes_labware(effect):
            found.add(effect.labware)
    return found - {LabwareId("")}


def _changes_labware(effect: AnyEffect) -> TypeGuard[Sets | Transfers]:
    return isinstance(effect, Transfers) or (isinstance(effect, Sets) and effect.of == "labware")


def find_labware_used(effects: tuple[AnyEffect, ...]) -> list[LabwareId]:
    """The labware with an id that an action carries or works on."""
    found: list[LabwareId] = []
    plates: list[LabwareId] = []
    used: Iterable[Any] = effects  # their types are looked up in sets, which mypy does not follow
    for effect in used:
        if type(effect) in _WORKED_ON and effect.labware:
            found.append(effect.labware)
            if type(effect) in _MOVES and effect.plate:
                plates.append(effect.plate)
    return found + plates
