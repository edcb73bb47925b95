"""``description.yaml`` of a driver: the size of its instrument, its moving parts, and its stations.

Lengths are in millimetres, angles in degrees. An instrument's own frame stands on the surface that carries
it. Its y axis points to the front, where labware goes in, x to the instrument's own right, z up. A number
without a source in ``from`` is only an estimate for drawings.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from labos.core.model import StationKind
from labos.spec.parts import Name, Part

BASE = "base"
"""The instrument's own frame, to which all others are relative."""

ASSUMED, DERIVED = "assumed", "derived"
"""The words in ``from`` for a number without a source, and for one that is computed from others in the
file."""

Positive = Annotated[float, Field(gt=0)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Sizes2 = Annotated[list[Positive], Field(min_length=2, max_length=2)]
Sizes3 = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Side = Literal["above", "front", "back", "left", "right"]
Colour = Literal["white", "grey", "dark", "metal", "glass", "blue", "red", "green"]


class Based(Part):
    """A part with numbers that have sources."""

    basis: str = Field(default=ASSUMED, alias="from")


class ShapeEntry(Part):
    """A box, or a cylinder about its z axis; ``at_mm`` is its middle, in the frame of its part."""

    box_mm: Sizes3 | None = None
    cylinder_mm: Sizes2 | None = None
    at_mm: Triple = [0.0, 0.0, 0.0]
    turn_deg: Triple = [0.0, 0.0, 0.0]
    colour: Colour = "grey"

    @model_validator(mode="after")
    def _check_one_kind(self) -> ShapeEntry:
        if (self.box_mm is None) == (self.cylinder_mm is None):
            raise ValueError("a shape has either box_mm or cylinder_mm")
        return self


class MovesEntry(Based):
    """How a part moves on the one that carries it: along its axis, or about it, between two limits.
    ``like`` makes it follow another part's motion, times a factor."""

    slide_mm: Pair | None = None
    turn_deg: Pair | None = None
    axis: Triple = [0.0, 0.0, 1.0]
    like: Name | None = None
    times: float = 1.0

    @model_validator(mode="after")
    def _check_one_way(self) -> MovesEntry:
        limits = self.slide_mm or self.turn_deg
        if limits is None or (self.slide_mm is not None and self.turn_deg is not None):
            raise ValueError("a part moves by either slide_mm or turn_deg")
        if limits[0] >= limits[1]:
            raise ValueError("the lower limit comes first, and the upper one is greater")
        if not any(self.axis):
            raise ValueError("an axis has a direction")
        return self

    @property
    def limits(self) -> list[float]:
        """The lower and the upper limit, in mm or degrees."""
        return self.slide_mm or self.turn_deg or []


class PartEntry(Based):
    """A rigid piece of the instrument. Its frame is at ``at_mm``, turned by ``turn_deg`` (about x, then y,
    then z), in the frame of the part that it is ``on``. For a moving part, this is its place at position
    0."""

    on: str = BASE
    at_mm: Triple = [0.0, 0.0, 0.0]
    turn_deg: Triple = [0.0, 0.0, 0.0]
    moves: MovesEntry | None = None
    shapes: list[ShapeEntry] = []


class EachEntry(Part):
    """Places in a row: numbers from first to last, and the distance from one to the next."""

    from_to: Annotated[list[int], Field(min_length=2, max_length=2)]
    step_mm: Triple


class PlaceEntry(Based):
    """A station, or with ``each`` a row of stations, whose name has a placeholder for each number. ``at_mm``
    is the middle of the underside of the labware there, whose long side lies along x; ``approach`` is the
    side from which a gripper comes, and ``grips`` are the possible grips."""

    kind: StationKind
    on: str = BASE
    at_mm: Triple
    turn_deg: Triple = [0.0, 0.0, 0.0]
    approach: Side = "above"
    grips: list[str] = []
    each: dict[Name, EachEntry] = {}
    note: str = ""


class FootprintEntry(Based):
    """The space of the instrument at rest: along x and y, around ``middle_mm``, and its height."""

    size_mm: Sizes2
    height_mm: Positive
    middle_mm: Pair = [0.0, 0.0]


class GripEntry(Based):
    """How a gripper holds labware: the width between its fingers, closed on it and open."""

    width_mm: Pair
    note: str = ""


class ReachEntry(Based):
    """The reach of a manipulator's gripper: distances from the z axis of the part that it is ``on``, and
    heights above the instrument's own frame. ``rail_mm`` is the travel of that axis along ``rail_axis``."""

    on: str = BASE
    radius_mm: Pair
    height_mm: Pair
    rail_mm: Pair | None = None
    rail_axis: Literal["x", "y"] = "x"


Limit = float | str | list[float]


class VariantEntry(Part):
    """Another size of the same instrument: these values replace those of the file."""

    models: list[str] = []
    instrument: str = ""
    footprint: FootprintEntry | None = None
    parts: dict[Name, PartEntry] | None = None
    stations: dict[str, PlaceEntry] | None = None
    grips: dict[Name, GripEntry] | None = None
    reach: ReachEntry | None = None
    limits: dict[Name, Limit] | None = None


class DescriptionFile(Part):
    """The geometry of an instrument. ``sources`` are the names for ``from``."""

    labos: Literal[1] = 1
    driver: Name
    instrument: str = Field(min_length=1)
    footprint: FootprintEntry
    parts: dict[Name, PartEntry] = Field(min_length=1)
    stations: dict[str, PlaceEntry] = {}
    grips: dict[Name, GripEntry] = {}
    reach: ReachEntry | None = None
    limits: dict[Name, Limit] = {}
    variants: dict[Name, VariantEntry] = {}
    sources: dict[Name, str] = Field(min_length=1)
    notes: str = ""
