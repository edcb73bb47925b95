"""Reads ``description.yaml`` files, and computes the positions of an instrument's parts and stations."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labos.errors import NotFound
from labos.spec.description import (
    ASSUMED,
    BASE,
    DERIVED,
    Based,
    DescriptionFile,
    PlaceEntry,
    VariantEntry,
)
from labos.spec.findings import FindingList, Remarks, suggest_name
from labos.spec.frames import Frame, frame, slide, spin
from labos.spec.source import Path_, Source, read
from labos.spec.validation import expect_valid

PLACEHOLDER = re.compile(r"\{(\w+)\}")


def load_description(source: Source | str | Path) -> DescriptionFile:
    """Read and check a description. Raises SpecError or SpecErrors."""
    source = source if isinstance(source, Source) else read(source)
    report = FindingList(source.file)
    file = expect_valid(DescriptionFile, source, report)
    remarks = Remarks(source, report)
    _Check(file, None, remarks).check_all()
    for name, entry in file.variants.items():
        _Check(apply_variant(file, name), (name, entry), remarks).check_all()
    report.raise_if_failed()
    return file


def apply_variant(file: DescriptionFile, name: str) -> DescriptionFile:
    """The description with the changes of a variant. Raises NotFound."""
    if name not in file.variants:
        raise NotFound(
            f"{file.driver} has no variant {name!r}.", remedy=suggest_name(name, file.variants, "variant")
        )
    entry = file.variants[name]
    changed = {key: getattr(entry, key) for key in entry.model_fields_set - {"models"}}
    return file.model_copy(update=changed)


def apply_model(file: DescriptionFile, model: str) -> DescriptionFile:
    """The description for a model: that of its variant, otherwise that of the file itself."""
    for name, entry in file.variants.items():
        if model.lower() in {known.lower() for known in entry.models}:
            return apply_variant(file, name)
    return file


def list_places(file: DescriptionFile) -> dict[str, PlaceEntry]:
    """The stations by name; rows of stations are expanded."""
    return {
        name: entry for pattern, row in file.stations.items() for name, entry in _expand_row(pattern, row)
    }


def locate_parts(file: DescriptionFile, joints: Mapping[str, float] | None = None) -> dict[str, Frame]:
    """The frames of all parts in the instrument's own frame. ``joints`` are the positions of the moving parts
    (mm or degrees, by part). A part that is not named is at 0, or at its limit that is nearest to 0."""
    joints = joints or {}
    found = {BASE: frame()}
    while len(found) <= len(file.parts):
        before = len(found)
        for name, part in file.parts.items():
            if name not in found and part.on in found:
                here = found[part.on].then(frame(part.at_mm, part.turn_deg))
                found[name] = here.then(_move(file, name, joints))
        if len(found) == before:
            raise ValueError("parts that are on no other part")  # ``load_description`` refuses such files
    return found


def locate_places(file: DescriptionFile, joints: Mapping[str, float] | None = None) -> dict[str, Frame]:
    """The frames of all stations in the instrument's own frame, with ``joints`` as for ``locate_parts``."""
    parts = locate_parts(file, joints)
    return {
        name: parts[entry.on].then(frame(entry.at_mm, entry.turn_deg))
        for name, entry in list_places(file).items()
    }


def _move(file: DescriptionFile, name: str, joints: Mapping[str, float]) -> Frame:
    moves = file.parts[name].moves
    if moves is None:
        return frame()
    if moves.like is not None:
        by = moves.times * _find_joint_value(file, moves.like, joints)
    else:
        by = _find_joint_value(file, name, joints)
    return slide(moves.axis, by) if moves.slide_mm is not None else spin(moves.axis, by)


def _find_joint_value(file: DescriptionFile, name: str, joints: Mapping[str, float]) -> float:
    moves = file.parts[name].moves
    low, high = moves.limits if moves is not None else (0.0, 0.0)
    return joints.get(name, min(max(0.0, low), high))


def _expand_row(pattern: str, row: PlaceEntry) -> Iterator[tuple[str, PlaceEntry]]:
    numbers = [range(each.from_to[0], each.from_to[1] + 1) for each in row.each.values()]
    for chosen in itertools.product(*numbers):
        at, values = list(row.at_mm), dict(zip(row.each, chosen, strict=True))
        for key, each in row.each.items():
            steps = values[key] - each.from_to[0]
            at = [here + steps * step for here, step in zip(at, each.step_mm, strict=True)]
        yield _fill_name(pattern, values), row.model_copy(update={"at_mm": at, "each": {}})


def _fill_name(pattern: str, values: Mapping[str, int]) -> str:
    return PLACEHOLDER.sub(lambda found: str(values.get(found[1], found[0])), pattern)


class _Check:
    """Checks that pydantic's models cannot do: names without a target, parts that stand on themselves."""

    def __init__(
        self, file: DescriptionFile, entry: tuple[str, VariantEntry] | None, remarks: Remarks
    ) -> None:
        self.file, self.entry, self.remarks = file, entry, remarks

    def check_all(self) -> None:
        for path, based in self._list_based():
            known = [ASSUMED, DERIVED, *self.file.sources]
            if based.basis not in known:
                message = f"There is no source {based.basis!r}."
                self._add_error(message, (*path, "from"), suggest_name(based.basis, known, "source"))
        for name, part in self.file.parts.items():
            if name == BASE:
                message = f"{BASE!r} is the instrument's own frame."
                self._add_error(message, ("parts", name), "Give the part another name.", key=True)
            if part.moves is not None and not part.shapes:
                message = f"The part {name!r} moves and has no shape."
                self._add_error(
                    message, ("parts", name), "Give it a shape: simulators refuse moving parts without mass."
                )
            self._check_stands_on(part.on, ("parts", name, "on"))
            self._check_follows(name)
        self._check_no_circles()
        for name, place in self.file.stations.items():
            self._check_stands_on(place.on, ("stations", name, "on"))
            self._check_numbers(name, place)
        if self.file.reach is not None:
            self._check_stands_on(self.file.reach.on, ("reach", "on"))
            for key in ("radius_mm", "height_mm", "rail_mm"):
                pair = getattr(self.file.reach, key)
                if pair is not None and pair[0] >= pair[1]:
                    self._add_error("The lower value comes first.", ("reach", key), "Write them in order.")

    def _list_based(self) -> Iterator[tuple[Path_, Based]]:
        yield ("footprint",), self.file.footprint
        for key in ("parts", "stations", "grips"):
            for name, entry in getattr(self.file, key).items():
                yield (key, name), entry
        for name, part in self.file.parts.items():
            if part.moves is not None:
                yield ("parts", name, "moves"), part.moves
        if self.file.reach is not None:
            yield ("reach",), self.file.reach

    def _check_stands_on(self, on: str, path: Path_) -> None:
        known = [BASE, *self.file.parts]
        if on not in known:
            self._add_error(f"There is no part {on!r}.", path, suggest_name(on, known, "part"))

    def _check_follows(self, name: str) -> None:
        moves = self.file.parts[name].moves
        if moves is None or moves.like is None:
            return
        leader = self.file.parts.get(moves.like)
        if leader is None or leader.moves is None or leader.moves.like is not None:
            message = f"No part {moves.like!r} moves by itself."
            moving = [n for n, p in self.file.parts.items() if p.moves is not None and p.moves.like is None]
            self._add_error(
                message, ("parts", name, "moves", "like"), suggest_name(moves.like, moving, "part")
            )

    def _check_no_circles(self) -> None:
        for name in self.file.parts:
            seen, here = {name}, self.file.parts[name].on
            while here in self.file.parts and here not in seen:
                seen.add(here)
                here = self.file.parts[here].on
            if here == name:
                message = f"The part {name!r} is on itself."
                self._add_error(message, ("parts", name, "on"), f"Put one of them on {BASE!r}.")

    def _check_numbers(self, name: str, place: PlaceEntry) -> None:
        written = set(PLACEHOLDER.findall(name))
        if written != set(place.each):
            message = f"The name {name!r} and `each` do not have the same numbers."
            self._add_error(message, ("stations", name), "Write {n} in the name for a number n in `each`.")
        for key, each in place.each.items():
            if each.from_to[0] > each.from_to[1]:
                path = ("stations", name, "each", key, "from_to")
                self._add_error("The lower number comes first.", path, "Write them in order.")

    def _add_error(self, message: str, path: Path_, remedy: str, *, key: bool = False) -> None:
        self.remarks.error(message, self._find_path(path), remedy, key=key)

    def _find_path(self, path: Path_) -> Path_:
        """The path of a fault: below the variant, if the variant has this field."""
        if self.entry is not None and path[0] in self.entry[1].model_fields_set:
            return ("variants", self.entry[0], *path)
        return path


def make_plain(file: DescriptionFile) -> dict[str, Any]:
    """The description as plain data; rows of stations are expanded."""
    data = file.model_dump(by_alias=True, exclude_none=True)
    data["stations"] = {
        name: entry.model_dump(by_alias=True, exclude_none=True, exclude={"each"})
        for name, entry in list_places(file).items()
    }
    return data
