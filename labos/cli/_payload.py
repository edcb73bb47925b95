"""Payloads on the command line: a file, JSON, or ``key=value``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from labos.errors import BadInput, SpecError

payload_option = click.option(
    "--payload",
    "-p",
    "payloads",
    multiple=True,
    metavar="FILE|JSON|K=V",
    help="Values for the run; may be repeated, later ones win. `seal.time=3` sets a nested one.",
)


def read_payload(given: Sequence[str]) -> dict[str, Any]:
    """The merged payloads: a later value replaces an earlier one. Raises BadInput, SpecError."""
    values: dict[str, Any] = {}
    for text in given:
        _lay_over(values, _read_payload(text))
    return values


def _read_payload(text: str) -> dict[str, Any]:
    if text.lstrip().startswith("{"):
        return _table(text, "--payload")
    path = Path(text)
    if path.is_file():
        return _table(path.read_text(encoding="utf-8"), str(path))
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise BadInput(
            f"--payload {text!r} is neither a file, nor JSON, nor key=value.",
            remedy="Write --payload values.yaml, --payload '{\"x\": 1}' or --payload x=1.",
        )
    found = read_value(value)
    for part in reversed(key.strip().split(".")):
        found = {part: found}
    assert isinstance(found, dict)
    return found


def read_value(text: str) -> Any:
    """A value as in a workflow file; what is not YAML is text."""
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return text


def _table(text: str, name: str) -> dict[str, Any]:
    from labos.spec.source import make_plain, parse

    data = make_plain(parse(text, name).data)
    if not isinstance(data, dict):
        raise SpecError("The payload is not a table of keys and values.", file=name)
    return data


def _lay_over(base: dict[str, Any], over: dict[str, Any]) -> None:
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(base.get(key), dict):
            _lay_over(base[key], value)
        else:
            base[key] = value
