"""Checks data against a model, and reports the faults in LabOS' words, with places."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from labos.spec.findings import MOST, FindingList, Remarks, SpecErrors, suggest_name
from labos.spec.mismatch import describe_mismatch
from labos.spec.source import Source, make_plain

M = TypeVar("M", bound=BaseModel)


def validate(model: type[M], source: Source, report: FindingList) -> M | None:
    """The file as a model; None, with errors in the report, if it does not fit."""
    try:
        return model.model_validate(make_plain(source.data))
    except ValidationError as errors:
        found = errors.errors(include_url=False)[:MOST]
        for error in found:
            if not _is_misspelt(error, found):
                _translate(model, source, report, error)
        return None


def expect_valid(model: type[M], source: Source, report: FindingList) -> M:
    """The same for a file that is indispensable. Raises SpecErrors."""
    file = validate(model, source, report)
    if file is None:
        raise SpecErrors(report.sort_findings())
    return file


def find_first_flaw(model: type[BaseModel], table: Any) -> str:
    """The first fault of a table below ``config:``, as text after ``In `table:` ``; empty if it has none."""
    try:
        model.model_validate(table)
    except ValidationError as errors:
        return describe_flaw(errors)
    return ""


def describe_flaw(errors: ValidationError) -> str:
    """The first of these errors, with its place."""
    first = errors.errors(include_url=False)[0]
    where = ".".join(map(str, first["loc"])) or "the table"
    if first["type"] == "value_error":
        return f"{where}: {first['msg'].removeprefix('Value error, ')}"
    return f"{where}: {describe_mismatch(first)}"


def _is_misspelt(error: Any, others: Sequence[Any]) -> bool:
    """Whether a key is missing only because of a typing error."""
    *table, key = error["loc"]
    beside = [
        str(other["loc"][-1]).lower()
        for other in others
        if other["type"] == "extra_forbidden" and [*other["loc"][:-1]] == table
    ]
    return error["type"] == "missing" and bool(difflib.get_close_matches(str(key), beside))


def _translate(model: type[BaseModel], source: Source, report: FindingList, error: Any) -> None:
    path = _keep_existing(source, error["loc"], error["type"])
    context: dict[str, Any] = error.get("ctx") or {}
    unknown, remedy = error["type"] == "extra_forbidden", "Change the value."
    match error["type"]:
        case "extra_forbidden":
            message = f"The key {path[-1]!r} is not known here."
            remedy = suggest_name(str(path[-1]), _list_keys_at(model, path[:-1]), "key")
        case "missing":
            message, remedy = f"The key {path[-1]!r} is missing.", f"Add `{path[-1]}:`."
        case "value_error":
            message = f"{context['error']}.".capitalize()
        case "literal_error":
            message, remedy = (
                f"{error['input']!r} is not one of the choices.",
                f"Write {context['expected']}.",
            )
        case "string_pattern_mismatch":
            message = f"{error['input']!r} cannot be a name."
            remedy = "Use letters, digits, '_', '-' and spaces, beginning with a letter or digit."
        case _:
            value = _shorten_value(error["input"])
            message = f"The value {value} does not fit: it {describe_mismatch(error)}."
    Remarks(source, report).error(message, path, remedy, key=unknown)


def _keep_existing(source: Source, loc: Sequence[int | str], kind: str) -> tuple[int | str, ...]:
    """The error's path without the parts that pydantic adds for unions and for keys."""
    path: list[int | str] = []
    here: Any = source.data
    for position, part in enumerate(loc):
        last = position == len(loc) - 1
        if isinstance(here, dict) and part in here:
            path.append(part)
            here = here[str(part)]
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            path.append(part)
            here = here[part]
        elif last and kind == "missing":
            path.append(part)
    return tuple(path)


def _list_keys_at(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """The keys that a model knows at a path."""
    here: Any = model
    for part in path:
        if isinstance(here, type) and issubclass(here, BaseModel) and isinstance(part, str):
            here = here.model_fields[part].annotation if part in here.model_fields else None
        else:
            here = next((arg for arg in typing.get_args(here)[-1:]), None)
        here = _find_model(here)
    return list(here.model_fields) if isinstance(here, type) and issubclass(here, BaseModel) else []


def _find_model(hint: Any) -> Any:
    if typing.get_origin(hint) is typing.Annotated:
        return _find_model(typing.get_args(hint)[0])
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        options = [_find_model(option) for option in typing.get_args(hint) if option is not type(None)]
        models = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
        return models[0] if models else options[0]
    return hint


def _shorten_value(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"
