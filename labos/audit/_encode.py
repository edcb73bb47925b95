"""Conversion of values for databases."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import Any

import msgspec

from labos.audit._rows import Key, Row
from labos.audit.tables import TABLES, Table

_NUL, _SHOWN = "\0", "\N{SYMBOL FOR NULL}"
_encode = msgspec.json.Encoder(order="sorted").encode

_JSON = {
    table.name: [at for at, column in enumerate(table.columns) if column.kind == "json"] for table in TABLES
}
_IN_ORDER: dict[str, Callable[[Row], tuple[Any, ...]]] = {
    table.name: itemgetter(*table.stored) for table in TABLES
}


def encode_rows(table: Table, rows: Iterable[Row], *, nul: bool) -> list[Sequence[Any]]:
    """Rows in the form for the database; see ``encode_values``."""
    in_order = _IN_ORDER[table.name]
    return encode_values(table, [in_order(row) for row in rows], nul=nul)


def encode_values(table: Table, rows: list[Key], *, nul: bool) -> list[Sequence[Any]]:
    """The same for rows with values in the order of their columns. PostgreSQL cannot store a NUL character:
    it is replaced by the symbol for NUL."""
    at = _JSON[table.name]
    made: list[Sequence[Any]] = list(rows)
    if at:
        made = [_with_json(values, at) for values in rows]
    return [[_show(value) for value in values] for values in made] if nul else made


def decode_row(table: Table, values: Any) -> Row:
    """A row from the database."""
    found = list(values)
    for at in _JSON[table.name]:
        found[at] = None if found[at] is None else msgspec.json.decode(found[at])
    return dict(zip(table.stored, found, strict=True))


def _with_json(values: Key, at: list[int]) -> list[Any]:
    made = list(values)
    for number in at:
        value = made[number]
        made[number] = None if value is None else _encode(value).decode()
    return made


def _show(value: Any) -> Any:
    return value.replace(_NUL, _SHOWN).replace("\\u0000", _SHOWN) if isinstance(value, str) else value
