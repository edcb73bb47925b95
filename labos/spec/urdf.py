"""A description as a URDF (Unified Robot Description Format) with simple meshes, for simulators and motion
planners: metres and radians, one link for each part and each station.

Two meshes are enough for all instruments: a cube with sides of 1 m, and a cylinder with a diameter and a
height of 1 m, both centred at 0. ``scale`` gives them the size of a part. Masses are not known and are left
out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from math import cos, pi, radians, sin
from xml.etree import ElementTree

from labos.spec.describing import list_places
from labos.spec.description import BASE, DescriptionFile, MovesEntry, ShapeEntry

SIDES = 32
"""The number of corners of the cylinder's ends."""

COLOURS = {
    "white": (0.95, 0.95, 0.95, 1.0),
    "grey": (0.6, 0.6, 0.62, 1.0),
    "dark": (0.15, 0.15, 0.17, 1.0),
    "metal": (0.75, 0.77, 0.8, 1.0),
    "glass": (0.6, 0.75, 0.85, 0.35),
    "blue": (0.15, 0.3, 0.7, 1.0),
    "red": (0.7, 0.15, 0.15, 1.0),
    "green": (0.15, 0.55, 0.3, 1.0),
}

EFFORT, SPEED = "1000", "1"
"""URDF requires a maximum force and speed for each joint, which descriptions do not have."""

Corner = tuple[float, float, float]


def write_urdf(file: DescriptionFile, name: str = "") -> str:
    """The URDF. Its meshes (``meshes``) must be in the same folder."""
    robot = ElementTree.Element("robot", name=name or file.driver)
    instrument = file.instrument.replace("--", "- -")  # which would end the comment
    robot.append(ElementTree.Comment(f" Made from the description of {instrument}; do not edit. "))
    used = {shape.colour for part in file.parts.values() for shape in part.shapes}
    for colour in sorted(used):
        material = ElementTree.SubElement(robot, "material", name=colour)
        ElementTree.SubElement(material, "color", rgba=" ".join(f"{part:g}" for part in COLOURS[colour]))
    ElementTree.SubElement(robot, "link", name=BASE)
    for part_name, part in file.parts.items():
        link = ElementTree.SubElement(robot, "link", name=part_name)
        for role in ("visual", "collision"):
            for shape in part.shapes:
                _add_shape(ElementTree.SubElement(link, role), shape)
        joint = _add_joint(robot, part_name, part.on, part.at_mm, part.turn_deg, part.moves)
        if part.moves is not None:
            _add_motion(joint, part.moves)
    for place_name, place in list_places(file).items():
        ElementTree.SubElement(robot, "link", name=name_station_link(place_name))
        _add_joint(robot, name_station_link(place_name), place.on, place.at_mm, place.turn_deg, None)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def name_station_link(name: str) -> str:
    """The name of the link for a station."""
    return f"station_{name}"


def make_meshes() -> dict[str, bytes]:
    """The two meshes as binary STL, by file name."""
    return {"box.stl": _encode_stl(_make_box()), "cylinder.stl": _encode_stl(list(_iterate_cylinder()))}


def _add_joint(
    robot: ElementTree.Element,
    name: str,
    parent: str,
    at_mm: Sequence[float],
    turn_deg: Sequence[float],
    moves: MovesEntry | None,
) -> ElementTree.Element:
    kind = "fixed" if moves is None else "prismatic" if moves.slide_mm is not None else "revolute"
    joint = ElementTree.SubElement(robot, "joint", name=f"{name}_joint", type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=name)
    _add_origin(joint, at_mm, turn_deg)
    return joint


def _add_motion(joint: ElementTree.Element, moves: MovesEntry) -> None:
    ElementTree.SubElement(joint, "axis", xyz=_show_numbers(moves.axis))
    low, high = (_convert_to_metres(v) if moves.slide_mm is not None else radians(v) for v in moves.limits)
    ElementTree.SubElement(
        joint, "limit", lower=_show_number(low), upper=_show_number(high), effort=EFFORT, velocity=SPEED
    )
    if moves.like is not None:
        ElementTree.SubElement(
            joint, "mimic", joint=f"{moves.like}_joint", multiplier=_show_number(moves.times)
        )


def _add_shape(role: ElementTree.Element, shape: ShapeEntry) -> None:
    _add_origin(role, shape.at_mm, shape.turn_deg)
    if shape.box_mm is not None:
        mesh, size = "box.stl", list(shape.box_mm)
    else:
        across, high = shape.cylinder_mm or (0.0, 0.0)
        mesh, size = "cylinder.stl", [across, across, high]
    geometry = ElementTree.SubElement(role, "geometry")
    ElementTree.SubElement(
        geometry, "mesh", filename=mesh, scale=_show_numbers([_convert_to_metres(v) for v in size])
    )
    if role.tag == "visual":
        ElementTree.SubElement(role, "material", name=shape.colour)


def _add_origin(element: ElementTree.Element, at_mm: Sequence[float], turn_deg: Sequence[float]) -> None:
    ElementTree.SubElement(
        element,
        "origin",
        xyz=_show_numbers([_convert_to_metres(value) for value in at_mm]),
        rpy=_show_numbers([radians(value) for value in turn_deg]),
    )


def _convert_to_metres(mm: float) -> float:
    return mm / 1000


def _show_numbers(values: Sequence[float]) -> str:
    return " ".join(_show_number(value) for value in values)


def _show_number(value: float) -> str:
    return f"{round(value, 12) + 0.0:.12g}"


def _make_box() -> list[tuple[Corner, Corner, Corner]]:
    found = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            ring = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
            corners = [_turn_corner(axis, side, *point) for point in (ring if side > 0 else ring[::-1])]
            found += [(corners[0], corners[1], corners[2]), (corners[0], corners[2], corners[3])]
    return found


def _turn_corner(axis: int, along: float, a: float, b: float) -> Corner:
    at = {axis: along, (axis + 1) % 3: a, (axis + 2) % 3: b}
    return at[0], at[1], at[2]


def _iterate_cylinder() -> Iterator[tuple[Corner, Corner, Corner]]:
    for number in range(SIDES):
        (ax, ay), (bx, by) = (
            (cos(2 * pi * corner / SIDES) / 2, sin(2 * pi * corner / SIDES) / 2)
            for corner in (number, (number + 1) % SIDES)
        )
        yield (0.0, 0.0, 0.5), (ax, ay, 0.5), (bx, by, 0.5)
        yield (0.0, 0.0, -0.5), (bx, by, -0.5), (ax, ay, -0.5)
        yield (ax, ay, -0.5), (bx, by, -0.5), (bx, by, 0.5)
        yield (ax, ay, -0.5), (bx, by, 0.5), (ax, ay, 0.5)


def _encode_stl(triangles: Sequence[tuple[Corner, Corner, Corner]]) -> bytes:
    """Binary STL. The normals are 0, so that programs compute them from the order of the corners."""
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(value for corner in triangle for value in corner), 0)
        for triangle in triangles
    )
    return b"LabOS unit mesh".ljust(80, b"\0") + struct.pack("<I", len(triangles)) + body
