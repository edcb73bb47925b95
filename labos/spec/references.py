"""References in a workflow's arguments: to the payload, and to results of earlier steps.

``payload.x``, ``payload.a.b`` and ``payload:a.b`` stand for the payload's value itself, of any type; a key
with dots (``"a.b"``) takes precedence. ``${payload.x}`` inside a longer text is replaced.
``steps.<name>.result.<field>`` stands for the result of an earlier step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from labos.errors import SpecError
from labos.spec.findings import suggest_similar

_WHOLE = re.compile(r"payload[.:]([A-Za-z_][\w.\-]*)|\$\{payload[.:]([A-Za-z_][\w.\-]*)\}")
_INSIDE = re.compile(r"\$\{payload[.:]([A-Za-z_][\w.\-]*)\}")
_SHOWN = 3
_RESULT = re.compile(r"steps\.(.+?)\.result((?:\.[\w\-]+)*)")

LONGEST = 1000
"""The most characters of a reference to a result; a longer value is a text."""


def fill(value: Any, payload: Mapping[str, Any], needed: Sequence[str] = ()) -> Any:
    """The value with its references to the payload filled in, also in lists and tables. ``needed`` are all
    keys that the workflow uses. Raises SpecError for keys that the payload does not have."""

    def fill_text(text: str) -> Any:
        whole = _WHOLE.fullmatch(text)
        if whole:
            return look_up(whole[1] or whole[2], payload, needed)
        return _INSIDE.sub(lambda match: _as_text(match[1], look_up(match[1], payload, needed)), text)

    return change_texts(value, fill_text)


def list_keys(value: Any) -> list[str]:
    """The payload's keys to which a value refers, each once."""
    found: list[str] = []
    for text in iterate_texts(value):
        whole = _WHOLE.fullmatch(text)
        found += [whole[1] or whole[2]] if whole else _INSIDE.findall(text)
    return list(dict.fromkeys(found))


def iterate_texts(value: Any) -> Iterator[str]:
    """All texts in a value, at any depth."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from iterate_texts(item)


def change_texts(value: Any, change: Callable[[str], Any]) -> Any:
    """The value with each of its texts changed, at any depth."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, list):
        return [change_texts(item, change) for item in value]
    return (
        {key: change_texts(item, change) for key, item in value.items()} if isinstance(value, dict) else value
    )


def look_up(key: str, payload: Mapping[str, Any], needed: Sequence[str] = ()) -> Any:
    """The payload's value for a key, which may be in nested tables. Raises SpecError."""
    found, value = _descend(key, payload)
    if not found:
        raise SpecError(f"The payload has no {key!r}.", remedy=_explain_how_to_give(key, payload, needed))
    return value


def _explain_how_to_give(key: str, payload: Mapping[str, Any], needed: Sequence[str]) -> str:
    """The values that the workflow needs, and how to give them; a probable typing error is named first."""
    meant = suggest_similar(key, _list_table_keys(payload))
    slip = f"{meant} " if meant else ""
    missing = [name for name in needed if not has_key(name, payload)] or [key]
    every = ", ".join(repr(name) for name in missing)
    options = " ".join(f"--payload {name}=VALUE" for name in missing[:_SHOWN])
    more = " …" if len(missing) > _SHOWN else ""
    return f"{slip}Give the payload {every}: {options}{more}, or all in a file: --payload values.yaml."


def has_key(key: str, payload: Mapping[str, Any]) -> bool:
    """Whether the payload has a value for a key."""
    return _descend(key, payload)[0]


def _descend(key: str, table: Mapping[str, Any]) -> tuple[bool, Any]:
    if key in table:
        return True, table[key]
    cut = len(key)
    while (cut := key.rfind(".", 0, cut)) > 0:
        inner = table.get(key[:cut])
        if isinstance(inner, Mapping):
            found, value = _descend(key[cut + 1 :], inner)
            if found:
                return True, value
    return False, None


def _list_table_keys(table: Mapping[str, Any], prefix: str = "") -> list[str]:
    keys: list[str] = []
    for key, value in table.items():
        keys.append(f"{prefix}{key}")
        if isinstance(value, Mapping):
            keys += _list_table_keys(value, f"{prefix}{key}.")
    return keys


def _as_text(key: str, value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str | int | float):
        return str(value)
    raise SpecError(
        f"The payload's {key!r} is neither a text nor a number and cannot be part of a text.",
        remedy="Make the reference the whole value.",
    )


def find_result(value: Any) -> tuple[str, list[str]] | None:
    """(step, fields) if the value refers to a step's result."""
    if not isinstance(value, str) or len(value) > LONGEST:
        return None
    match = _RESULT.fullmatch(value)
    return (match[1], [part for part in match[2].split(".") if part]) if match else None
