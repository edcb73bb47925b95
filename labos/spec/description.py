"""``description.yaml`` of a driver: the size of its instrument, its moving parts, and its stations.

Lengths are in millimetres, angles in degrees. An instrument's own frame stands on the surface that carries
it. Its y axis points to the front, where labware goes in, x to the instrument's own right, z up. A number
without a source in ``from`` is only an estimate for drawings.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from labos.core.model import StationKind
from labos.spec.parts import Comment, Name, Part, Version

BASE = "base"
"""The instrument's own frame, to which all others are relative."""

ASSUMED, DERIVED = "assumed", "derived"
"""The words in ``from`` for a number without a source, and for one that is computed from others in the
file."""

Positive = Annotated[float, Field(gt=0)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Turn = Annotated[Triple, Field(description="its rotation about x, then y, then z, in degrees")]
Sizes2 = Annotated[list[Positive], Field(min_length=2, max_length=2)]
Sizes3 = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Side = Literal["above", "front", "back", "left", "right"]
Carrier = Annotated[str, Field(description="the part that carries it; `base` for the instrument's own frame")]
Colour = Literal["white", "grey", "dark", "metal", "glass", "blue", "red", "green"]


class Based(Part):
    """A part with numbers that have sources."""

    basis: str = Field(default=ASSUMED, alias="from")
    """the source of the numbers: a key of ``sources``, ``derived`` or ``assumed``"""


class ShapeEntry(Part):
    """A box, or a cylinder about its z axis; ``at_mm`` is its middle, in the frame of its part."""

    box_mm: Sizes3 | None = None
    """sides along x, y and z, in mm"""
    cylinder_mm: Sizes2 | None = None
    """diameter, and height along z, in mm"""
    at_mm: Triple = [0.0, 0.0, 0.0]
    """its middle in the part's frame, in mm"""
    turn_deg: Turn = [0.0, 0.0, 0.0]
    colour: Colour = "grey"
    """its colour"""

    @model_validator(mode="after")
    def _check_one_kind(self) -> ShapeEntry:
        if (self.box_mm is None) == (self.cylinder_mm is None):
            raise ValueError("a shape has either box_mm or cylinder_mm")
        return self


class MovesEntry(Based):
    """How a part moves on the one that carries it: along its axis, or about it, between two limits.
    ``like`` makes it follow another part's motion, times a factor."""

    slide_mm: Pair | None = None
    """least and greatest position along the axis, in mm"""
    turn_deg: Pair | None = None
    """least and greatest angle about the axis, in degrees"""
    axis: Triple = [0.0, 0.0, 1.0]
    """the axis' direction in the part's own frame"""
    like: Name | None = None
    """the part whose motion it follows"""
    times: float = 1.0
    """the factor of that motion"""

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

    on: Carrier = BASE
    at_mm: Triple = [0.0, 0.0, 0.0]
    """its position in mm, in the frame of the part that carries it"""
    turn_deg: Turn = [0.0, 0.0, 0.0]
    moves: MovesEntry | None = None
    """its motion on the part that carries it; none if left out"""
    shapes: list[ShapeEntry] = []
    """its shapes"""


class EachEntry(Part):
    """Places in a row: numbers from first to last, and the distance from one to the next."""

    from_to: Annotated[list[int], Field(min_length=2, max_length=2)]
    """the first and the last number"""
    step_mm: Triple
    """from one place to the next, in mm"""


class PlaceEntry(Based):
    """A station, or with ``each`` a row of stations, whose name has a placeholder for each number. ``at_mm``
    is the middle of the underside of the labware there, whose long side lies along x; ``approach`` is the
    side from which a gripper comes, and ``grips`` are the possible grips."""

    kind: StationKind
    """the kind of the station, as in the driver"""
    on: Carrier = BASE
    at_mm: Triple
    """the middle of the labware's underside, in mm, in the frame of the part that carries it"""
    turn_deg: Triple = [0.0, 0.0, 0.0]
    """its rotation in degrees; the labware's long side lies along x"""
    approach: Side = "above"
    """the side from which a gripper comes"""
    grips: list[str] = []
    """the possible grips; any, if left out"""
    each: dict[Name, EachEntry] = {}
    """numbers in its name, which make it a row of places"""
    note: Comment = ""


class FootprintEntry(Based):
    """The space of the instrument at rest: along x and y, around ``middle_mm``, and its height."""

    size_mm: Sizes2
    """along x and along y, in mm"""
    height_mm: Positive
    """at rest, in mm"""
    middle_mm: Pair = [0.0, 0.0]
    """x and y of its middle, in mm"""


class GripEntry(Based):
    """How a gripper holds labware: the width between its fingers, closed on it and open."""

    width_mm: Pair
    """width between the fingers, closed on labware and open, in mm"""
    note: Comment = ""


class ReachEntry(Based):
    """The reach of a manipulator's gripper: distances from the z axis of the part that it is ``on``, and
    heights above the instrument's own frame. ``rail_mm`` is the travel of that axis along ``rail_axis``."""

    on: str = BASE
    """the part from whose z axis the distance is measured; ``base`` for the instrument's own frame"""
    radius_mm: Pair
    """least and greatest distance from that axis, in mm"""
    height_mm: Pair
    """least and greatest height above the instrument's own frame, in mm"""
    rail_mm: Pair | None = None
    """least and greatest position of that axis on a rail, in mm"""
    rail_axis: Literal["x", "y"] = "x"
    """the direction of the rail"""


Limit = float | str | list[float]


class VariantEntry(Part):
    """Another size of the same instrument: these values replace those of the file."""

    models: list[str] = []
    """names of models in workcell files with this size"""
    instrument: str = ""
    """maker and model"""
    footprint: FootprintEntry | None = None
    """replaces the file's footprint"""
    parts: dict[Name, PartEntry] | None = None
    """replace the file's parts"""
    stations: dict[str, PlaceEntry] | None = None
    """replace the file's stations"""
    grips: dict[Name, GripEntry] | None = None
    """replace the file's grips"""
    reach: ReachEntry | None = None
    """replaces the file's reach"""
    limits: dict[Name, Limit] | None = None
    """replace the file's limits"""


class DescriptionFile(Part):
    """The geometry of an instrument. ``sources`` are the names for ``from``."""

    labos: Version = 1
    driver: Name
    """the driver of the instrument"""
    instrument: str = Field(min_length=1)
    """maker and model"""
    footprint: FootprintEntry
    """its space at rest"""
    parts: dict[Name, PartEntry] = Field(min_length=1)
    """its rigid pieces, by name"""
    stations: dict[str, PlaceEntry] = {}
    """the places that hold labware; each is a station of the driver"""
    grips: dict[Name, GripEntry] = {}
    """how its gripper holds labware, by the names of grips in workcell files"""
    reach: ReachEntry | None = None
    """the reach of its gripper, if it moves labware"""
    limits: dict[Name, Limit] = {}
    """limits of its settings: a number, a list of them (least and greatest), or text"""
    variants: dict[Name, VariantEntry] = {}
    """other sizes of it, by name"""
    sources: dict[Name, str] = Field(min_length=1)
    """the sources of numbers, by the short names for ``from``"""
    notes: Comment = ""
