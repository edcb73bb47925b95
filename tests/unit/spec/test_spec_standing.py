"""Where modules stand, compared with how big they are and how far their arms reach."""

from __future__ import annotations

import pytest

from labos.bootstrap import descriptions, shape_of
from labos.spec import compile_workcell, find_spec
from labos.spec.layout_check import check_layout
from labos.spec.source import parse, read

TWO = """labos: 1
name: cell
modules:
  - {{name: sealer, model: A4S_sealer, coordinates: [{first}]}}
  - {{name: other, model: A4S_sealer, coordinates: [{second}]}}
"""
ARM = """labos: 1
name: cell
modules:
  - {{name: arm, driver: {arm}, coordinates: [0, 0, 0, 1, 0, 0, 0]}}
  - {{name: sealer, model: A4S_sealer, coordinates: [{place}]}}
locations:
  arm: {{sealer.default: [205, -2, 264, 365, 79, 411]}}
"""


def warnings(text: str) -> list[str]:
    source = parse(text, "cell.yaml", last_wins=True)
    found = check_layout(source, compile_workcell(source, descriptions()), shape_of)
    assert all(finding.severity == "warning" for finding in found)
    return [str(finding.as_error()) for finding in found]


@pytest.mark.parametrize(
    ("first", "second", "by"),
    [
        ("0, 0, 1, 1, 0, 0, 0", "0.2, 0, 1, 1, 0, 0, 0", "22 mm"),  # 222 mm wide
        ("0, 0, 1, 1, 0, 0, 0", "0, 0.4, 1.2, 1, 0, 0, 0", "100 mm"),  # 500 mm deep, one half above the other
        ("0, 0, 1, 1, 0, 0, 0", "0.3, 0, 1, 0.7071, 0, 0, 0.7071", "61 mm"),  # a quarter turned
    ],
)
def test_footprints_that_overlap(first: str, second: str, by: str) -> None:
    (found,) = warnings(TWO.format(first=first, second=second))
    assert found.startswith(
        "cell.yaml:5:51: modules[1].coordinates: The footprints of sealer and other overlap"
    )
    assert f"by {by}." in found


@pytest.mark.parametrize(
    "second",
    [
        "0.23, 0, 1, 1, 0, 0, 0",  # beside it
        "0, 0, 1.3, 1, 0, 0, 0",  # on a shelf above it
        "0.29, 0.29, 1, 0.924, 0, 0, 0.383",  # corner to side
    ],
)
def test_footprints_that_do_not(second: str) -> None:
    assert warnings(TWO.format(first="0, 0, 1, 1, 0, 0, 0", second=second)) == []


def test_the_same_numbers_for_several_are_no_places() -> None:
    (found,) = warnings(TWO.format(first="0, 0, 0, 1, 0, 0, 0", second="0, 0, 0, 1, 0, 0, 0"))
    assert "other has the same coordinates as sealer" in found


def test_a_station_beyond_an_arm() -> None:
    text = ARM.format(arm="ur", place="1.6, 0, 0, 1, 0, 0, 0")
    (found,) = warnings(text)
    assert found.startswith(
        "cell.yaml:7:9: locations.arm.sealer.default: By its coordinates sealer.default is 16"
    )
    assert "whose hand comes 1097 mm far" in found
    assert warnings(ARM.format(arm="ur", place="0.8, 0, 0, 1, 0, 0, 0")) == []
    (found,) = warnings(ARM.format(arm="ur", place="0.8, 0, 1.6, 1, 0, 0, 0"))
    assert "1695 mm above the foot of arm" in found


def test_a_rail_takes_an_arm_along() -> None:
    assert warnings(ARM.format(arm="pf400", place="1.5, 0.2, 0, 1, 0, 0, 0")) == []
    (found,) = warnings(ARM.format(arm="pf400", place="0.5, 0.9, 0, 1, 0, 0, 0"))
    assert "1258 mm from the axis of arm, whose hand comes 751 mm far" in found


def test_a_reach_in_the_file_counts_like_a_taught_place() -> None:
    text = ARM.format(arm="ur", place="1.6, 0, 0, 1, 0, 0, 0")
    text = text.partition("locations:")[0] + "stations:\n  sealer.default: {reach: {arm: []}}\n"
    (found,) = warnings(text)
    assert found.startswith("cell.yaml:7:20: stations.sealer.default.reach: ")


def test_modules_without_coordinates_or_descriptions_are_let_be() -> None:
    assert warnings(TWO.replace(", coordinates: [{second}]", "").format(first="0, 0, 1, 1, 0, 0, 0")) == []
    source = parse(TWO.format(first="0, 0, 1, 1, 0, 0, 0", second="0, 0, 1, 1, 0, 0, 0"))
    assert check_layout(source, compile_workcell(source, descriptions()), lambda driver: None) == []


def test_the_packaged_workcell_stands_well() -> None:
    source = read(find_spec("workcells", "rpl"), last_wins=True)
    assert check_layout(source, compile_workcell(source, descriptions()), shape_of) == []
