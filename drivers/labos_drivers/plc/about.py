"""Derives two things from a mapping: the description of the module, and the faults of the mapping."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from labos.core.model import Description
from labos.errors import DeviceError
from labos.node.mapping import About, BadEffect, DriverTable, Flaw, make_description, suggest_name
from labos_drivers.plc.mapping import Condition, MappedAction, PlcMapping, Point, Write, find_argument
from labos_drivers.plc.values import encode

KEY = "plc"
MODELS = ("plc", "modbus_plc")
Path = tuple[str | int, ...]


# -- the description ---------------------------------------------------------------------------


def describe(mapping: PlcMapping) -> Description:
    """The description of the module, as other drivers have it."""
    about = About.model_validate(
        {
            "description": mapping.description,
            "stations": {name: each.model_dump() for name, each in mapping.stations.items()},
            "variables": {name: variable.start for name, variable in mapping.variables.items()},
            "rest": {n: v.rest for n, v in mapping.variables.items() if v.rest is not None},
            "levels": mapping.levels,
            "units": mapping.units,
            "actions": {name: _describe_action(mapping, action) for name, action in mapping.actions.items()}
            | {"reset": {"description": "Recover the PLC from an error.", "recovers": True}},
        }
    )
    found = make_description(about, KEY)
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


def _describe_action(mapping: PlcMapping, action: MappedAction) -> dict[str, Any]:
    sets = [
        {"sets": {"of": "module", "variable": name, "value": value}} for name, value in action.sets.items()
    ]
    return {
        "description": action.description,
        "args": _describe_args(mapping, action),
        "effects": [*action.effects, *sets],
        "duration": action.duration,
        "safe_to_repeat": action.safe_to_repeat or action.only_reads,
        "exclusive": not action.only_reads,
        "aliases": action.aliases,
        "result": _find_result_type(mapping, action),
    }


def _describe_args(mapping: PlcMapping, action: MappedAction) -> dict[str, dict[str, Any]]:
    """The arguments. Type, unit and limits that the mapping does not give are those of the point to which
    the argument is written."""
    found = {name: arg.model_dump(exclude_unset=True) for name, arg in action.args.items()}
    for write in _list_writes(action):
        name, point = find_argument(write.value), mapping.points.get(write.point)
        if not name or point is None:
            continue
        described: dict[str, Any] = {"type": point.value_type}
        if point.value_type != "bool":
            described |= {"unit": point.unit or "1", "minimum": point.minimum, "maximum": point.maximum}
        else:
            described["description"] = f"whether {write.point} is set"
        found[name] = described | found.get(name, {})
    return found


def _find_result_type(mapping: PlcMapping, action: MappedAction) -> str:
    if isinstance(action.result, dict):
        return "dict"
    point = mapping.points.get(action.result)
    return point.value_type if point is not None else ""


def _list_writes(action: MappedAction) -> list[Write]:
    return [*action.set, *([action.start] if action.start else [])]


# -- faults of the mapping ---------------------------------------------------------------------


def find_flaws(mapping: PlcMapping) -> Iterator[Flaw]:
    """The faults: unknown names, writes to points that cannot be written, and values that a point or a
    variable cannot have. Also conditions without a comparison, actions without a start, and bad effects."""
    for name, action in mapping.actions.items():
        yield from _find_action_flaws(mapping, name, action)
    state = mapping.state
    yield from _check_conditions(mapping, ("state", "busy"), state.busy)
    yield from _check_conditions(mapping, ("state", "error"), state.error)
    yield from _check_points(mapping, ("state", "why"), [state.why] if state.why else [])
    for code in state.codes:
        if not re.fullmatch(r"-?\d+", code):
            yield Flaw(
                ("state", "codes", code), f"{code!r} is not the number of a fault.", "Write the number."
            )
    yield from _check_writes(mapping, ("reset",), mapping.reset, ())
    yield from _check_writes(mapping, ("stop",), mapping.stop, ())
    yield from _check_points(mapping, ("boot",), [mapping.boot] if mapping.boot else [])
    for resource, point in mapping.resources.items():
        yield from _check_points(mapping, ("resources", resource), [point])
        if resource not in {**mapping.levels, **mapping.units}:
            known = {**mapping.levels, **mapping.units}
            yield Flaw(
                ("resources", resource), f"There is no level of {resource!r}.", suggest_name(resource, known)
            )
    yield from _find_variable_flaws(mapping)
    for station, conditions in mapping.labware.items():
        yield from _check_conditions(mapping, ("labware", station), conditions)
        if station not in mapping.stations:
            at = ("labware", station)
            yield Flaw(
                at, f"There is no station {station!r}.", suggest_name(station, mapping.stations, "station")
            )
    yield from _find_handshake_flaws(mapping)
    yield from _find_effect_flaws(mapping)


def _find_action_flaws(mapping: PlcMapping, name: str, action: MappedAction) -> Iterator[Flaw]:
    at: Path = ("actions", name)
    if name == "reset":
        yield Flaw(at, "`reset` cannot be one of the `actions:`.", "Write it beside `actions:`.")
    args = tuple(_describe_args(mapping, action))
    yield from _check_conditions(mapping, (*at, "needs"), action.needs)
    yield from _check_writes(mapping, (*at, "set"), action.set, args)
    if action.start is not None:
        yield from _check_write(mapping, (*at, "start"), action.start, args)
    yield from _check_conditions(mapping, (*at, "done"), action.done, args)
    yield from _check_conditions(mapping, (*at, "failed"), action.failed)
    yield from _check_points(mapping, (*at, "result"), action.result_points)
    if action.start is None and mapping.handshake is None and not action.only_reads:
        yield Flaw(at, f"The start of {name!r} is not defined.", "Write `start:`, or a `handshake:`.")
    if action.start is not None and mapping.handshake is not None:
        yield Flaw(
            (*at, "start"),
            "With a handshake, the number starts the action.",
            "Write the order below `set:`; it must move nothing before the number changes.",
        )
    yield from _find_value_flaws(mapping, (*at, "sets"), action.sets)


def _find_variable_flaws(mapping: PlcMapping) -> Iterator[Flaw]:
    for name, variable in mapping.variables.items():
        at = ("variables", name)
        yield from _check_points(mapping, (*at, "point"), [variable.point] if variable.point else [])
        for value, conditions in variable.values.items():
            yield from _check_conditions(mapping, (*at, "values", value), conditions)
        yield from _check_value(mapping, name, variable.start, (*at, "start"))
    for station, about in mapping.stations.items():
        yield from _find_value_flaws(mapping, ("stations", station, "access"), about.access)


def _find_value_flaws(mapping: PlcMapping, at: Path, values: Mapping[str, Any]) -> Iterator[Flaw]:
    for name, value in values.items():
        if name not in mapping.variables:
            known = suggest_name(name, mapping.variables, "variable")
            yield Flaw((*at, name), f"There is no variable {name!r}.", known)
        elif not find_argument(value):
            yield from _check_value(mapping, name, value, (*at, name))


def _check_value(mapping: PlcMapping, name: str, value: Any, at: Path) -> Iterator[Flaw]:
    """A variable with ``values`` can have only these values and ``otherwise``."""
    variable = mapping.variables[name]
    values = [*variable.values, variable.otherwise]
    if variable.values and value not in values:
        hint = " YAML takes on, off, yes and no for true and false: put them in quotes." * isinstance(
            value, bool
        )
        yield Flaw(at, f"{name} is never {value!r}.", f"Write one of {', '.join(map(str, values))}.{hint}")


def _find_handshake_flaws(mapping: PlcMapping) -> Iterator[Flaw]:
    if mapping.handshake is None:
        return
    for role in ("number", "taken", "done"):
        name = getattr(mapping.handshake, role)
        yield from _check_points(mapping, ("handshake", role), [name])
        point = mapping.points.get(name)
        if point is None:
            continue
        if point.kind not in ("uint16", "uint32") or point.value_type != "int":
            yield Flaw(
                ("handshake", role),
                f"{name} cannot hold the number of an attempt.",
                "Make it uint16 or uint32.",
            )
        if role == "number" and point.table != "holding":
            yield Flaw(("handshake", role), f"{name} cannot be written.", "It has to be in `holding:`.")


def _find_effect_flaws(mapping: PlcMapping) -> Iterator[Flaw]:
    try:
        describe(mapping)
    except BadEffect as error:
        at = ("actions", error.action, "effects", error.index)
        yield Flaw(at, f"In {error.action!r} {error}.", "The reference of events describes the effects.")


def _check_points(mapping: PlcMapping, at: Path, names: Iterable[str]) -> Iterator[Flaw]:
    for name in names:
        if name not in mapping.points:
            yield Flaw(at, f"There is no point {name!r}.", suggest_name(name, mapping.points, "point"))


def _check_conditions(
    mapping: PlcMapping, at: Path, conditions: Iterable[Condition], args: tuple[str, ...] = ()
) -> Iterator[Flaw]:
    for index, condition in enumerate(conditions):
        here = (*at, index, "point")
        yield from _check_points(mapping, here, [condition.point])
        point = mapping.points.get(condition.point)
        for value in (condition.is_, condition.near):
            if isinstance(value, str):
                yield from _check_argument((*at, index), value, args)
        if point is not None and condition.has_no_comparison and point.kind != "bool":
            remedy = "Write `is`, `near`, `minimum` or `maximum`."
            yield Flaw(
                here,
                f"{condition.point} is a number, but the condition has nothing to compare it with.",
                remedy,
            )
        if point is not None and point.kind == "bool" and condition.near is not None:
            yield Flaw(here, f"{condition.point} is a bit, so `near` and limits do not apply.", "Write `is`.")


def _check_writes(
    mapping: PlcMapping, at: Path, writes: Iterable[Write], args: tuple[str, ...]
) -> Iterator[Flaw]:
    for index, write in enumerate(writes):
        yield from _check_write(mapping, (*at, index), write, args)


def _check_write(mapping: PlcMapping, at: Path, write: Write, args: tuple[str, ...]) -> Iterator[Flaw]:
    yield from _check_points(mapping, (*at, "point"), [write.point])
    point = mapping.points.get(write.point)
    if point is None:
        return
    if point.table in ("discrete", "input"):
        yield Flaw((*at, "point"), f"{write.point} cannot be written.", "Use a coil or a holding register.")
    elif point.bit is not None:
        remedy = "Use a coil, or let the PLC take the whole register."
        yield Flaw((*at, "point"), f"{write.point} is a bit of a register with other bits.", remedy)
    elif isinstance(write.value, str):
        yield from _check_argument((*at, "value"), write.value, args)
    elif flaw := _explain_misfit(write.point, point, write.value):
        yield Flaw((*at, "value"), flaw, "Change the value, or the point.")


def _check_argument(at: Path, value: str, args: tuple[str, ...]) -> Iterator[Flaw]:
    name = find_argument(value)
    if name not in args:
        yield Flaw(at, f"{value!r} is neither a value nor an argument.", suggest_name(name, args, "argument"))


def _explain_misfit(name: str, point: Point, value: bool | float) -> str:
    if isinstance(value, bool) != (point.kind == "bool"):
        return f"{name} is {'a bit' if point.kind == 'bool' else 'a number'}, and cannot be {value}."
    try:
        encode(name, point, value)
    except DeviceError as error:
        return str(error)
    return ""


TABLE = DriverTable(KEY, PlcMapping, find_flaws, describe)
