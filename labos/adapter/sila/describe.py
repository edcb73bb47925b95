"""A server's features in LabOS' words, and LabOS' names in the server's."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
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
    """``OpenDoor`` is ``open_door`` here."""
    return _WORD_ENDS.sub("_", theirs).lower()


def alike(name: str) -> str:
    """What is left of a name for comparison: ``open_door``, ``OpenDoor`` and ``Door.Open``'s own form."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def find_command(features: Iterable[Feature], name: str) -> SilaCommand | None:
    """The command that a name means: ``Feature.Command``, or ``Command`` where one feature only has it, in
    any way of writing; or the whole identifier ``originator/category/Feature/v1/Command/Command``."""
    offered = list(features)
    commands = [command for feature in offered for command in feature.commands]
    for meant in (
        [
            told
            for each in offered
            for told in each.commands
            if f"{each.identifier}/Command/{told.name}" == name
        ],
        [command for command in commands if command.full_name == name],
        [command for command in commands if alike(command.full_name) == alike(name)],
        [command for command in commands if alike(command.name) == alike(name)],
    ):
        if len(meant) == 1:
            return meant[0]
    return None


def find_property(features: Iterable[Feature], name: str) -> tuple[Property, list[str]] | None:
    """The property that ``Feature.Property`` names, and the elements of its structure that follow."""
    feature, _, rest = name.partition(".")
    wanted, *elements = rest.split(".")
    for each in features:
        for told in each.properties:
            if (each.name, told.name) == (feature, wanted):
                return told, elements
    return None


def actions_of(features: Iterable[Feature]) -> tuple[ActionSpec, ...]:
    """What a server's commands are as actions, without effects, and SiLA's names as aliases, which are those
    in MADSci's workflows. Commands that SiLA defines for all servers are left out."""
    offered = [feature for feature in features if not feature.is_standard]
    names = Counter(command.name for feature in offered for command in feature.commands)
    return tuple(
        ActionSpec(
            name=our_name(command.name if names[command.name] == 1 else f"{feature.name}{command.name}"),
            description=command.description,
            args=tuple(_arg(feature, element) for element in command.parameters),
            aliases=(command.full_name,),
            result="any" if command.responses else "",
        )
        for feature in offered
        for command in feature.commands
    )


def _arg(feature: Feature, element: Element) -> Arg:
    types = {told.name: told.type for told in feature.types}
    layers = list(unwrap(element.type, types))
    limits = [told.limits for told in layers if isinstance(told, Constrained)]
    lows = [each.minimum for each in limits if each.minimum is not None]
    highs = [each.maximum for each in limits if each.maximum is not None]
    kind = _kind(layers[-1])
    return Arg(
        name=our_name(element.name),
        type=kind,
        aliases=() if our_name(element.name) == element.name else (element.name,),
        unit=next((each.unit for each in limits if each.unit), ""),
        minimum=max(lows, default=None),
        maximum=min(highs, default=None),
        choices=_choices(kind, limits),
        description=element.description,
    )


def _kind(told: Any) -> str:
    match told:
        case Basic():
            return _KINDS.get(told.name, "str")  # dates and times are written as in ISO 8601
        case ListOf():
            return "list"
        case Structure():
            return "dict"
    return "any"


def _choices(kind: str, limits: list[Limits]) -> tuple[Any, ...]:
    """Values that are allowed, as they are written in a workflow."""
    written = next((each.choices for each in limits if each.choices), ())
    of = {"int": int, "float": float}.get(kind, str)
    return tuple(of(value) for value in written)
