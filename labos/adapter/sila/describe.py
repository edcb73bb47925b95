"""Converts a server's features to a LabOS description, and LabOS' names to the server's names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from labos.adapter.sila.features import (
    Basic,
    Constrained,
    Element,
    Feature,
    Limits,
    ListOf,
    Property,
    SilaCommand,
    Structure,
    unwrap,
)
from labos.core.model import ActionSpec, Arg

_WORD_ENDS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_KINDS = {
    "String": "str",
    "Integer": "int",
    "Real": "float",
    "Boolean": "bool",
    "Binary": "file",
    "Any": "any",
}


def our_name(theirs: str) -> str:
    """The LabOS name: ``open_door`` for ``OpenDoor``."""
    return _WORD_ENDS.sub("_", theirs).lower()


def simplify_name(name: str) -> str:
    """A name in a form for comparison, which is the same for ``open_door`` and ``OpenDoor``."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def find_command(features: Iterable[Feature], name: str) -> SilaCommand | None:
    """Find a command by name: ``Feature.Command``, or ``Command`` if only one feature has it, in any
    spelling; or the full identifier ``originator/category/Feature/v1/Command/Command``."""
    offered = [(feature, command) for feature in features for command in feature.commands]
    ways_to_name: tuple[Callable[[Feature, SilaCommand], bool], ...] = (
        lambda feature, command: f"{feature.identifier}/Command/{command.name}" == name,
        lambda _, command: command.full_name == name,
        lambda _, command: simplify_name(command.full_name) == simplify_name(name),
        lambda _, command: simplify_name(command.name) == simplify_name(name),
    )
    for is_named in ways_to_name:
        meant = [command for feature, command in offered if is_named(feature, command)]
        if len(meant) == 1:
            return meant[0]
    return None


def find_property(features: Iterable[Feature], name: str) -> tuple[Property, list[str]] | None:
    """Find the property ``Feature.Property``, and the elements of its structure that follow."""
    feature, _, rest = name.partition(".")
    wanted, *elements = rest.split(".")
    for each in features:
        for property_ in each.properties:
            if (each.name, property_.name) == (feature, wanted):
                return property_, elements
    return None


def actions_of(features: Iterable[Feature]) -> tuple[ActionSpec, ...]:
    """A server's commands as actions, without effects. SiLA's names, which MADSci's workflows use, are
    aliases. Commands that SiLA defines for all servers are left out."""
    offered = [feature for feature in features if not feature.is_standard]
    names = Counter(command.name for feature in offered for command in feature.commands)
    return tuple(
        ActionSpec(
            name=our_name(command.name if names[command.name] == 1 else f"{feature.name}{command.name}"),
            description=command.description,
            args=tuple(_make_arg(feature, element) for element in command.parameters),
            aliases=(command.full_name,),
            result="any" if command.responses else "",
        )
        for feature in offered
        for command in feature.commands
    )


def _make_arg(feature: Feature, element: Element) -> Arg:
    types = {named.name: named.type for named in feature.types}
    layers = list(unwrap(element.type, types))
    limits = [layer.limits for layer in layers if isinstance(layer, Constrained)]
    lows = [each.minimum for each in limits if each.minimum is not None]
    highs = [each.maximum for each in limits if each.maximum is not None]
    kind = _find_kind(layers[-1])
    return Arg(
        name=our_name(element.name),
        type=kind,
        aliases=() if our_name(element.name) == element.name else (element.name,),
        unit=next((each.unit for each in limits if each.unit), ""),
        minimum=max(lows, default=None),
        maximum=min(highs, default=None),
        choices=_list_choices(kind, limits),
        description=element.description,
    )


def _find_kind(data_type: Any) -> str:
    match data_type:
        case Basic():
            return _KINDS.get(data_type.name, "str")  # dates and times are written as in ISO 8601
        case ListOf():
            return "list"
        case Structure():
            return "dict"
    return "any"


def _list_choices(kind: str, limits: list[Limits]) -> tuple[Any, ...]:
    """The allowed values, in the form in a workflow."""
    written = next((each.choices for each in limits if each.choices), ())
    of = {"int": int, "float": float}.get(kind, str)
    return tuple(of(value) for value in written)
