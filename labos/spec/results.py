"""Checks whether the result of a step fits the argument of another step, as far as both actions declare their
types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.core.ids import ModuleName
from labos.core.model import ActionSpec, Description, Plan
from labos.spec.findings import Remarks

FITS = {
    "str": {"str"},
    "station": {"str"},
    "file": {"dict"},
    "int": {"int"},
    "float": {"int", "float"},
    "bool": {"bool"},
    "list": {"list"},
    "dict": {"dict"},
}
"""The types that an argument accepts. A type that is not here accepts any."""

WORDS = {
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "list": "a list",
    "dict": "a mapping",
    "station": "the name of a station",
    "file": "the name of a file",
}

WHOLE = {"str", "int", "float", "bool"}
"""Results without fields."""


def check_results(plan: Plan, described: Mapping[ModuleName, Description], remarks: Remarks) -> None:
    """Report each argument that gets a result of another type. A result that its action does not declare may
    be of any type; so may a field of it."""
    actions: dict[int, ActionSpec] = {}
    for index, step in enumerate(plan.steps):
        spec = described[step.module].action(step.action) if step.module in described else None
        if spec is not None:
            actions[index] = spec
    for index, step in enumerate(plan.steps):
        for name, value in step.args.items():
            reference = value.get("$result") if isinstance(value, dict) else None
            if not reference or index not in actions:
                continue
            source, *fields = reference
            returned = actions[source].result if source in actions else ""
            arg = next((arg for arg in actions[index].args if arg.name == name), None)
            wrong = _find_flaw(returned, fields, arg.type if arg is not None else "")
            if wrong:
                giver = plan.steps[source]
                remarks.error(
                    f"Step {step.key!r}: the result of {giver.key!r} ({giver.action}) is {WORDS[returned]}, "
                    f"and {wrong}.",
                    ("steps", index, "args", name),
                    "Name a result that fits, or write the value itself.",
                )


def _find_flaw(returned: str, fields: list[Any], wanted: str) -> str:
    if fields:
        return "has no fields" if returned in WHOLE else ""
    if returned in WORDS and wanted in FITS and returned not in FITS[wanted]:
        return f"the argument takes {WORDS[wanted]}"
    return ""
