"""Files and values that a person names on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import msgspec

from labos.core.model import Description
from labos.errors import BadInput, NotFound
from labos.spec import find_spec, list_specs


def driver_descriptions() -> dict[str, Description]:
    """What every installed driver says of itself; one that cannot be loaded is left out."""
    found: dict[str, Description] = {}
    for entry in entry_points(group="labos.drivers"):
        try:
            found[entry.name] = entry.load().describe()
        except Exception:  # noqa: S112, BLE001, RUF100 - a third party's driver may break in any way
            continue
    return found


def spec_path(kind: str, name: str) -> Path:
    """A file if there is one of that path, else the packaged spec of that name. Raises NotFound."""
    path = Path(name)
    if path.is_file():
        return path
    try:
        return find_spec(kind, name)
    except NotFound:
        known = ", ".join(list_specs(kind))
        raise NotFound(
            f"There is neither a file nor a packaged {kind.removesuffix('s')} {name!r}.",
            remedy=f"Packaged are: {known}.",
        ) from None


def read_payload(parts: Sequence[str]) -> dict[str, Any]:
    """A payload from files (YAML or JSON), JSON texts and ``key=value`` pairs, later ones first
    in rank. Values that are JSON keep their types. Raises BadInput."""
    payload: dict[str, Any] = {}
    for part in parts:
        payload |= _part(part)
    return payload


def _part(text: str) -> dict[str, Any]:
    if text.lstrip().startswith("{"):
        return _table(_decoded(text.encode(), "The payload"), "The payload")
    key, equals, value = text.partition("=")
    if equals and not Path(text).is_file():
        try:
            return {key.strip(): msgspec.json.decode(value)}
        except msgspec.MsgspecError:
            return {key.strip(): value}
    try:
        content = Path(text).read_bytes()
    except OSError as error:
        raise BadInput(
            f"The payload file {text!r} cannot be read ({error.strerror or error}).",
            remedy="Give a file, a JSON table, or key=value.",
        ) from None
    return _table(_decoded(content, text), text)


def _decoded(content: bytes, name: str) -> Any:
    try:
        return msgspec.yaml.decode(content) if name != "The payload" else msgspec.json.decode(content)
    except (msgspec.MsgspecError, ValueError) as error:
        raise BadInput(f"{name} cannot be read: {error}.", remedy="Write a table as JSON or YAML.") from None


def _table(value: Any, name: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise BadInput(f"{name} holds no table.", remedy='Write {"key": value}.')
    return {str(key): item for key, item in value.items()}
