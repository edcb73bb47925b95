"""Structs that say what another one says."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec

T = TypeVar("T", bound=msgspec.Struct)


def make_from(kind: type[T], source: object, /, **others: Any) -> T:
    """A struct whose fields are those of the same names of ``source``, but for the ``others``, which are
    given. What ``source`` does not have takes its default. Raises TypeError where there is none."""
    names = [name for name in kind.__struct_fields__ if name not in others and hasattr(source, name)]
    return kind(**{name: getattr(source, name) for name in names}, **others)
