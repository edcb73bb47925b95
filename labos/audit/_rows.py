"""Rows in memory, between the events that change them and the database that stores them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from labos.audit._columns import Kind
from labos.audit.tables import TABLES, Table
from labos.core.registry import TYPES, Event

Key = tuple[Any, ...]
Row = dict[str, Any]
"""A row by column. A JSON column has the value itself here."""

Load = Callable[[Table, Key], "Row | None"]

MOST_KEPT = 200_000
"""The largest number of rows in memory between batches; above it all are dropped, and loaded again when they
are needed."""


_NOTHING: dict[Kind, Any] = {"text": "", "flag": False, "json": {}, "time": None, "integer": 0, "number": 0.0}
_ABSENT = {table.name: {c.stored: _NOTHING[c.kind] for c in table.columns} for table in TABLES}
_EMPTY: dict[str, Row] = {table.name: {c.stored: c.empty for c in table.columns} for table in TABLES}


@cache
def _list_shared_columns(table: str, event: str) -> tuple[str, ...]:
    """The columns of a table that are fields of a type of event, too."""
    fields = TYPES[event].__struct_fields__ if event else ()
    return tuple(name for name in _EMPTY[table] if name in fields)


def convert_to_seconds(ns: int) -> float:
    """A time in seconds since 1970, to the millisecond, which every database writes in the same way."""
    return ns // 1_000_000 / 1000


class RowChanges:
    """The changes of rows by a batch of events. New and changed rows are written at its end."""

    def __init__(self, load: Load) -> None:
        self._load = load
        self._known: defaultdict[str, dict[Key, Row]] = defaultdict(dict)
        self._changed: defaultdict[str, dict[Key, Row]] = defaultdict(dict)
        self._added: defaultdict[str, list[Key]] = defaultdict(list)
        self.may_have_nul = False
        """Whether a text of the batch may contain a NUL character."""

    def add(self, table: Table, *values: Any) -> None:
        """Add a row, in the order of its columns, to a table that only grows."""
        self._added[table.name].append(values)

    def put(self, table: Table, event: Event | None = None, /, **columns: Any) -> Row:
        """Add a new row, or replace one. A column that is not named gets the field of the ``event`` with its
        name; it is empty if there is no such field."""
        shared = _list_shared_columns(table.name, event.TYPE if event is not None else "")
        from_event = {name: getattr(event, name) for name in shared}
        row = {**_EMPTY[table.name], **from_event, **columns}
        key = tuple(row[name] for name in table.key)
        self._known[table.name][key] = self._changed[table.name][key] = row
        return row

    def get(self, table: Table, *key: Any) -> Row:
        """A row for reading. A row that does not exist is empty, its key too: its numbers are 0."""
        known = self._known[table.name]
        row = known.get(key)
        if row is None and "" not in key:
            row = self._load(table, key)
            if row is not None:
                known[key] = row
        return dict(_ABSENT[table.name]) if row is None else row

    def change(self, table: Table, *key: Any) -> Row:
        """A row for changing. Changes of a row that does not exist are not kept."""
        row = self.get(table, *key)
        if key in self._known[table.name]:
            self._changed[table.name][key] = row
        return row

    def update(self, table: Table, *key: Any, **values: Any) -> Row:
        """Change columns of a row, as ``change``."""
        row = self.change(table, *key)
        row.update(values)
        return row

    def list_added(self) -> Iterator[tuple[Table, list[Key]]]:
        for table in TABLES:
            if table.name in self._added:
                yield table, self._added[table.name]

    def list_changed(self) -> Iterator[tuple[Table, list[Row]]]:
        for table in TABLES:
            if table.name in self._changed:
                yield table, list(self._changed[table.name].values())

    def mark_written(self) -> None:
        """Record that everything is in the database."""
        self.may_have_nul = False
        self._changed.clear()
        self._added.clear()
        if sum(map(len, self._known.values())) > MOST_KEPT:
            self.forget()

    def forget(self) -> None:
        """Drop all rows, because another process may have changed the database, or nothing was written."""
        self._known.clear()
        self._changed.clear()
        self._added.clear()
