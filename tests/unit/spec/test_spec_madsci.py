"""Workcells and workflows as MADSci writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from spec_bench import BENCH, DESCRIPTIONS, where

from labos.errors import SpecError
from labos.spec import (
    compile_workflow,
    load_workcell,
    parse_source,
    parse_workflow,
    validate_workcell,
    validate_workflow,
)
from labos.spec.dialects import convert_workcell, convert_workflow, detect_kind
from labos.spec.findings import Finding, FindingList
from labos.spec.importing import import_spec
from labos.spec.models import WorkcellFile, WorkflowFile
from labos.spec.validation import validate

SETTINGS = """\
lab_server_url: http://localhost:8000/
workcell_manager_name: Cell 3/4
workcell_manager_description: A small one
workcell_nodes:
  arm: http://localhost:2002/
  sealer: https://sealer.lab:2000/
  silo: sila://localhost:50042
location_locations:
  - location_name: sealer.default
    location_id: 01K5HDZZCF27YHD2WDGSXFPPKF
    resource_id: 01K5HDZZCF27YHD2WDGSXFPPKG
    description: Where it seals
    representations:
      arm: [1, 2, 3.5]
      sealer: {slot: 1}
    resource_template_name: nest
  - location_name: storage
    representations: {arm: {grip: wide, at: [1, 2]}, ghost: 5}
    resource_template_name: rack
    resource_template_overrides: {capacity: 16}
  - {location_name: far.away.place, resource_template_name: nobody}
resource_default_templates:
  - {template_name: nest, base_resource: {base_type: slot, capacity: 1}}
  - {template_name: rack, base_resource: {base_type: stack, capacity: 8}}
location_transfer_capabilities: {transfer_templates: []}
"""


def workcell(text: str, folder: Path | None = None) -> tuple[WorkcellFile, tuple[Finding, ...]]:
    source = parse_source(text, str(folder / "settings.yaml") if folder else "settings.yaml", folder)
    report = FindingList(source.file)
    assert detect_kind(source) == ("workcell", "madsci")
    form, dialect = convert_workcell(source, report)
    assert dialect == "madsci"
    file = validate(WorkcellFile, form, report)
    assert file is not None, report.sort_findings()
    return file, report.sort_findings()


def test_a_labs_settings() -> None:
    file, findings = workcell(SETTINGS)
    assert (file.name, file.description) == ("Cell 3_4", "A small one")
    arm, sealer, silo = file.modules
    assert (arm.name, arm.interface) == ("arm", "madsci_rest_node")
    assert arm.config == {
        "node_url": "http://localhost:2002/",
        "resource_ids": {"sealer.default": "01K5HDZZCF27YHD2WDGSXFPPKG"},
        "representations": {"wc.storage": {"grip": "wide", "at": [1, 2]}},
    }
    assert sealer.config["representations"] == {"sealer.default": {"slot": 1}}
    assert silo.interface == "madsci_sila_node"
    assert file.locations == {"arm": {"sealer.default": [1, 2, 3.5], "wc.storage": []}}
    storage = file.stations["wc.storage"]
    assert (storage.kind, storage.capacity, storage.aliases) == ("stack", 16, ["storage"])
    assert file.stations["sealer.default"].comment == "Where it seals"
    assert file.stations["wc.far_away_place"].kind == "nest"
    assert file.stock == {}
    assert [where(finding) for finding in findings] == [(1, 1), (17, 5), (21, 5)]


def test_locations_beside_the_settings(tmp_path: Path) -> None:
    (tmp_path / "locations.yaml").write_text("""\
representation_templates:
  - {template_name: deck, default_values: {grip: narrow, speed: 3}, required_overrides: [position]}
location_templates:
  - {template_name: slot, representation_templates: {arm: deck}}
locations:
  - location_name: sealer.default
    template_name: slot
    node_bindings: {arm: robot}
    representation_overrides: {arm: {position: 7, speed: 4}}
  - {location_name: shelf, representations: {nobody: 1}}
""")
    file, findings = workcell("workcell_nodes: {robot: 'http://r', sealer: 'http://s'}", tmp_path)
    assert file.modules[0].config["representations"] == {
        "sealer.default": {"grip": "narrow", "speed": 4, "position": 7}
    }
    assert set(file.stations) == {"sealer.default", "wc.shelf"}
    assert [(Path(f.file).name, f.line) for f in findings] == [("locations.yaml", 10)]


def test_a_workcell_managers_definition() -> None:
    text = """\
name: Old
manager_type: workcell_manager
nodes: {sealer: "http://localhost:2000"}
locations:
  - {location_name: spot, references: {sealer: [1, 2]}, resource_definition: {base_type: grid, capacity: 4}}
"""
    file, findings = workcell(text)
    assert (file.stations["wc.spot"].kind, file.stations["wc.spot"].capacity) == ("hotel", 4)
    assert file.locations == {"sealer": {"wc.spot": [1, 2]}}
    assert not findings


def test_nodes_that_a_driver_serves_by_name_can_be_used(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("workcell_nodes: {sealer: 'http://x', other: 'http://y'}\n")
    loaded = load_workcell(path, DESCRIPTIONS)
    assert [module.driver for module in loaded.workcell.modules] == ["sealer"]
    assert loaded.workcell.modules[0].config["interface"] == "madsci_rest_node"
    [finding] = loaded.findings
    assert "There is no driver for the module 'other'" in finding.message


@pytest.mark.parametrize(
    ("text", "line", "column", "says"),
    [
        ("workcell_nodes: 5\n", 1, 17, "must be a table"),
        ("workcell_nodes:\n  a: 5\n", 2, 6, "has no address"),
        ("workcell_nodes: {a: 'http://x'}\nlocation_locations:\n  - {}\n", 3, 5, "no name"),
        (
            "workcell_nodes: {a: 'http://x'}\nlocations: [{name: b}, {name: b}]\n",
            2,
            24,
            "is listed twice",
        ),
        (
            "nodes: {a: 'http://x'}\n"
            "location_templates: [{template_name: t, representation_templates: {r: x}}]\n"
            "locations: [{name: b, template_name: t}]\n",
            3,
            13,
            "names no node for the role 'r'",
        ),
    ],
)
def test_workcells_that_are_not_understood(text: str, line: int, column: int, says: str) -> None:
    findings = validate_workcell(parse_source(text, "settings.yaml"), DESCRIPTIONS)
    fault = next(finding for finding in findings if finding.severity == "error")
    assert says in fault.message
    assert where(fault) == (line, column)
    assert fault.remedy


# -- workflows ---------------------------------------------------------------------------------

FLOW = """\
name: Read it
description: All that steps can say
metadata: {author: Ada, version: 1.0}
parameters:
  json_inputs:
    - {key: time, default: 4, description: how long}
    - {key: temp}
    - {key: what, default: seal}
  file_inputs: [{key: protocol, description: what to do}]
  feed_forward:
    - {key: picture, step: look, label: image}
    - {key: again, label: named}
    - {key: first, step: 0}
steps:
  - {name: Fetch, node: stack, action: get_plate, locations: {loc: tower1}}
  - {action: wait, args: {seconds: 5}}
  - {name: Look, key: look, node: cam, action: take_picture, data_labels: {image: named}}
  - name: Mix
    node: ot2
    action: run_protocol
    arguments: {use_existing_resources: true, empty: null}
    files: {config_path: protocol}
    conditions: [{condition_type: resource_present}]
  - key: press
    node: sealer
    description: with steam
    params: {action: what, args: {time: time, temperature: temp}}
  - {name: Look, node: cam, action: take_picture, use_parameters: {args: {file_name: again}}}
  - {name: Last, node: cam, action: take_picture, use_parameters: {args: {file_name: first}}}
  - {name: Inline, node: cam, action: take_picture,
     use_parameters: {args: {file_name: {key: called, parameter_type: json_input, default: x.jpg}}}}
"""


def workflow(text: str) -> tuple[WorkflowFile, tuple[Finding, ...]]:
    source = parse_workflow(text, "flow.yaml")
    report = FindingList(source.file)
    assert detect_kind(source) == ("workflow", "madsci")
    form, dialect = convert_workflow(source, report)
    assert dialect == "madsci"
    file = validate(WorkflowFile, form, report)
    assert file is not None, report.sort_findings()
    return file, report.sort_findings()


def test_all_that_steps_can_say() -> None:
    file, findings = workflow(FLOW)
    assert (file.name, file.description) == ("Read it", "All that steps can say")
    assert file.metadata == {"author": "Ada", "version": 1.0}
    parameters = {name: (p.required, p.default) for name, p in file.parameters.items()}
    assert parameters == {
        "time": (False, 4),
        "temp": (True, None),
        "what": (False, "seal"),
        "protocol": (True, None),
        "called": (False, "x.jpg"),
    }
    fetch, look, mix, press, look2, last, inline = file.steps
    assert fetch.args == {"loc": "tower1"}
    assert [(wait.after, wait.at_least) for wait in look.wait] == [("Fetch", 5.0)]
    assert mix.args == {"use_existing_resources": True, "config_path": "payload.protocol"}
    assert (press.name, press.action, press.comment) == ("press", "payload.what", "with steam")
    assert press.args == {"time": "payload.time", "temperature": "payload.temp"}
    assert look2.args == {"file_name": "steps.Look#1.result.image"}
    assert last.args == {"file_name": "steps.Fetch.result"}
    assert inline.args == {"file_name": "payload.called"}
    assert [where(finding) for finding in findings] == [(23, 5)]


@pytest.mark.parametrize(
    ("label", "field"), [("", ""), (", label: image", ".image"), (", label: named", ".image")]
)
def test_files_are_fed_forward(label: str, field: str) -> None:
    file, findings = workflow(f"""\
name: x
parameters:
  - {{key: seen, parameter_type: feed_forward_file, step: look{label}}}
steps:
  - {{name: Look, key: look, node: cam, action: take_picture, data_labels: {{image: named}}}}
  - {{name: Mix, node: ot2, action: run_protocol, files: {{config_path: seen}}}}
""")
    assert file.steps[1].args == {"config_path": f"steps.Look.result.files{field}"}
    assert not findings


def test_a_workflow_runs_on_a_workcell_that_serves_its_nodes() -> None:
    text = """\
name: Seal
params: [{name: seconds, type: number, default: 2}]
steps:
  - {name: Get, node: stack, action: get_plate, location_args: {loc: tower1}, comment: first}
  - {name: Move, node: arm, action: transfer, locations: {source: stack.exchange, target: sealer.default}}
  - {action: wait, args: {seconds: 60}}
  - {name: Seal, node: sealer, action: seal, use_parameters: {args: {time: seconds}}}
"""
    result = compile_workflow(
        parse_workflow(text, "f.yaml"), {}, BENCH.workcell, DESCRIPTIONS, bench=BENCH.bench
    )
    seal = result.plan.steps[2]
    assert seal.args["time"] == 2
    assert [(window.anchor, window.wait_s) for window in seal.windows] == [(1, 60.0)]
    assert result.outputs == ("wc1/sealer.default",)


STEP = "name: x\nsteps:\n  - "


@pytest.mark.parametrize(
    ("text", "line", "column", "says"),
    [
        (STEP + "{action: transfer_resource, args: {target: b}}", 3, 14, "names a resource of MADSci"),
        (STEP + "{action: wait}", 3, 5, "does not say how long"),
        (STEP + "{node: a}", 3, 5, "no action"),
        (STEP + "{node: a, action: b, params: {action: c}}", 3, 43, "'c' is not declared"),
        (
            "name: x\nparameters: {feed_forward: [{key: k, step: 0}]}\nsteps:\n"
            "  - {name: a, node: b, action: c}\n  - {action: d, params: {node: k}}",
            5,
            32,
            "must be known before the run",
        ),
        (STEP + "{node: a, action: b, params: {args: {c: d}}}", 3, 45, "'d' is not declared"),
        (STEP + "{node: a, action: b, files: {c: d}}", 3, 37, "'d' is not declared"),
        (STEP + "{node: a, action: b, args: {c: 1}, locations: {c: d}}", 3, 52, "given twice"),
        (STEP + "{node: a, action: b, locations: {c: [1, 2]}}", 3, 41, "joint angles do not show"),
        (
            "name: x\nparameters: {feed_forward: [{key: k, step: later}]}\nsteps:\n"
            "  - {node: a, action: b, params: {args: {c: k}}}",
            2,
            29,
            "No step gives 'later'",
        ),
        ("name: x\nparameters: [{key: a}, {key: a}]\nsteps: [{node: a, action: b}]", 2, 24, "declared twice"),
        ("name: x\nparameters: [{key: 'a b'}]\nsteps: [{node: a, action: b}]", 2, 14, "no key"),
    ],
)
def test_workflows_that_are_not_understood(text: str, line: int, column: int, says: str) -> None:
    findings = validate_workflow(parse_workflow(text, "f.yaml"), {}, BENCH.workcell, DESCRIPTIONS)
    fault = next(finding for finding in findings if finding.severity == "error")
    assert says in fault.message
    assert where(fault) == (line, column)
    assert fault.remedy


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("node_name: arm\nmodule_name: robot\n", "settings.yaml"),
        ("representation_templates: []\nlocations: []\n", "settings.yaml"),
        ("manager_type: location_manager\nlocations: []\n", "into it"),
        ("services: {}\n", "Docker Compose"),
        ("workcell_server_url: http://localhost:8005/\n", "workcell_nodes"),
    ],
)
def test_files_that_are_no_specs_say_what_they_are(text: str, says: str) -> None:
    with pytest.raises(SpecError) as caught:
        detect_kind(parse_source(text, "f.yaml"))
    assert says in caught.value.remedy
    assert caught.value.line == 1


def test_waiting_before_and_after_everything_is_left_out() -> None:
    wait: dict[str, Any] = {"action": "wait", "args": {"seconds": 1}}
    text = f"name: x\nsteps: [{wait}, {{node: a, action: b}}, {wait}]"
    file, findings = workflow(text)
    assert [step.action for step in file.steps] == ["b"]
    assert file.steps[0].name == "b"
    assert not file.steps[0].wait
    assert len(findings) == 2


def test_a_node_that_the_run_decides() -> None:
    text = """\
name: Open
parameters: {json_inputs: [{key: which}, {key: what, default: open_lid}]}
steps:
  - {name: open it, params: {node: which, action: what}}
"""
    source = parse_workflow(text, "f.yaml")
    result = compile_workflow(source, {"which": "cycler"}, BENCH.workcell, DESCRIPTIONS)
    assert [(step.module, step.action) for step in result.plan.steps] == [("wc1/cycler", "open_lid")]
    for payload, says in (
        ({}, "The payload has no 'which'"),
        ({"which": "sycler"}, "Did you mean 'cycler'"),
        ({"which": 5}, "The module is not a text"),
    ):
        [finding] = validate_workflow(source, payload, BENCH.workcell, DESCRIPTIONS)
        assert says in f"{finding.message} {finding.remedy}"
        assert where(finding) == (4, 36)


def test_what_was_assumed_stands_at_its_place_when_rewritten() -> None:
    lines = import_spec(parse_workflow(FLOW, "flow.yaml"), DESCRIPTIONS).text.splitlines()
    comment = next(n for n, line in enumerate(lines) if "'conditions'" in line)
    assert lines[comment + 1] == "  - name: Mix"
    lines = import_spec(parse_workflow(SETTINGS, "settings.yaml"), DESCRIPTIONS).text.splitlines()
    comment = next(n for n, line in enumerate(lines) if "'ghost'" in line)
    assert lines[comment + 1] == "  wc.storage:"
