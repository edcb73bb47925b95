"""Descriptions of instruments: what they take, what they refuse and where, and what is made of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.errors import NotFound
from labos.spec import SpecErrors
from labos.spec.describing import (
    apply_model,
    apply_variant,
    list_places,
    load_description,
    locate_parts,
    locate_places,
    make_plain,
)
from labos.spec.frames import frame, from_quaternion, spin
from labos.spec.source import parse

SHAKER = """
driver: shaker
instrument: A shaker with a drawer
footprint: {size_mm: [200, 300], height_mm: 150, from: sheet}
parts:
  body: {shapes: [{box_mm: [200, 300, 150], at_mm: [0, 0, 75]}]}
  drawer:
    on: body
    at_mm: [0, 0, 60]
    moves: {slide_mm: [0, 200], axis: [0, 1, 0], from: sheet}
    shapes: [{box_mm: [140, 100, 10]}]
  left: {on: drawer, moves: {slide_mm: [40, 60], axis: [-1, 0, 0]}, shapes: [{box_mm: [5, 90, 20]}]}
  right:
    on: drawer
    moves: {slide_mm: [40, 60], axis: [1, 0, 0], like: left}
    shapes: [{box_mm: [5, 90, 20]}]
stations:
  nest: {kind: nest, on: drawer, at_mm: [0, 0, 5]}
  shelf{n}: {kind: hotel, at_mm: [0, 0, 10], each: {n: {from_to: [2, 4], step_mm: [0, 0, 20]}}}
variants:
  wide: {models: [shaker_xl], footprint: {size_mm: [400, 300], height_mm: 150}}
sources: {sheet: a data sheet}
"""


def complaints(text: str) -> list[str]:
    with pytest.raises(SpecErrors) as refused:
        load_description(parse(text, "d.yaml"))
    return [str(error) for error in refused.value.errors]


def change_text(old: str, new: str) -> str:
    assert old in SHAKER
    return SHAKER.replace(old, new)


def test_a_description_is_read() -> None:
    shaker = load_description(parse(SHAKER))
    assert list(list_places(shaker)) == ["nest", "shelf2", "shelf3", "shelf4"]
    at = locate_places(shaker, {"drawer": 150})
    assert at["nest"].at == pytest.approx((0, 150, 65))
    assert at["shelf4"].at == pytest.approx((0, 0, 50))
    assert sorted(make_plain(shaker)["stations"]) == ["nest", "shelf2", "shelf3", "shelf4"]


def test_what_is_not_told_to_move_stands_at_its_nearest_limit() -> None:
    shaker = load_description(parse(SHAKER))
    assert locate_parts(shaker)["left"].at == pytest.approx((-40, 0, 60))
    assert locate_parts(shaker, {"left": 55})["right"].at == pytest.approx((55, 0, 60))


def test_variants_stand_in_place_of_what_they_change() -> None:
    shaker = load_description(parse(SHAKER))
    assert apply_variant(shaker, "wide").footprint.size_mm == [400, 300]
    assert apply_model(shaker, "Shaker_XL").footprint.size_mm == [400, 300]
    assert apply_model(shaker, "shaker").footprint.size_mm == [200, 300]
    assert apply_variant(shaker, "wide").parts == shaker.parts
    with pytest.raises(NotFound, match="Did you mean 'wide'"):
        apply_variant(shaker, "wyde")


@pytest.mark.parametrize(
    ("old", "new", "message", "at"),
    [
        ("on: body\n", "on: boddy\n", "There is no part 'boddy'", "boddy"),
        (
            "on: drawer, at_mm: [0, 0, 5]",
            "on: draw, at_mm: [0, 0, 5]",
            "There is no part 'draw'",
            "draw, at_mm",
        ),
        ("from: sheet}\nparts", "from: shet}\nparts", "There is no source 'shet'", "shet}"),
        ("from: sheet}\n    shapes", "from: memory}\n    shapes", "There is no source 'memory'", "memory"),
        ("like: left", "like: drower", "No part 'drower' moves by itself", "drower"),
        ("  body: {", "  base: {", "'base' is the instrument's own frame", "base: {"),
        ("  body: {", "  body: {on: left, ", "The part 'body' is on itself", "left, "),
        ("shelf{n}", "shelf{m}", "do not have the same numbers", "{kind: hotel"),
        ("[2, 4]", "[4, 2]", "The lower number comes first", "[4, 2]"),
        ("[0, 200]", "[200, 0]", "the upper one is greater", "{slide_mm: [200, 0]"),
        ("[0, 200]", "[0, 200], turn_deg: [0, 9]", "either slide_mm or turn_deg", "{slide_mm: [0, 200]"),
        ("axis: [0, 1, 0]", "axis: [0, 0, 0]", "axis has a direction", "{slide_mm: [0, 200]"),
        (
            "    shapes: [{box_mm: [140, 100, 10]}]\n",
            "",
            "The part 'drawer' moves and has no shape",
            "on: body",
        ),
        ("{box_mm: [140, 100, 10]}", "{}", "either box_mm or cylinder_mm", "{}"),
        ("[140, 100, 10]", "[140, -100, 10]", "greater than 0", "-100"),
        ("height_mm: 150, from", "hight_mm: 150, from", "The key 'hight_mm' is not known here", "hight_mm"),
        ("kind: hotel", "kind: hostel", "is not one of the choices", "hostel"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(old: str, new: str, message: str, at: str) -> None:
    text = change_text(old, new)
    before, _, _ = text.partition(at)
    place = f"d.yaml:{before.count(chr(10)) + 1}:{len(before.rpartition(chr(10))[2]) + 1}: "
    found = complaints(text)
    assert [line for line in found if message in line and line.startswith(place)], (place, found)


def test_a_variant_is_checked_where_it_is_written() -> None:
    text = change_text("wide: {models", "wide: {parts: {lid: {on: roof}}, models")
    found = complaints(text)
    assert any(line.startswith("d.yaml:21:28") and "'roof'" in line for line in found)
    assert any("There is no part 'drawer'" in line for line in found)  # its stations stand on what is gone


def test_reach_is_in_order() -> None:
    found = complaints(SHAKER + "reach: {radius_mm: [500, 100], height_mm: [0, 400]}\n")
    assert found == ["d.yaml:23:20: reach.radius_mm: The lower value comes first. Write them in order."]


def test_a_file_that_is_no_description(tmp_path: Path) -> None:
    assert any("The key 'footprint' is missing" in line for line in complaints("driver: x\n"))


def test_frames() -> None:
    there = frame((10, 20, 30), (30, 40, 50))
    assert there.angles == pytest.approx((30, 40, 50))
    back = there.then(there.inverse())
    assert back.at == pytest.approx((0, 0, 0), abs=1e-9)
    assert back.angles == pytest.approx((0, 0, 0), abs=1e-9)
    assert spin((0, 0, 2), 90).point((1, 0, 0)) == pytest.approx((0, 1, 0))
    assert from_quaternion((1, 2, 3), (0.7071, 0, 0, 0.7071)).point((1, 0, 0)) == pytest.approx((1, 3, 3))
    assert frame(turn_deg=(0, 90, 20)).angles[1] == pytest.approx(90)
