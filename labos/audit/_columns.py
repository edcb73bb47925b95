"""Columns of tables, and columns that many tables have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import msgspec

Kind = Literal["text", "integer", "number", "flag", "json", "time"]


class Column(msgspec.Struct, frozen=True):
    """``time`` is stored as seconds since 1970 in a column ``…_s``; its view has both this number and a
    readable time. ``flag`` is 0 or 1. ``by_people``: it may contain words that may have to be erased."""

    name: str
    kind: Kind
    about: str
    by_people: bool = False

    @property
    def stored(self) -> str:
        return f"{self.name}_s" if self.kind == "time" else self.name

    @property
    def empty(self) -> str | bool | None:
        """The value of the column if nothing is known."""
        return "" if self.kind == "text" else False if self.kind == "flag" else None


class Table(msgspec.Struct, frozen=True):
    """``view`` is the name of its view (empty: none). ``indexes`` are lists of stored columns. ``searched``
    is a column of words for the search (empty: none); the key of such a table is one whole number."""

    name: str
    about: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    view: str = ""
    indexes: tuple[tuple[str, ...], ...] = ()
    searched: str = ""

    @property
    def stored(self) -> tuple[str, ...]:
        """The names of its columns in the database."""
        return tuple(column.stored for column in self.columns)


def _make_kind(kind: Kind) -> Callable[[str, str], Column]:
    return lambda name, about: Column(name, kind, about)


text, whole, number = _make_kind("text"), _make_kind("integer"), _make_kind("number")
flag, json, time = _make_kind("flag"), _make_kind("json"), _make_kind("time")


def make_words_column(name: str, about: str) -> Column:
    """A text column that may contain people's words."""
    return Column(name, "text", about, by_people=True)


POSITION = whole("position", "Its position in the log.")
AT = time("at", "The time at which it was recorded.")
RUN = text("run", "The run during which it happened; empty if none.")
ACTION = text("action", "The action that caused it; empty if none.")
LABWARE = text("labware", "The labware's id.")
MODULE = text("module", "The module, as `workcell/module`.")


def list_view_columns(table: Table) -> tuple[Column, ...]:
    """The columns of its view; a time has two columns, a readable one and a number."""
    found: list[Column] = []
    for column in table.columns:
        found.append(column)
        if column.kind == "time":
            found.append(Column(column.stored, "number", f"`{column.name}` in seconds since 1970 (UTC)."))
    return tuple(found)
