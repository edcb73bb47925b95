"""A log query as SQL."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
from sqlalchemy import ColumnElement, Select, and_, func, or_, select

from labos.ports import LogQuery
from labos.store._tables import event, words

Contains = Callable[[Any, str | bytes], ColumnElement[bool]]


def make_selection(query: LogQuery, contains: Contains) -> Select[Any]:
    """The rows that a query selects, except for ``after``, ``last`` and their order."""
    c = event.c
    conditions: list[ColumnElement[bool]] = []
    if query.after:
        conditions.append(c.position > query.after)
    if query.upto is not None:
        conditions.append(c.position <= query.upto)
    if query.types:
        conditions.append(or_(*(_match_type(name) for name in query.types)))
    if query.streams:
        conditions.append(c.stream.in_(query.streams))
    if query.correlation:
        conditions.append(c.correlation == query.correlation)
    if query.actor:
        conditions.append(c.actor == query.actor)
    if query.mentions:
        # In a payload the text has the form of JSON.
        quoted = msgspec.json.encode(query.mentions)[1:-1]
        beside = select(words.c.position).where(contains(words.c.text, query.mentions))
        matches = (contains(c.payload, quoted), contains(c.stream, query.mentions), c.position.in_(beside))
        conditions.append(or_(*matches))
    if query.since_ns is not None:
        conditions.append(c.recorded_at >= query.since_ns)
    if query.until_ns is not None:
        conditions.append(c.recorded_at < query.until_ns)
    return select(event).where(*conditions)


def select_positions_of_last(statement: Select[Any], n: int) -> Select[Any]:
    """``first`` and ``last`` position of the last ``n`` rows of a selection."""
    newest = (
        statement.with_only_columns(event.c.position)
        .order_by(event.c.position.desc())
        .limit(max(n, 0))
        .subquery()
    )
    return select(func.min(newest.c.position).label("first"), func.max(newest.c.position).label("last"))


def _match_type(name: str) -> ColumnElement[bool]:
    """A type, or every type of a family: all names between ``name.`` and ``name/``, the next character in
    byte order. A range uses the index, and has no wildcards."""
    family = name.rstrip(".*")
    return or_(event.c.type == family, and_(event.c.type >= f"{family}.", event.c.type < f"{family}/"))
