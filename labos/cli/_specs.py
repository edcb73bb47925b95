"""Specs that a person names on the command line."""

from __future__ import annotations

from pathlib import Path

from labos.errors import NotFound
from labos.spec import find_spec, list_specs


def find_spec_path(kind: str, name: str) -> Path:
    """The file at this path if there is one, else the packaged spec of that name. Raises NotFound."""
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
