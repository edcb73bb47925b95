"""Labware types of a lab's own: files that a workcell names."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.bootstrap import descriptions
from labos.core.model import LabwareSpec, WellGrid
from labos.spec import CompiledWorkcell, SpecErrors, load_workcell, parse_workcell
from labos.spec.dialects import detect_kind
from labos.spec.labware import read_labware_files
from labos.spec.source import read

DEEP = """\
labos: 1
labware:
  deep96:
    footprint: {length_mm: 127.76, width_mm: 85.48, height_mm: 44}
    wells: {rows: 8, columns: 12, pitch_mm: 9, a1_x_mm: 14.38, a1_y_mm: 11.24, volume_ul: 2000}
    grips: [narrow]
    stackable: false
"""

CELL = """\
labos: 1
name: corner
labware: [labware/deep.yaml]
modules:
  - {name: stacker, model: sciclops}
  - {name: arm, model: pf400, regrip: wc.turn}
stations:
  wc.shelf: {kind: hotel, capacity: 5, accepts: [deep96]}
  wc.turn: {}
locations:
  arm:
    wc.shelf: [188.2, -12.5, 251.9, 388.2, 80.1, 151.3]
    wc.turn: [188.2, -12.5, 251.9, 388.2, 80.1, 151.3]
stock: {}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "labware").mkdir()
    (tmp_path / "labware" / "deep.yaml").write_text(DEEP)
    return tmp_path


def load(folder: Path, text: str = CELL) -> CompiledWorkcell:
    (folder / "corner.yaml").write_text(text)
    return load_workcell(folder / "corner.yaml", descriptions())


def faults(folder: Path, text: str = CELL) -> list[str]:
    with pytest.raises(SpecErrors) as found:
        load(folder, text)
    return [str(error).replace(f"{folder}/", "") for error in found.value.errors]


def list_findings(text: str) -> list[str]:
    return [str(finding) for finding in parse_workcell(text, descriptions(), "c.yaml").findings]


def test_a_type_of_the_labs_own_is_kept_with_the_workcell(folder: Path) -> None:
    cell = load(folder)
    assert cell.findings == ()
    wells = WellGrid(8, 12, 9, 14.38, 11.24, 2000)
    deep = LabwareSpec("deep96", 127.76, 85.48, 44, wells, stackable=False, grips=("narrow",))
    known = {kind.name: kind for kind in cell.workcell.labware}
    assert known["deep96"] == deep
    assert {"plate96", "pcr96"} <= set(known), "and those that come with LabOS"
    stations = {station.name: station for station in cell.workcell.stations}
    arm = cell.workcell.modules[1].name
    assert stations["corner/wc.shelf"].list_grips(arm, "deep96") == ("narrow",)  # type: ignore[index]
    assert stations["corner/wc.shelf"].list_grips(arm, "plate96") == ()  # type: ignore[index]
    assert stations["corner/stacker.tower1"].refuses == ("deep96",)  # type: ignore[index]
    assert detect_kind(read(folder / "corner.yaml")) == ("workcell", "labos")


def test_a_change_of_a_labware_file_is_a_change_of_the_workcell(folder: Path) -> None:
    before = load(folder).workcell.digest
    assert load(folder).workcell.digest == before
    (folder / "labware" / "deep.yaml").write_text(DEEP.replace("2000", "2200"))
    assert load(folder).workcell.digest != before


def test_a_folder_of_files_some_of_them_opentrons(folder: Path) -> None:
    wells = {
        f"{row}{column + 1}": {"x": 14 + 20 * column, "y": 70 - 20 * at, "depth": 10, "totalLiquidVolume": 9}
        for column in range(3)
        for at, row in enumerate("AB")
    }
    six = {
        "ordering": [["A1", "B1"], ["A2", "B2"], ["A3", "B3"]],
        "parameters": {"loadName": "acme_6"},
        "dimensions": {"xDimension": 127.76, "yDimension": 85.48, "zDimension": 20},
        "wells": wells,
    }
    (folder / "labware" / "six.json").write_text(json.dumps(six))
    for written in ("labware/", "[labware]", "[labware, ./labware/deep.yaml]"):
        cell = load(folder, CELL.replace("[labware/deep.yaml]", written))
        assert {"acme_6", "deep96"} <= {kind.name for kind in cell.workcell.labware}


def test_a_text_comes_with_its_labware_files(folder: Path) -> None:
    cell = load(folder)
    sent = read_labware_files(read(folder / "corner.yaml"))
    assert sent == {"labware/deep.yaml": DEEP.encode()}
    (folder / "labware" / "deep.yaml").unlink()
    again = parse_workcell(CELL, descriptions(), "elsewhere/corner.yaml", sent)
    assert again.workcell == cell.workcell
    with pytest.raises(SpecErrors, match=r"labware/deep.yaml': none was sent along"):
        parse_workcell(CELL, descriptions(), "corner.yaml", {})
    with pytest.raises(SpecErrors, match="was not loaded from a folder"):
        parse_workcell(CELL, descriptions(), "corner.yaml")


def test_faults_are_told_where_they_are(folder: Path) -> None:
    (folder / "labware" / "deep.yaml").write_text(DEEP.replace("volume_ul: 2000", "volume_ul: 0"))
    assert faults(folder)[0].startswith("labware/deep.yaml:5:91: labware.deep96.wells.volume_ul: The value 0")
    (folder / "labware" / "deep.yaml").write_text("labos: 1\nlabwares: {}\n")
    assert faults(folder) == [
        "labware/deep.yaml:1:1: This is no labware file. Write its types below `labware:`."
    ]
    (folder / "labware" / "deep.yaml").write_text(DEEP.replace("deep96", "any"))
    assert any("'any' cannot be a labware type's name" in fault for fault in faults(folder))
    (folder / "labware" / "deep.yaml").write_text("labware: [\n")
    assert "labware/deep.yaml:2:1: This is not YAML" in faults(folder)[0]
    missing = CELL.replace("labware/deep.yaml", "labware/deep.yaml, deap.yaml")
    (folder / "labware" / "deep.yaml").write_text(DEEP)
    (fault,) = faults(folder, missing)
    assert fault.startswith("corner.yaml:3:30: labware[1]: There is no labware file 'deap.yaml'")
    (folder / "labware" / "twice.yaml").write_text(DEEP)
    (fault,) = faults(folder, CELL.replace("labware/deep.yaml", "labware"))
    assert fault.startswith("labware/twice.yaml:3:3: labware.deep96: The labware type 'deep96' is defined in")
    assert "deep.yaml too. Remove or rename one of them." in fault


def test_what_cannot_be_stacked_is_refused_on_stacks(folder: Path) -> None:
    on_stack = CELL.replace("wc.turn: {}", "wc.turn: {}\n  stacker.tower1: {accepts: [plate96, deep96]}")
    (fault,) = faults(folder, on_stack)
    assert fault.startswith(
        "corner.yaml:10:39: stations.stacker.tower1.accepts[1]: Labware of the type deep96 cannot be stacked"
    )
    (fault,) = faults(folder, CELL.replace("stock: {}", "stock: {stacker.tower1: {deep96: 2}}"))
    assert "does not accept 'deep96'. Pieces of this type cannot be stacked." in fault
    alone = on_stack.replace("plate96, deep96]", "deep96], capacity: 1")
    assert [f.message for f in load(folder, alone).findings] == []


def test_a_slip_of_the_pen_is_told_and_works_all_the_same() -> None:
    plain = CELL.replace("labware: [labware/deep.yaml]\n", "")
    (deep,) = list_findings(plain)
    assert deep.startswith("c.yaml:7:50: stations.wc.shelf.accepts[0]: Nobody describes the labware type")
    assert "Describe it in a labware file, and name that under `labware:`." in deep
    (slip,) = list_findings(plain.replace("deep96", "plate69"))
    assert "Did you mean 'plate96'? Else describe it in a labware file" in slip
    cell = parse_workcell(plain, descriptions())
    shelf = next(s for s in cell.workcell.stations if s.name.endswith("wc.shelf"))
    assert shelf.accepts == ("deep96",)
    lidded = plain.replace("stock: {}", "stock: {wc.shelf: {pcr96+lid96: 1}}")
    assert list_findings(lidded.replace("[deep96]", "[pcr96]")) == []
    more = lidded.replace("[deep96]", "[flask]").replace("pcr96+lid96", "flask+cap")
    assert [text.split(":")[1] for text in list_findings(more)] == ["7", "13"]


POSE = "[188.2, -12.5, 251.9, 388.2, 80.1, 151.3]"
TYPED = f"{{any: {POSE}, deep96: [210.2, -12.5, 251.9, 388.2, 80.1, 151.3]}}"


def test_a_place_may_have_a_pose_for_a_type(folder: Path) -> None:
    cell = load(folder, CELL.replace(f"wc.shelf: {POSE}", f"wc.shelf: {TYPED}"))
    assert cell.findings == ()
    arm = cell.workcell.modules[1].config
    assert arm["poses"]["wc.shelf"][0] == 188.2
    assert arm["poses_of"] == {"deep96": {"wc.shelf": [210.2, -12.5, 251.9, 388.2, 80.1, 151.3]}}
    shelf = next(s for s in cell.workcell.stations if s.name.endswith("wc.shelf"))
    assert list(shelf.reach) == ["corner/arm"]


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        (POSE, f"{{deep96: {POSE}}}", "arm has no pose for wc.shelf with labware of other types."),
        (POSE, "{any: 5}", "The value 5 does not fit"),
        ("arm, model: pf400", "arm, model: platecrane", "The driver of arm has one pose for all labware."),
    ],
)
def test_what_is_wrong_with_the_pose_of_a_type(folder: Path, before: str, after: str, fault: str) -> None:
    text = CELL.replace(f"wc.shelf: {POSE}", f"wc.shelf: {TYPED}")
    text = text.replace(TYPED if before == POSE else before, after)
    found = faults(folder, text)
    assert any(fault in told and told.startswith("corner.yaml:1") for told in found), found


def test_a_pose_of_a_type_that_nobody_describes_is_told(folder: Path) -> None:
    text = CELL.replace(f"wc.shelf: {POSE}", f"wc.shelf: {TYPED.replace('deep96', 'deep69')}")
    (finding,) = load(folder, text).findings
    assert (finding.field, finding.line) == ("locations.arm.wc.shelf.deep69", 12)
    assert "Did you mean 'deep96'" in finding.remedy
