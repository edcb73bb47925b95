"""The common parts of the models of all files."""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from labos.spec.durations import parse_duration

Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ ()\-]*$")]
"""The name of a workcell or module. It becomes part of keys and stations, so it must not contain ``/`` or
``.``."""

Label = Annotated[str, Field(min_length=1, max_length=256)]
Seconds = Annotated[float, BeforeValidator(parse_duration, json_schema_input_type=float | str)]
Version = Annotated[Literal[1], Field(description="version of this language; marks a file as LabOS' own")]
Comment = Annotated[str, Field(description="for people")]
Aliases = Annotated[list[str], Field(description="other names")]

T = TypeVar("T")
Many = Annotated[list[T], BeforeValidator(lambda value: [value] if isinstance(value, dict) else value)]
"""One value, or a list of them."""


class Part(BaseModel):
    """Base of every part: strict types, no unknown keys. A field's docstring is its text in the schema."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, use_attribute_docstrings=True)
