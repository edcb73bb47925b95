"""Structs with the same fields as another struct."""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

import msgspec

T = TypeVar("T", bound=msgspec.Struct)


def make_from(kind: type[T], source: object, /, **others: Any) -> T:
    """A struct with the values of the fields of the same names in ``source``. The fields ``others`` are given
    instead. A field that ``source`` does not have takes its default. Raises TypeError if it has none."""
    given = tuple(others)
    is_struct = isinstance(source, msgspec.Struct)
    origin: Any = type(source) if is_struct else source
    names = (_list_known if is_struct else _list_shared)(kind, origin, given)
    for name in names:
        others[name] = getattr(source, name)
    return kind(**others)


def _list_shared(kind: type[msgspec.Struct], source: object, given: tuple[str, ...]) -> tuple[str, ...]:
    """The fields of a struct that a source has too, and that are not given."""
    return tuple(name for name in kind.__struct_fields__ if name not in given and hasattr(source, name))


@cache
def _list_known(
    kind: type[msgspec.Struct], source: type[msgspec.Struct], given: tuple[str, ...]
) -> tuple[str, ...]:
    """The same for all structs of a type, computed once."""
    return _list_shared(kind, source, given)
