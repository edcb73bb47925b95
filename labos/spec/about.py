"""``about:`` of a module: the description of its node, if there is no installed driver.

A foreign node reports its actions and arguments, but not their effects on the bench. ``about:`` in the
workcell file has both, so that a workflow can be checked and scheduled while the node is not running.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_args

import msgspec
from pydantic import Field

from labos.core.effects import AnyEffect
from labos.core.ids import ModuleName
from labos.core.model import ActionSpec, Arg, Description, ModuleSpec, Station, StationKind, Workcell
from labos.core.structs import make_from
from labos.spec.mismatch import explain_plainly
from labos.spec.parts import Aliases, Comment, Name, Part, Seconds

EMPTY: tuple[Any, ...] = ("", (), [], None)
"""Values that count as empty."""

ArgType = Literal["str", "int", "float", "bool", "list", "dict", "any", "station", "file"]


class ArgAbout(Part):
    """An argument; ``minimum`` and ``maximum`` are in ``unit``. An argument with a default may be left
    out."""

    type: ArgType = "any"
    """its type; ``station`` and ``file`` are names of such"""
    required: bool | None = None
    """whether it must be given; by default: whether it has no default value"""
    default: Any = None
    """its value if it is not given"""
    unit: str = ""
    """the unit of its value and limits"""
    minimum: float | None = None
    """the least value"""
    maximum: float | None = None
    """the greatest value"""
    choices: list[Any] = []
    """the values it may have; any, if left out"""
    aliases: Aliases = []
    description: Comment = ""


class ActionAbout(Part):
    """An action. ``effects`` are tables such as ``{move: {source: "{source}", target: "{target}"}}``;
    ``returns`` is the result of the simulated module; it may contain a file as ``{file: name, text:
    content}``. ``duration_from`` is the formula for the duration if it depends on arguments, such as ``20 +
    {seconds}``."""

    description: Comment = ""
    args: dict[Name, ArgAbout] = {}
    """its arguments, by name"""
    effects: list[dict[str, dict[str, Any] | None]] = []
    """its effects on the bench: tables with one effect each, as in the reference"""
    duration: Annotated[Seconds, Field(gt=0)] = 1.0
    """its nominal duration: seconds, or text such as ``10 min``"""
    safe_to_repeat: bool = False
    """whether it can be repeated without harm"""
    exclusive: bool = True
    """false for a pure query, which does not occupy the module"""
    recovers: bool = False
    """whether it recovers the module from an error"""
    aliases: Aliases = []
    result: str = ""
    """the type of its result; empty for none"""
    returns: Any = None
    """the result of the simulated module; a file in it as ``{file: name, text: content}``"""
    dangerous: str = ""
    """its danger: ``laser``, ``hot``, ``irreversible``, or another word"""
    duration_from: str = ""
    """the formula for the duration if it depends on arguments: ``{seconds}``, ``20 + {minutes}``"""


class StationAbout(Part):
    """A place of the module that holds labware."""

    kind: StationKind = "nest"
    """the kind of the station"""
    capacity: int = Field(default=1, ge=1)
    """its capacity for pieces of labware"""
    access: dict[str, Any] = {}
    """values of the module's variables with which an arm can reach in"""
    claim: bool = True
    """whether labware here blocks the module for other runs"""
    aliases: Aliases = []


class About(Part):
    """The description of the module that a driver would give."""

    description: Comment = ""
    manipulator: bool = False
    """whether it moves labware"""
    stations: dict[Name, StationAbout] = {}
    """its places that hold labware, by name"""
    variables: dict[str, Any] = {}
    """first values of its variables that matter to others"""
    rest: dict[str, Any] = {}
    """values of its variables at which other runs can use it"""
    levels: dict[str, float] = {}
    """capacities of its resources"""
    units: dict[str, str] = {}
    """the units of its resources"""
    actions: dict[Name, ActionAbout]
    """its actions, by name"""


class ExtendedAction(ActionAbout):
    """An action that the driver does not have, or further arguments of one that it has. With ``replaces``, it
    replaces the driver's action of that name."""

    replaces: bool = False
    """whether it replaces the driver's action; if not, its arguments are added"""


class Extends(Part):
    """Parts of the module's own node that its driver does not have."""

    stations: dict[Name, StationAbout] = {}
    """places that the driver does not have, by name"""
    actions: dict[Name, ExtendedAction] = {}
    """actions and arguments that the driver does not have, by the action's name"""


GENERIC = "generic"
"""The driver of a module that is described by ``about:`` and has no interface: it can be simulated."""


EFFECTS: dict[str, type[msgspec.Struct]] = {
    str(kind.__struct_config__.tag): kind for kind in get_args(AnyEffect)
}
"""The types of effects by their names in files."""


class BadEffect(ValueError):
    """An effect that does not exist or lacks a field; ``action`` and ``index`` name its place."""

    def __init__(self, message: str, action: str, index: int, remedy: str = "") -> None:
        super().__init__(message)
        self.action, self.index = action, index
        self.remedy = remedy or f"Known effects: {', '.join(sorted(EFFECTS))}."


def make_description(about: About, driver: str) -> Description:
    """Convert ``about:`` to a driver's description. Raises BadEffect."""
    return make_from(
        Description,
        about,
        driver=driver,
        version="",
        actions=tuple(_make_action(name, action) for name, action in about.actions.items()),
        stations=_make_stations(about.stations),
    )


def extend(description: Description, more: Extends) -> Description:
    """Add the further actions and stations of a module to its driver's description. Raises BadEffect."""
    actions = {action.name: action for action in description.actions}
    for name, written in more.actions.items():
        action, known = _make_action(name, written), description.action(name)
        if known is None:
            actions[name] = action
            continue
        if written.replaces:
            actions[known.name] = msgspec.structs.replace(action, name=known.name, aliases=known.aliases)
            continue
        new = [arg for arg in action.args if arg.name not in {arg.name for arg in known.args}]
        actions[known.name] = msgspec.structs.replace(known, args=(*known.args, *new))
    stations = {station.name: station for station in (*_make_stations(more.stations), *description.stations)}
    return msgspec.structs.replace(
        description, actions=tuple(actions.values()), stations=tuple(stations.values())
    )


def add_reset(description: Description) -> Description:
    """The description with the action ``reset``, which every node has, even if the file does not have it."""
    if description.action("reset") is not None:
        return description
    reset = ActionSpec(name="reset", description="Recover the device from an error.", recovers=True)
    return msgspec.structs.replace(description, actions=(*description.actions, reset))


def find_description(module: ModuleSpec, descriptions: Mapping[str, Description]) -> Description | None:
    """The description of a module. It comes from the module's own ``about:``, from the table that configures
    its driver, or else from the driver."""
    written = module.config.get("about") or module.config.get("offers")
    if written:
        found = add_reset(make_description(About.model_validate(written), module.driver))
    elif module.driver in descriptions:
        found = descriptions[module.driver]
    else:
        return None
    more = module.config.get("extends")
    return extend(found, Extends.model_validate(more)) if more else found


def describe_modules(
    workcell: Workcell, descriptions: Mapping[str, Description]
) -> dict[ModuleName, Description]:
    """The descriptions of a workcell's modules, as far as they are known."""
    found = {module.name: find_description(module, descriptions) for module in workcell.modules}
    return {name: known for name, known in found.items() if known is not None}


def _make_stations(written: Mapping[str, StationAbout]) -> tuple[Station, ...]:
    return tuple(
        Station(name, s.kind, s.capacity, s.access, s.claim, tuple(s.aliases)) for name, s in written.items()
    )


def _make_action(name: str, action: ActionAbout) -> ActionSpec:
    return make_from(
        ActionSpec,
        action,
        name=name,
        args=tuple(_make_arg(key, arg) for key, arg in action.args.items()),
        effects=tuple(_make_effect(name, index, written) for index, written in enumerate(action.effects)),
        duration_s=action.duration,
        aliases=tuple(action.aliases),
    )


def _make_arg(name: str, arg: ArgAbout) -> Arg:
    return make_from(
        Arg,
        arg,
        name=name,
        required=arg.default is None if arg.required is None else arg.required,
        aliases=tuple(arg.aliases),
        choices=tuple(arg.choices),
    )


def _make_effect(action: str, index: int, written: Mapping[str, dict[str, Any] | None]) -> AnyEffect:
    if len(written) != 1:
        raise BadEffect("an effect has one name, such as `move:`", action, index)
    ((name, fields),) = written.items()
    try:
        return msgspec.convert({"effect": name, **(fields or {})}, AnyEffect)  # type: ignore[no-any-return]
    except msgspec.ValidationError as error:
        says = f"the effect {name!r} does not fit: {explain_plainly(error)}"
        raise BadEffect(says, action, index, _find_form(name)) from error


def _find_form(name: str) -> str:
    """The form of an effect in files; empty if there is no effect of that name."""
    kind = EFFECTS.get(name)
    if kind is None:
        return ""
    fields = msgspec.structs.fields(kind)
    needed = ", ".join(f"{field.name}: …" for field in fields if field.required)
    others = ", ".join(field.name for field in fields if not field.required)
    return f"Write `{name}: {{{needed}}}`{(f'; it may also have {others}' if others else '')}."


def make_about(description: Description) -> dict[str, Any]:
    """A description in the form of ``about:``; empty values are left out."""
    plain = {key: getattr(description, key) for key in About.model_fields}
    plain["stations"] = {s.name: _write_station(s) for s in description.stations}
    plain["actions"] = {a.name: _write_action(a) for a in description.actions if a.name != "reset"}
    return {key: value for key, value in plain.items() if value or key == "actions"}


def _write_station(station: Station) -> dict[str, Any]:
    plain, usual = _drop_keys(msgspec.to_builtins(station), "name"), msgspec.to_builtins(Station(""))
    return {key: list(v) if isinstance(v, tuple) else v for key, v in plain.items() if v != usual[key]}


def _write_action(action: ActionSpec) -> dict[str, Any]:
    plain = _drop_keys(
        msgspec.to_builtins(action), "name", "args", "effects", "duration_s", "by_person", "cancellable"
    )
    kept = {
        key: value
        for key, value in plain.items()
        if value not in EMPTY and value is not False and key != "exclusive"
    }
    if not action.exclusive:
        kept["exclusive"] = False
    if action.args:
        kept["args"] = {arg.name: _write_arg(arg) for arg in action.args}
    effects = [msgspec.to_builtins(effect) for effect in action.effects]
    kept["effects"] = [{e.pop("effect"): {k: v for k, v in e.items() if v not in EMPTY}} for e in effects]
    return {**kept, "duration": action.duration_s}


def _write_arg(arg: Arg) -> dict[str, Any]:
    plain = _drop_keys(msgspec.to_builtins(arg), "name", "required")
    kept = {key: value for key, value in plain.items() if value not in EMPTY}
    if arg.required != (arg.default is None):
        kept["required"] = arg.required
    return kept


def _drop_keys(table: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}
