"""Compares the positions of modules with their sizes: it finds overlaps, and stations that an arm cannot
reach.

It gives only warnings: coordinates in workcell files are often rough, and sizes may be estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from math import hypot
from typing import NamedTuple

from labos.core.ids import local
from labos.core.model import ModuleSpec
from labos.spec.describing import apply_model, locate_parts, locate_places
from labos.spec.description import ASSUMED, DescriptionFile, ReachEntry
from labos.spec.dialects import convert_workcell
from labos.spec.findings import Finding, FindingList, Remarks
from labos.spec.frames import Frame, from_quaternion
from labos.spec.source import Path_, Source
from labos.spec.workcell import CompiledWorkcell

OVERLAP_MM = 10.0
"""Smaller overlaps are not reported."""

SLACK_MM = 50.0
"""The tolerance for the reach of an arm: a hand holds a plate above its underside, and coordinates are
accurate to 1 mm at best."""

Point = tuple[float, float]


class PlacedModule(NamedTuple):
    """A module with a place and a description."""

    name: str
    module: ModuleSpec
    at: Frame
    shape: DescriptionFile
    path: Path_


def check_layout(
    source: Source, cell: CompiledWorkcell, shape_of: Callable[[str], DescriptionFile | None]
) -> list[Finding]:
    """The warnings for a workcell file that was compiled; ``shape_of`` returns a driver's description."""
    report = FindingList(source.file)
    form, _ = convert_workcell(source, FindingList(source.file))
    remarks = Remarks(form, report)
    there = _list_apart(list(_list_placed(form, cell, shape_of)), remarks)
    for one, other in combinations(there, 2):
        _check_overlap(one, other, remarks)
    by_module = {place.module.name: place for place in there}
    for arm in there:
        if arm.shape.reach is None:
            continue
        for station in cell.workcell.stations:
            holder = by_module.get(station.module)
            taught = local(station.name) in arm.module.config.get("poses", {})
            if holder is not None and holder is not arm and (taught or arm.module.name in station.reach):
                _reach(arm, arm.shape.reach, holder, local(station.name), remarks, taught=taught)
    return list(report.sort_findings())


def _list_placed(
    form: Source, cell: CompiledWorkcell, shape_of: Callable[[str], DescriptionFile | None]
) -> Iterator[PlacedModule]:
    written = {entry.get("name"): index for index, entry in enumerate(form.data.get("modules", []))}
    for module in cell.workcell.modules:
        seven, shape = module.config.get("coordinates"), shape_of(module.driver)
        if shape is None or seven is None or len(seven) != 7 or not any(seven[3:]):
            continue
        at = from_quaternion([1000 * value for value in seven[:3]], seven[3:])
        name = local(module.name)
        path = ("modules", written.get(name, 0), "coordinates")
        yield PlacedModule(name, module, at, apply_model(shape, module.model), path)


def _list_apart(places: list[PlacedModule], remarks: Remarks) -> list[PlacedModule]:
    """The modules with a position of their own: equal coordinates of several modules count as not given."""
    groups: dict[tuple[float, ...], list[PlacedModule]] = {}
    for place in places:
        groups.setdefault(tuple(place.module.config["coordinates"]), []).append(place)
    for first, *others in groups.values():
        for other in others:
            message = (
                f"{other.name} has the same coordinates as {first.name}; neither is compared with the rest."
            )
            remarks.add_warning(message, other.path, "Write where each stands, or leave them out.")
    return [group[0] for group in groups.values() if len(group) == 1]


def _check_overlap(one: PlacedModule, other: PlacedModule, remarks: Remarks) -> None:
    low = max(one.at.at[2], other.at.at[2])
    high = min(place.at.at[2] + place.shape.footprint.height_mm for place in (one, other))
    deep = _measure_depth(_outline(one), _outline(other))
    if high - low <= OVERLAP_MM or deep <= OVERLAP_MM:
        return
    guessed = [place.name for place in (one, other) if place.shape.footprint.basis == ASSUMED]
    sizes = f" (the size of {' and '.join(guessed)} is assumed)" if guessed else ""
    message = f"The footprints of {one.name} and {other.name} overlap by {deep:.0f} mm{sizes}."
    remarks.add_warning(message, other.path, "Measure where they stand, or correct the description.")


def _outline(place: PlacedModule) -> list[Point]:
    """The corners of a module's footprint in the workcell's frame."""
    (length, width), (x, y) = place.shape.footprint.size_mm, place.shape.footprint.middle_mm
    signs = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    corners = [place.at.point((x + a * length, y + b * width, 0.0)) for a, b in signs]
    return [corner[:2] for corner in corners]


def _measure_depth(one: Sequence[Point], other: Sequence[Point]) -> float:
    """The overlap of two convex outlines: the shortest distance by which one has to move to be clear of the
    other. It is 0 or less if they do not overlap."""
    least = float("inf")
    for outline in (one, other):
        for (ax, ay), (bx, by) in zip(outline, [*outline[1:], outline[0]], strict=True):
            size = hypot(bx - ax, by - ay)
            across = ((by - ay) / size, (ax - bx) / size)
            first, second = ([x * across[0] + y * across[1] for x, y in corners] for corners in (one, other))
            least = min(least, max(first) - min(second), max(second) - min(first))
    return least


def _reach(
    arm: PlacedModule,
    reach: ReachEntry,
    holder: PlacedModule,
    station: str,
    remarks: Remarks,
    *,
    taught: bool,
) -> None:
    found = locate_places(holder.shape).get(station.removeprefix(f"{holder.name}."))
    if found is None:
        return
    x, y, height = arm.at.inverse().point(holder.at.point(found.at))
    axis = locate_parts(arm.shape)[reach.on].at
    along, across = (x - axis[0], y - axis[1]) if reach.rail_axis == "x" else (y - axis[1], x - axis[0])
    low, high = reach.rail_mm or (0.0, 0.0)
    away = hypot(along - min(max(along, low), high), across)
    (nearest, farthest), (lowest, highest) = reach.radius_mm, reach.height_mm
    close = hypot(max(abs(along - low), abs(along - high)), across)
    if away > farthest + SLACK_MM:
        why = f"{away:.0f} mm from the axis of {arm.name}, whose hand comes {farthest:.0f} mm far"
    elif close < nearest - SLACK_MM:
        why = f"{close:.0f} mm from the axis of {arm.name}, whose hand comes no nearer than {nearest:.0f} mm"
    elif not lowest - SLACK_MM <= height <= highest + SLACK_MM:
        ends = f"from {lowest:.0f} to {highest:.0f} mm"
        why = f"{height:.0f} mm above the foot of {arm.name}, whose hand goes {ends}"
    else:
        return
    path = ("locations", arm.name, station) if taught else ("stations", station, "reach")
    remedy = f"Measure where {holder.name} and {arm.name} stand, or correct a description."
    remarks.add_warning(f"By its coordinates {station} is {why}.", path, remedy, key=True)
