"""What follows from a mapping: what does not fit together in it, and what the module offers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from labos.core.model import Description
from labos.errors import DeviceError
from labos.node.mapping import About, BadEffect, DriverTable, Flaw, description_of, near
from labos_drivers.plc.mapping import Condition, MappedAction, PlcMapping, Point, Write
from labos_drivers.plc.values import encoded

KEY = "plc"
MODELS = ("plc", "modbus_plc")
_WHOLE = re.compile(r"\{(\w+)\}")
Path = tuple[str | int, ...]


def argument_in(value: Any) -> str:
    """The argument that a written value stands for; empty if it is a value."""
    found = _WHOLE.fullmatch(value) if isinstance(value, str) else None
    return found[1] if found else ""


# -- what the module offers --------------------------------------------------------------------


def describe(mapping: PlcMapping) -> Description:
    """As a driver's description."""
    about = About.model_validate(
        {
            "description": mapping.description,
            "stations": {name: each.model_dump() for name, each in mapping.stations.items()},
            "variables": {name: variable.start for name, variable in mapping.variables.items()},
            "rest": {n: v.rest for n, v in mapping.variables.items() if v.rest is not None},
            "levels": mapping.levels,
            "units": mapping.units,
            "actions": {name: _as_about(mapping, action) for name, action in mapping.actions.items()}
            | {"reset": {"description": "Bring the PLC out of an error.", "recovers": True}},
        }
    )
    found = description_of(about, KEY)
    return Description(
        driver=KEY,
        version="1",
        description=found.description,
        models=MODELS,
        actions=found.actions,
        stations=found.stations,
        variables=found.variables,
        rest=found.rest,
        levels=found.levels,
        units=found.units,
    )


def _as_about(mapping: PlcMapping, action: MappedAction) -> dict[str, Any]:
    sets = [
        {"sets": {"of": "module", "variable": name, "value": value}} for name, value in action.sets.items()
    ]
    return {
        "description": action.description,
        "args": _args(mapping, action),
        "effects": [*action.effects, *sets],
        "duration": action.duration,
        "safe_to_repeat": action.safe_to_repeat or action.only_reads,
        "exclusive": not action.only_reads,
        "aliases": action.aliases,
        "result": _result(mapping, action),
    }


def _args(mapping: PlcMapping, action: MappedAction) -> dict[str, dict[str, Any]]:
    """The arguments: what is not said of one follows from the point that it is written to."""
    found = {name: arg.model_dump(exclude_unset=True) for name, arg in action.args.items()}
    for write in _writes(action):
        name, point = argument_in(write.value), mapping.points.get(write.point)
        if not name or point is None:
            continue
        told: dict[str, Any] = {"type": point.tells}
        if point.tells != "bool":
            told |= {"unit": point.unit or "1", "minimum": point.minimum, "maximum": point.maximum}
        else:
            told["description"] = f"whether {write.point} is set"
        found[name] = told | found.get(name, {})
    return found


def _result(mapping: PlcMapping, action: MappedAction) -> str:
    if isinstance(action.result, dict):
        return "dict"
    point = mapping.points.get(action.result)
    return point.tells if point is not None else ""


def _writes(action: MappedAction) -> list[Write]:
    return [*action.set, *([action.start] if action.start else [])]


# -- what does not fit together ----------------------------------------------------------------


def flaws_in(mapping: PlcMapping) -> Iterator[Flaw]:
    """Names that mean nothing, writes to what cannot be written, values that a point cannot have."""
    for name, action in mapping.actions.items():
        yield from _in_action(mapping, name, action)
    state = mapping.state
    yield from _conditions(mapping, ("state", "busy"), state.busy)
    yield from _conditions(mapping, ("state", "error"), state.error)
    yield from _named(mapping, ("state", "why"), [state.why] if state.why else [])
    for code in state.codes:
        if not re.fullmatch(r"-?\d+", code):
            yield Flaw(("state", "codes", code), f"{code!r} is no number of a fault.", "Write the number.")
    yield from _writes_in(mapping, ("reset",), mapping.reset, ())
    yield from _writes_in(mapping, ("stop",), mapping.stop, ())
    yield from _named(mapping, ("boot",), [mapping.boot] if mapping.boot else [])
    for resource, point in mapping.resources.items():
        yield from _named(mapping, ("resources", resource), [point])
        if resource not in {**mapping.levels, **mapping.units}:
            known = {**mapping.levels, **mapping.units}
            yield Flaw(("resources", resource), f"There is no level of {resource!r}.", near(resource, known))
    yield from _in_variables(mapping)
    for station, conditions in mapping.labware.items():
        yield from _conditions(mapping, ("labware", station), conditions)
        if station not in mapping.stations:
            at = ("labware", station)
            yield Flaw(at, f"There is no station {station!r}.", near(station, mapping.stations, "station"))
    yield from _in_handshake(mapping)
    yield from _in_effects(mapping)


def _in_action(mapping: PlcMapping, name: str, action: MappedAction) -> Iterator[Flaw]:
    at: Path = ("actions", name)
    if name == "reset":
        yield Flaw(at, "`reset` is no action of its own.", "Write it beside `actions:`.")
    args = tuple(_args(mapping, action))
    yield from _conditions(mapping, (*at, "needs"), action.needs)
    yield from _writes_in(mapping, (*at, "set"), action.set, args)
    if action.start is not None:
        yield from _written(mapping, (*at, "start"), action.start, args)
    yield from _conditions(mapping, (*at, "done"), action.done, args)
    yield from _conditions(mapping, (*at, "failed"), action.failed)
    yield from _named(mapping, (*at, "result"), action.points_read)
    if action.start is None and mapping.handshake is None and not action.only_reads:
        yield Flaw(at, f"Nothing says how {name!r} is started.", "Write `start:`, or a `handshake:`.")
    if action.start is not None and mapping.handshake is not None:
        yield Flaw(
            (*at, "start"),
            "With a handshake, what starts is its number.",
            "Write the order below `set:`; it must move nothing before the number changes.",
        )
    yield from _values_of_variables(mapping, (*at, "sets"), action.sets)


def _in_variables(mapping: PlcMapping) -> Iterator[Flaw]:
    for name, variable in mapping.variables.items():
        at = ("variables", name)
        yield from _named(mapping, (*at, "point"), [variable.point] if variable.point else [])
        for value, conditions in variable.values.items():
            yield from _conditions(mapping, (*at, "values", value), conditions)
        yield from _a_value(mapping, name, variable.start, (*at, "start"))
    for station, told in mapping.stations.items():
        yield from _values_of_variables(mapping, ("stations", station, "access"), told.access)


def _values_of_variables(mapping: PlcMapping, at: Path, told: Mapping[str, Any]) -> Iterator[Flaw]:
    for name, value in told.items():
        if name not in mapping.variables:
            known = near(name, mapping.variables, "variable")
            yield Flaw((*at, name), f"There is no variable {name!r}.", known)
        elif not argument_in(value):
            yield from _a_value(mapping, name, value, (*at, name))


def _a_value(mapping: PlcMapping, name: str, value: Any, at: Path) -> Iterator[Flaw]:
    """A variable that is told by conditions has the values that they are written for."""
    variable = mapping.variables[name]
    values = [*variable.values, variable.otherwise]
    if variable.values and value not in values:
        hint = " YAML takes on, off, yes and no for true and false: put them in quotes." * isinstance(
            value, bool
        )
        yield Flaw(at, f"{name} is never {value!r}.", f"Write one of {', '.join(map(str, values))}.{hint}")


def _in_handshake(mapping: PlcMapping) -> Iterator[Flaw]:
    if mapping.handshake is None:
        return
    for role in ("number", "taken", "done"):
        name = getattr(mapping.handshake, role)
        yield from _named(mapping, ("handshake", role), [name])
        point = mapping.points.get(name)
        if point is None:
            continue
        if point.kind not in ("uint16", "uint32") or point.tells != "int":
            yield Flaw(
                ("handshake", role), f"{name} holds no number of an attempt.", "Make it uint16 or uint32."
            )
        if role == "number" and point.table != "holding":
            yield Flaw(("handshake", role), f"{name} cannot be written.", "It stands in `holding:`.")


def _in_effects(mapping: PlcMapping) -> Iterator[Flaw]:
    try:
        describe(mapping)
    except BadEffect as error:
        at = ("actions", error.action, "effects", error.index)
        yield Flaw(at, f"In {error.action!r} {error}.", "Effects are told in the reference of events.")


def _named(mapping: PlcMapping, at: Path, names: Iterable[str]) -> Iterator[Flaw]:
    for name in names:
        if name not in mapping.points:
            yield Flaw(at, f"There is no point {name!r}.", near(name, mapping.points, "point"))


def _conditions(
    mapping: PlcMapping, at: Path, conditions: Iterable[Condition], args: tuple[str, ...] = ()
) -> Iterator[Flaw]:
    for index, condition in enumerate(conditions):
        here = (*at, index, "point")
        yield from _named(mapping, here, [condition.point])
        point = mapping.points.get(condition.point)
        for value in (condition.is_, condition.near):
            if isinstance(value, str):
                yield from _unknown_argument((*at, index), value, args)
        if point is not None and condition.says_nothing and point.kind != "bool":
            remedy = "Write `is`, `near`, `minimum` or `maximum`."
            yield Flaw(here, f"{condition.point} is a number, which is compared with nothing.", remedy)
        if point is not None and point.kind == "bool" and condition.near is not None:
            yield Flaw(here, f"{condition.point} is a bit, which is near nothing.", "Write `is`.")


def _writes_in(
    mapping: PlcMapping, at: Path, writes: Iterable[Write], args: tuple[str, ...]
) -> Iterator[Flaw]:
    for index, write in enumerate(writes):
        yield from _written(mapping, (*at, index), write, args)


def _written(mapping: PlcMapping, at: Path, write: Write, args: tuple[str, ...]) -> Iterator[Flaw]:
    yield from _named(mapping, (*at, "point"), [write.point])
    point = mapping.points.get(write.point)
    if point is None:
        return
    if point.table in ("discrete", "input"):
        yield Flaw((*at, "point"), f"{write.point} cannot be written.", "Use a coil or a holding register.")
    elif point.bit is not None:
        remedy = "Use a coil, or let the PLC take the whole register."
        yield Flaw((*at, "point"), f"{write.point} is a bit of a register that holds others.", remedy)
    elif isinstance(write.value, str):
        yield from _unknown_argument((*at, "value"), write.value, args)
    elif flaw := _no_value_of(write.point, point, write.value):
        yield Flaw((*at, "value"), flaw, "Change the value, or the point.")


def _unknown_argument(at: Path, value: str, args: tuple[str, ...]) -> Iterator[Flaw]:
    name = argument_in(value)
    if name not in args:
        yield Flaw(at, f"{value!r} is neither a value nor an argument.", near(name, args, "argument"))


def _no_value_of(name: str, point: Point, value: bool | float) -> str:
    if isinstance(value, bool) != (point.kind == "bool"):
        return f"{name} is {'a bit' if point.kind == 'bool' else 'a number'}, and cannot be {value}."
    try:
        encoded(name, point, value)
    except DeviceError as error:
        return str(error)
    return ""


TABLE = DriverTable(KEY, PlcMapping, flaws_in, describe)
