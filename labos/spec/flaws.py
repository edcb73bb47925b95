"""The faults of a table below ``config:``, as texts after ``In `table:` ``."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from labos.spec.mismatch import describe_mismatch
from labos.spec.parts import Part


def find_first_flaw(model: type[Part], table: Any) -> str:
    """The first fault of a table; empty if it has none."""
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
