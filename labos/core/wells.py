"""Names of wells, and the volumes that they may hold."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Iterable, Mapping
from typing import Any

from labos.core.effects import AnyEffect, Draws, Transfers
from labos.core.model import LabwareSpec

MOST_WELLS = 1536
"""The number of wells of the finest plate; reports on further wells are not kept."""

_WELL = re.compile(r"([A-Za-z]{1,2})0*([1-9][0-9]{0,2})")
_SLACK_UL = 1e-6


def normalise_well(text: str) -> str:
    """The normal form of a well's name: ``a01`` gives ``A1``. Raises ValueError for a text that cannot be a
    well."""
    match = _WELL.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is not a well")
    return f"{match[1].upper()}{match[2]}"


def parse_well(well: str) -> tuple[int, int]:
    """Row and column of a well, counted from 0: A1 is (0, 0), AA3 (26, 2). Raises ValueError."""
    match = _WELL.fullmatch(well)
    if match is None:
        raise ValueError(f"{well!r} is not a well")
    row = 0
    for letter in match[1].upper():
        row = row * 26 + string.ascii_uppercase.index(letter) + 1
    return row - 1, int(match[2]) - 1


def well_key(name: str) -> tuple[int, int, int]:
    """A sort key for wells in the order of a plate: A1, A2, A10, B1. Other texts come after them and keep
    their order."""
    try:
        return (0, *parse_well(name))
    except ValueError:
        return (1, 0, 0)


def sort_by_well(value: Any, *, others_sorted: bool = False) -> Any:
    """A value in which objects whose keys are all wells are in the order of the plate. Other objects keep
    their order, or are sorted by their keys."""
    if isinstance(value, list | tuple):
        return [sort_by_well(item, others_sorted=others_sorted) for item in value]
    if not isinstance(value, dict):
        return value
    names = list(value)
    if all(isinstance(name, str) and _WELL.fullmatch(name) for name in names):
        names.sort(key=well_key)
    elif others_sorted:
        names.sort()
    return {name: sort_by_well(value[name], others_sorted=others_sorted) for name in names}


def row_name(row: int) -> str:
    """The letters of a row, counted from 0."""
    letters = ""
    row += 1
    while row:
        row, rest = divmod(row - 1, 26)
        letters = string.ascii_uppercase[rest] + letters
    return letters


def list_doses(effect: Transfers | Draws) -> list[tuple[str, float]]:
    """Wells and volumes (µL) that go in or out; none if the effect does not have two lists. Raises ValueError
    for lists of different lengths, and for entries that are not wells or volumes."""
    wells, volumes = effect.wells, effect.volumes_ul
    what = effect.liquid if isinstance(effect, Transfers) else "what is drawn"
    if not isinstance(volumes, list | tuple) or not volumes:
        return []
    if not isinstance(wells, list | tuple):
        if wells:
            return []  # not known yet
        wells = ()
    if len(wells) != len(volumes):
        raise ValueError(
            f"{len(volumes)} volume{_add_s(volumes)} of {what} for {len(wells)} well{_add_s(wells)}"
        )
    doses: list[tuple[str, float]] = []
    for well, volume in zip(wells, volumes, strict=True):
        if isinstance(volume, bool) or not isinstance(volume, int | float):
            raise ValueError(f"the volume of {what} for {well} is {volume!r}, which is not a number")
        if not 0 <= volume < math.inf:
            raise ValueError(f"the volume of {what} for {well} is {volume:g} µL")
        if not isinstance(well, str):
            raise ValueError(f"{well!r} is not a well")
        doses.append((normalise_well(well), float(volume)))
    return doses


def find_misfit(
    effects: Iterable[AnyEffect], kind: LabwareSpec | None, held: Mapping[str, float], labware: str
) -> str:
    """The fault of the liquids that an action puts into wells of labware and draws from them; empty if there
    is none. ``held`` (µL) is the most that the wells already contain. The order is not known, so the final
    volumes have to be possible. A well with an undeclared content may hold anything. Without a type, only the
    lists are checked."""
    given: dict[str, float] = {}
    drawn: dict[str, float] = {}
    for effect in effects:
        if isinstance(effect, Transfers | Draws):
            try:
                doses = list_doses(effect)
            except ValueError as error:
                return str(error)
            fault = _check_wells(doses, kind, labware) if kind is not None else ""
            if fault:
                return fault
            add_doses(given if isinstance(effect, Transfers) else drawn, *_split_doses(doses))
    if kind is None or kind.wells is None:
        return ""
    most = kind.wells.volume_ul
    for well in {**given, **drawn}:
        level = held.get(well, 0.0) + given.get(well, 0.0)
        out = drawn.get(well, 0.0)
        if out > level + _SLACK_UL and well in held:
            known = f"{well} of {labware} is recorded with {level:g} µL"
            return f"{known}, and {out:g} µL would be drawn (a sheet of samples says what it held before)"
        if out > most + _SLACK_UL:
            return f"{out:g} µL would be drawn out of {well} of {labware}, and {_describe_volume(kind)}"
        if level - out > most + _SLACK_UL:
            return f"{well} of {labware} would hold {level - out:g} µL, and {_describe_volume(kind)}"
    return ""


def _check_wells(doses: list[tuple[str, float]], kind: LabwareSpec, labware: str) -> str:
    grid = kind.wells
    if grid is None:
        return f"{labware} is a {kind.name}, which has no wells" if doses else ""
    for well, _ in doses:
        row, column = parse_well(well)
        if row >= grid.rows or column >= grid.columns:
            last = f"{row_name(grid.rows - 1)}{grid.columns}"
            return f"a {kind.name} has no well {well}; its wells are A1 to {last}"
    return ""


def _describe_volume(kind: LabwareSpec) -> str:
    assert kind.wells is not None
    return f"a well of a {kind.name} holds {kind.wells.volume_ul:g} µL"


def _split_doses(doses: list[tuple[str, float]]) -> tuple[list[str], list[float]]:
    return [well for well, _ in doses], [volume for _, volume in doses]


def add_doses(levels: dict[str, float], wells: Iterable[str], volumes_ul: Iterable[float]) -> None:
    """Add volumes to wells."""
    for well, volume in zip(wells, volumes_ul, strict=False):
        if well in levels or len(levels) < MOST_WELLS:
            levels[well] = levels.get(well, 0.0) + volume


def draw_doses(levels: dict[str, float], wells: Iterable[str], volumes_ul: Iterable[float]) -> None:
    """Subtract volumes from wells; wells with unknown content stay unknown."""
    for well, volume in zip(wells, volumes_ul, strict=False):
        if well in levels:
            levels[well] = max(0.0, levels[well] - volume)


def _add_s(items: list[Any] | tuple[Any, ...]) -> str:
    return "" if len(items) == 1 else "s"
