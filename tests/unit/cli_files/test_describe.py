"""``labos driver describe``: people read it, programs take its JSON, simulators its URDF."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from urdf_parser_py.urdf import URDF

from labos.errors import NotFound
from labos.spec import SpecErrors
from tests.unit.cli_files.calls import call


def test_people_see_size_parts_stations_and_where_numbers_come_from() -> None:
    shown = call("driver", "describe", "pf400")
    assert "footprint: 2300 × 260 mm, 840 mm high (assumed)" in shown
    assert "reach: 0 to 751 mm from the axis of inner_link" in shown
    assert "-93 to 93 ° about 0, 0, 1 (adsdl)" in shown
    assert "adsdl: AD-SDL/pf400_module" in shown
    rows = call("driver", "describe", "liconic")
    assert "stacker2_slot1…22" in rows
    assert "variant ur3e: Universal Robots UR3e" in call("driver", "describe", "ur")


def test_programs_get_every_station() -> None:
    told = json.loads(call("driver", "describe", "liconic", "--json"))
    assert told["stations"]["stacker3_slot22"]["at_mm"] == [0, 0, 20 + 21 * 23]
    assert told["footprint"]["from"] == "assumed"


def test_a_urdf_lies_beside_its_meshes(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    told = json.loads(call("driver", "describe", "ur", "--variant", "ur3e", "--urdf", str(folder), "--json"))
    assert told["written"] == [str(folder / name) for name in ("ur_ur3e.urdf", "box.stl", "cylinder.stl")]
    robot = URDF.from_xml_string((folder / "ur_ur3e.urdf").read_bytes())
    assert robot.name == "ur_ur3e"
    for link in robot.links:
        assert all((folder / visual.geometry.filename).is_file() for visual in link.visuals)


def test_a_new_driver_s_description_is_read(tmp_path: Path) -> None:
    call("driver", "new", str(tmp_path / "tea_stirrer"))
    path = tmp_path / "tea_stirrer" / "labos_tea_stirrer" / "description.yaml"
    assert "tea_stirrer: maker and model" in call("driver", "describe", str(path))


def test_a_description_with_errors_is_refused_with_their_places(tmp_path: Path) -> None:
    path = tmp_path / "description.yaml"
    path.write_text("driver: x\ninstrument: y\nfootprint: {size_mm: [1, -1], height_mm: 3}\n", "utf-8")
    with pytest.raises(SpecErrors) as refused:
        call("driver", "describe", str(path))
    found = str(refused.value)
    assert f"{path}:3:26: footprint.size_mm[1]" in found
    assert "The key 'parts' is missing" in found


def test_a_driver_without_a_description_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "bare_shaker.py").write_text(
        "from labos.node import Node\n\n\nclass Bare(Node):\n    driver = 'bare'\n", "utf-8"
    )
    with pytest.raises(NotFound, match=r"'bare' has no description\.yaml"):
        call("driver", "describe", str(tmp_path / "bare_shaker.py"))
