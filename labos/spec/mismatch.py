"""Explains in LabOS' words why a value does not fit a model, instead of the messages of validation
libraries."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import msgspec

_TYPES = {
    "string": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "dict": "a table of keys and values",
    "mapping": "a table of keys and values",
    "model": "a table of keys and values",
    "model_attributes": "a table of keys and values",
    "list": "a list",
    "tuple": "a list",
    "set": "a list",
}

_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}

_LENGTHS = {
    "too_short": ("min_length", "at least", "entry", "entries"),
    "too_long": ("max_length", "at most", "entry", "entries"),
    "string_too_short": ("min_length", "at least", "character", "characters"),
    "string_too_long": ("max_length", "at most", "character", "characters"),
}

_WHOLE = {
    "missing": "is missing",
    "extra_forbidden": "is not known here",
    "int_from_float": "should be a whole number",
    "finite_number": "should be a finite number",
    "none_required": "should be left empty",
    "string_pattern_mismatch": "is not written as it should be",
}

OTHERWISE = "is not what can stand here"


def describe_mismatch(error: Any) -> str:
    """The end of a sentence about a value: ``should be a whole number``. ``error`` is one of pydantic's."""
    kind: str = error["type"]
    context: dict[str, Any] = error.get("ctx") or {}
    if kind in _WHOLE:
        return _WHOLE[kind]
    base, _, how = kind.rpartition("_")
    if how in ("type", "parsing") and base in _TYPES:
        return f"should be {_TYPES[base]}"
    if kind in _BOUNDS:
        key, words = _BOUNDS[kind]
        return f"should be {words} {context[key]}"
    if kind in _LENGTHS:
        key, words, one, many = _LENGTHS[kind]
        limit = context[key]
        return f"should have {words} {limit} {one if limit == 1 else many}"
    if kind == "literal_error":
        return f"should be {context['expected']}"
    if kind == "value_error":
        return f"cannot be used: {context['error']}"
    return OTHERWISE


_KINDS = {
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "object": "a table of keys and values",
    "array": "a list",
    "null": "nothing",
}

_SENTENCES = (
    (re.compile(r"Object missing required field `(.+)`"), "{0!r} is missing"),
    (re.compile(r"Object contains unknown field `(.+)`", re.DOTALL), "{0!r} is not known here"),
    (re.compile(r"Invalid value '(.*)'"), "{0!r} is not known here"),
    (re.compile(r"Invalid enum value '(.*)'"), "{0!r} is not one of the choices"),
)
_LENGTH = re.compile(r"Expected `(str|array|object|bytes)` of length (<=|>=) (\d+)")
_BOUND = re.compile(r"Expected `(int|float)` (<=|>=|<|>) (\S+)")
_FORM = re.compile(r"Expected `str` matching regex (.+)")
_COMPARED = {"<=": "at most", ">=": "at least", "<": "less than", ">": "more than"}
_COUNTED = {"str": "characters", "bytes": "bytes"}
_EXPECTED = re.compile(r"Expected `([^`]+)`, got `([^`]+)`")


def explain_plainly(error: msgspec.MsgspecError, forms: Mapping[str, str] = {}) -> str:
    """The fault that msgspec reports, as part of a sentence; its messages about broken JSON are not changed.
    ``forms`` explain, by pattern, the fault of a text that does not match."""
    text, at, where = str(error).partition(" - at `")
    where = where.rstrip("`").removeprefix("key` in `").removeprefix("$").lstrip(".")
    place = f" in {where}" if at and where else ""
    limited = _describe_limit(text, place.removeprefix(" in ") or "it", forms)
    if limited:
        return limited
    for pattern, sentence in _SENTENCES:
        found = pattern.fullmatch(text)
        if found:
            return sentence.format(*found.groups()) + place
    found = _EXPECTED.fullmatch(text)
    if found:
        wanted = " or ".join(_KINDS.get(part.strip(), part.strip()) for part in found[1].split("|"))
        return (
            f"{place.removeprefix(' in ') or 'it'} should be {wanted}, not {_KINDS.get(found[2], found[2])}"
        )
    return text + place


def _describe_limit(text: str, what: str, forms: Mapping[str, str]) -> str:
    """The fault of a value that is too long, too large, or not of the form; empty for other faults."""
    if found := _LENGTH.fullmatch(text):
        return f"{what} should have {_COMPARED[found[2]]} {found[3]} {_COUNTED.get(found[1], 'entries')}"
    if found := _BOUND.fullmatch(text):
        return f"{what} should be {_COMPARED[found[2]]} {found[3]}"
    if found := _FORM.fullmatch(text):
        known = (words for pattern, words in forms.items() if found[1] in (pattern, repr(pattern)))
        return f"{what} {next(known, _WHOLE['string_pattern_mismatch'])}"
    return ""
