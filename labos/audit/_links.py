"""The links of things to their causes and effects, as queries on the views."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import cast

import msgspec

from labos.audit.graph import Entity, EntityKind, well_of
from labos.audit.query import ReadConnection

Found = Iterator[tuple[str, int, int]]
"""The name of another thing, the event that shows the link, and the position up to which (from which, for an
effect) the other thing itself counts."""

Rule = str | Callable[[ReadConnection, Entity, int, int], Found]
"""A query, or a function for what a query cannot say; the numbers are the positions ``since`` and ``upto``.
The columns of a query are those of ``Found``; without the last, it is the position of the event. A query may
name the thing (``:name``), the parts of a well (``:labware``, ``:well``) or of a driver (``:module``,
``:driver``, ``:version``), and the positions."""

Links = Mapping[EntityKind, Mapping[str, Rule]]
"""The links of a kind of thing. Their names end with the kind of the other thing: ``asked for by user``."""

IN_FORCE = (
    "c.module = a.module AND c.position < a.requested_position "
    "AND (c.ends_at_s IS NULL OR a.requested_at_s < c.ends_at_s) "
    "AND NOT EXISTS (SELECT 1 FROM calibrations later WHERE later.module = c.module AND later.what = c.what "
    "AND later.position > c.position AND later.position < a.requested_position)"
)
"""An SQL condition: a calibration ``c`` was recorded before the request of an action ``a``, was then the last
one of its kind, and had not expired."""

_PARTS: dict[EntityKind, tuple[str, ...]] = {
    "well": ("labware", "well"),
    "driver": ("module", "driver", "version"),
}


def find_links(
    asker: ReadConnection, entity: Entity, links: Links, since: int, upto: int
) -> Iterator[tuple[str, Entity, int, int]]:
    """All links of a thing: relation, other thing, and the positions as in ``Found``."""
    for title, rule in links.get(entity.kind, {}).items():
        relation, _, kind = title.rpartition(" ")
        find = query(rule) if isinstance(rule, str) else rule
        for name, position, limit in find(asker, entity, since, upto):
            yield relation, Entity(cast(EntityKind, kind), name), position, limit


def query(text: str, *, is_list: bool = False) -> Callable[[ReadConnection, Entity, int, int], Found]:
    """The rule of a query; ``is_list``: its first column is a JSON list of names."""

    def find(asker: ReadConnection, entity: Entity, since: int, upto: int) -> Found:
        values = well_of(entity.name) if entity.kind == "well" else entity.name.split(" ", 2)
        parts = dict(zip(_PARTS.get(entity.kind, ()), values, strict=False))
        for name, *positions in asker.fetch(text, name=entity.name, since=since, upto=upto, **parts):
            for each in msgspec.json.decode(name or "[]", type=list[str]) if is_list else (name,):
                yield each, positions[0], positions[-1]

    return find
