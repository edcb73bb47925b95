"""A lab that brings MADSci's files sees its workflow run in the simulation: as it is, and imported."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.lab_process import labos

SETTINGS = """\
workcell_manager_name: Example Workcell
resource_default_templates:
  - {template_name: nest, base_resource: {base_type: slot, capacity: 1}}
  - {template_name: rack, base_resource: {base_type: stack, capacity: 16}}
workcell_nodes:
  liquidhandler_1: http://localhost:2000/
  robotarm_1: http://localhost:2002/
  platereader_1: http://localhost:2003/
location_locations:
  - location_name: platereader_1.plate_carriage
    representations: {robotarm_1: {gripper_config: wide, position: [15, 10, 8]}}
    resource_template_name: nest
  - location_name: storage_rack
    representations: {robotarm_1: {gripper_config: wide, position: [30, 25, 10]}}
    resource_template_name: rack
"""

FLOW = """\
name: Feed forward
parameters:
  feed_forward:
    - {key: seen, parameter_type: feed_forward_file, step: read, label: example_file}
    - {key: value, step: read, label: absorbance}
steps:
  - name: Get
    node: robotarm_1
    action: transfer
    locations: {source: storage_rack, target: platereader_1.plate_carriage}
  - {name: Generate, key: read, node: platereader_1, action: create_plate_file}
  - {name: Read, node: liquidhandler_1, action: run_protocol, files: {protocol: seen}}
  - {name: Set, node: liquidhandler_1, action: run_command, use_parameters: {args: {command: value}}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "workflows").mkdir()
    (tmp_path / "settings.yaml").write_text(SETTINGS)
    (tmp_path / "workflows" / "flow.yaml").write_text(FLOW)
    return tmp_path


@pytest.mark.parametrize(
    "way",
    [
        pytest.param("as it is", marks=pytest.mark.full),
        pytest.param("placed", marks=pytest.mark.full),
        "imported",
    ],
)
def test_a_workflow_that_feeds_results_forward(folder: Path, way: str) -> None:
    """The workcell is the one beside it; the stack holds what is taken from it; what is read is returned."""
    workflow = folder / "workflows" / "flow.yaml"
    if way == "imported":
        assert labos("import", str(folder), "-o", str(folder / "out")).returncode == 0
        workflow = folder / "out" / "workflows" / "flow.yaml"
    home = ["--home", str(folder / "lab"), "--speed", "1000"]
    placed = ["--place", "storage_rack=plate96"] if way == "placed" else []
    done = labos("run", str(workflow), "--simulate", *home, *placed)
    assert done.returncode == 0, done.stderr
    assert "completed; 4 of 4 steps" in done.stdout
    assert ("plate96 is assumed to stand at wc.storage_rack" in done.stderr) == (way != "placed")


def test_of_two_workcells_one_has_to_be_named(folder: Path) -> None:
    (folder / "other.yaml").write_text(SETTINGS)
    done = labos("run", str(folder / "workflows" / "flow.yaml"), "--simulate", "--home", str(folder / "lab"))
    assert done.returncode == 1
    assert "holds other.yaml, settings.yaml" in done.stderr
    assert "--workcell" in done.stderr
    assert not (folder / "lab").exists()
