"""The calls of a driver that are tried: those that its author gives, otherwise those that follow from
``about``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from labos.core.effects import Sets, list_carried
from labos.core.model import ActionSpec, Arg, Description
from labos.node.torture import Case, Torture
from labos.torture.bench import find_name

PLACES = {"source": "bench.source", "target": "bench.target"}


def cases_of(about: Description, torture: Torture, folder: Path) -> list[Case]:
    """At least one case for each action except ``reset``, in the order of the description."""
    found: list[Case] = []
    for spec in about.actions:
        if spec.name == "reset":
            continue
        names = (spec.name, *spec.aliases)
        given = [case for case in torture.cases if case.action in names] or [Case(spec.name)]
        found += [_fill(case, spec, folder) for case in given]
    return found


def find_unknown_cases(about: Description, torture: Torture) -> list[str]:
    """The actions in given cases that the driver does not have."""
    return [case.action for case in torture.cases if about.action(case.action) is None]


def _fill(case: Case, spec: ActionSpec, folder: Path) -> Case:
    files = {name: _write(folder / file, text) for name, (file, text) in case.files.items()}
    given = {find_name(spec, name) for name in (*case.args, *files)}
    args = {
        **{
            arg.name: _make_example(arg, folder)
            for arg in spec.args
            if arg.required and arg.name not in given
        },
        **case.args,
        **files,
    }
    return msgspec.structs.replace(case, action=spec.name, args=args)


def _make_example(arg: Arg, folder: Path) -> Any:
    if arg.choices:
        return arg.choices[0]
    match arg.type:
        case "int" | "float":
            low, high = arg.minimum, arg.maximum
            value = low if low is not None else min(1.0, high) if high is not None else 1.0
            return int(value) if arg.type == "int" else float(value)
        case "bool":
            return True
        case "list":
            return []
        case "dict":
            return {}
        case "station":
            return PLACES.get(arg.name, f"bench.{arg.name}")
        case "file":
            return _write(folder / f"{arg.name}.yaml", "metadata: {name: an example}\n")
    return "example"


def _write(path: Path, text: str) -> str:
    path.write_bytes(text.encode())
    return str(path)


def list_wrong_args(case: Case, spec: ActionSpec) -> Iterator[tuple[str, dict[str, Any]]]:
    """Calls that must be refused, each with its error."""
    args = {find_name(spec, name): value for name, value in case.args.items()}
    yield "an argument that there is none of", {**args, "no_such_argument": 1}
    for arg in spec.args:
        if arg.required:
            yield f"{arg.name} left out", {name: v for name, v in args.items() if name != arg.name}
        if arg.minimum is not None:
            yield f"{arg.name} below its minimum", {**args, arg.name: _exceed_limit(arg, arg.minimum, -1)}
        if arg.maximum is not None:
            yield f"{arg.name} above its maximum", {**args, arg.name: _exceed_limit(arg, arg.maximum, 1)}
        if arg.choices:
            yield f"{arg.name} that is none of its choices", {**args, arg.name: "none of these"}
        if (wrong := _OTHER_TYPES.get(arg.type)) is not None:
            yield f"{arg.name} of another type", {**args, arg.name: wrong}


_OTHER_TYPES: dict[str, Any] = {
    "int": "many",
    "float": "much",
    "bool": "perhaps",
    "str": 7,
    "list": 7,
    "dict": 7,
    "station": 7,
    "file": 7,
}


def _exceed_limit(arg: Arg, limit: float, side: int) -> float:
    return int(limit) + side if arg.type == "int" else limit + side * max(abs(limit), 1.0) * 0.01


def moves_labware(spec: ActionSpec) -> bool:
    return bool(list_carried(spec.effects))


def works_a_gate(spec: ActionSpec) -> bool:
    """Whether the effect of the action is visible in a variable of the module, such as the position of a
    lid."""
    return any(isinstance(effect, Sets) and effect.of == "module" for effect in spec.effects)
