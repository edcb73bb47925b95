"""The content of a well and its origins, after any number of transfers."""

from __future__ import annotations

import re
from typing import Any

import msgspec

from labos.audit.graph import Entity, ProvenancePart
from labos.audit.query import ReadConnection

_WELL = re.compile(r"(?:([^/\s]+)/)?([A-Z]{1,2}[1-9][0-9]?)")
_STEPS = (
    "SELECT position, number, kind, volume_ul, liquid, lots, certain FROM transfers "
    "WHERE labware = ? AND well = ? AND position <= ? ORDER BY position, number"
)
_TRACE_UL = 1e-9
"""A smaller volume counts as zero."""

Origin = tuple[Entity, str]
"""The origin of liquid, and its name."""


class Mixture(msgspec.Struct):
    """Volumes (µL) by origin. ``unmeasured`` are origins with an unknown volume; for ``doubtful`` ones it is
    not known whether their liquid came in. ``drawn`` is the content before it was emptied, because an action
    lists taken and dispensed liquids in any order."""

    volumes: dict[Origin, float] = {}
    unmeasured: set[Origin] = set()
    doubtful: set[Origin] = set()
    drawn: dict[Origin, float] = {}

    @property
    def total_ul(self) -> float:
        return sum(self.volumes.values())

    def add(self, origin: Origin, volume: float | None, *, certain: bool) -> None:
        if volume is None:
            self.unmeasured.add(origin)
        else:
            self.volumes[origin] = self.volumes.get(origin, 0.0) + volume
        if not certain:
            self.doubtful.add(origin)

    def draw(self, volume: float) -> None:
        """Take a volume, of all parts in proportion."""
        total = self.total_ul
        if total > 0:
            left = max(0.0, 1.0 - volume / total)
            self.drawn = dict(self.volumes)
            self.volumes = {origin: part * left for origin, part in self.volumes.items()}

    def list_parts(self) -> list[ProvenancePart]:
        """The parts, the largest first. Shares are given only if all volumes are known."""
        total = self.total_ul
        exact = total > 0 and not self.unmeasured
        found = []
        for origin in {**self.volumes, **dict.fromkeys(self.unmeasured)}:
            volume = self.volumes.get(origin, 0.0)
            if volume > _TRACE_UL or origin in self.unmeasured:
                volume_ul = None if origin in self.unmeasured else round(volume, 6)
                share = round(volume / total, 6) if exact else None
                found.append(ProvenancePart(*origin, volume_ul, share, origin not in self.doubtful))
        return sorted(found, key=lambda part: (-(part.volume_ul or 0.0), part.origin.name, part.what))


def find_source_well(labware: str, liquid: str) -> str:
    """The well in the name of a liquid: ``A1`` of the same labware, or ``P3/A1``; empty if none."""
    found = _WELL.fullmatch(liquid)
    return f"{found[1] or labware}/{found[2]}" if found else ""


def trace_contents(asker: ReadConnection, labware: str, well: str, upto: int) -> list[ProvenancePart]:
    """The content of a well after the event at a position. A sample sheet replaces the content; liquid that
    is taken out of a well has the shares of the well at that time."""
    steps = _list_steps_before(asker, f"{labware}/{well}", upto)
    wells: dict[str, Mixture] = {name: Mixture() for name in steps}
    for _, _, name, step in sorted(
        (at, n, name, step) for name, well_steps in steps.items() for at, n, *step in well_steps
    ):
        _take(wells, name, *step)
    return wells[f"{labware}/{well}"].list_parts()


def _list_steps_before(asker: ReadConnection, wanted: str, upto: int) -> dict[str, list[Any]]:
    """All events of a well, and of the wells from which it was filled."""
    found: dict[str, list[Any]] = {}
    waiting = [wanted]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        labware, _, well = name.rpartition("/")
        found[name] = asker.fetch(_STEPS, labware, well, upto)
        liquids = [liquid for _, _, kind, _, liquid, *_ in found[name] if kind == "in"]
        waiting += filter(None, (find_source_well(labware, liquid) for liquid in liquids))
    return found


def _take(
    wells: dict[str, Mixture],
    name: str,
    kind: str,
    volume: float | None,
    liquid: str,
    lots: str | None,
    certain: bool,
) -> None:
    held = wells[name]
    source = find_source_well(name.rpartition("/")[0], liquid) if kind == "in" else ""
    if kind == "sheet":
        wells[name] = Mixture()
        wells[name].add((Entity("sample", liquid), liquid), volume, certain=True)
    elif kind == "out":
        if certain:
            held.draw(volume or 0.0)
    elif source:
        _pour(wells[source], held, source, volume or 0.0, certain=certain)
    else:
        # The amount from each of several lots is not recorded: equal parts.
        named = msgspec.json.decode(lots or "[]", type=list[str]) or ["not known"]
        for lot in named:
            part = None if volume is None else volume / len(named)
            held.add((Entity("lot", lot), liquid), part, certain=certain)


def _pour(origin: Mixture, held: Mixture, source: str, volume: float, *, certain: bool) -> None:
    """Move liquid from one well into another."""
    parts = dict(origin.volumes if origin.total_ul > 0 else origin.drawn)
    total = sum(parts.values())
    for part, amount in parts.items():
        held.add(part, volume * amount / total, certain=certain and part not in origin.doubtful)
    for part in list(origin.unmeasured):
        held.add(part, None, certain=certain)
    if not parts and not origin.unmeasured:
        held.add((Entity("well", source), "not known"), volume, certain=certain)
