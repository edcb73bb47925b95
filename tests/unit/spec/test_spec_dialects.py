"""Workflows as the paper and its relatives write them."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest

from labos.core.canonical import digest
from labos.core.effects import Move, Take
from labos.core.model import Plan
from labos.spec import (
    SpecErrors,
    compile_workflow,
    load_workcell,
    parse_workcell,
    parse_workflow,
    validate_workflow,
)
from labos.spec.dialects import convert_workflow
from labos.spec.findings import FindingList
from labos.spec.models import WorkflowFile
from labos.spec.validation import validate
from tests.unit.spec.spec_bench import BENCH, DESCRIPTIONS, PAPER, where

RPL = load_workcell(PAPER / "rpl_modular_workcell.yaml", DESCRIPTIONS)
VOLUMES = {
    "color_A_volumes": [1.0, 2.0],
    "color_B_volumes": [3, 4],
    "color_C_volumes": [5, 6],
    "destination_wells": ["A1", "A2"],
    "use_existing_resources": True,
}


@pytest.mark.parametrize("payload", [{"seal.time": 3}, {"seal": {"time": 3}}])
def test_the_papers_pcr_workflow(payload: dict[str, Any]) -> None:
    result = compile_workflow(
        PAPER / "pcr_demo_wf.yaml", payload, RPL.workcell, DESCRIPTIONS, simulate=True, bench=RPL.bench
    )
    assert len(result.plan.steps) == 14
    assert [step.after for step in result.plan.steps] == [(), *((n,) for n in range(13))]
    first, second = result.plan.steps[0], result.plan.steps[1]
    assert [type(effect) for effect in first.effects] == [Take]
    assert first.effects[0].stack == "RPL_Modular_workcell/sciclops.tower2"  # type: ignore[union-attr]
    [effect] = second.effects
    assert isinstance(effect, Move)
    assert (effect.source_grip, effect.target_grip, effect.via) == ("narrow", "wide", "")
    assert second.args["target"] == "ot2_pcr_alpha.deck1_cooler"
    assert result.plan.steps[4].args == {"time": 3, "temperature": 175}
    assert result.inputs == ()
    assert result.outputs == ("RPL_Modular_workcell/wc.trash",)
    [finding] = result.findings
    assert (finding.severity, finding.line, finding.column) == ("warning", 51, 20)
    assert finding.field == "flowdef[2].args.config_path"
    assert msgspec.json.decode(msgspec.json.encode(result.plan), type=Plan) == result.plan


def test_the_papers_color_picker_workflow() -> None:
    content = b"protocol"
    result = compile_workflow(
        PAPER / "cp_wf_mixcolor.yaml",
        VOLUMES,
        RPL.workcell,
        DESCRIPTIONS,
        files={"combined_protocol.yaml": content},
    )
    assert result.inputs == result.outputs == ("RPL_Modular_workcell/camera_module.plate_station",)
    mix = result.plan.steps[1]
    assert mix.args["color_A_volumes"] == [1.0, 2.0]
    assert mix.args["use_existing_resources"] is True
    assert result.plan.files == {"combined_protocol.yaml": digest(content)}
    assert result.files == {digest(content): content}
    assert not result.findings


def test_a_missing_file_and_missing_payload_of_the_papers_workflow() -> None:
    findings = validate_workflow(PAPER / "cp_wf_mixcolor.yaml", {}, RPL.workcell, DESCRIPTIONS)
    assert [where(finding) for finding in findings][:2] == [(28, 20), (29, 24)]
    assert "'combined_protocol.yaml' was not found" in findings[0].message
    assert "'Mix all colors', argument 'color_A_volumes'" in findings[1].message
    assert len(findings) == 6


def test_wei_parameters_files_and_forgotten_things() -> None:
    text = """\
metadata: {name: old}
parameters: [{name: t, default: 3}, {name: p}]
modules: [sealer, {name: nobody}]
flowdef:
  - {module: sealer, command: seal, args: {time: $t, unused: null, foo: bar}, checks: null, comments: 5}
  - {name: r, module: ot2, command: run_protocol, files: {config_path: "a_${p}.yaml"}, priority: 1}
"""
    source = parse_workflow(text, "old.yaml")
    result = compile_workflow(source, {"p": "q"}, BENCH.workcell, DESCRIPTIONS, files={"a_q.yaml": b""})
    assert result.plan.workflow == "old"
    assert result.plan.steps[0].key == "seal"
    assert result.plan.steps[0].args == {"time": 3, "temperature": 175}
    assert "a_q.yaml" in result.plan.files
    assert [where(f) for f in result.findings] == [(3, 26), (5, 68), (6, 5), (6, 88)]


@pytest.mark.parametrize(
    ("text", "line", "column", "says"),
    [
        ("name: x\nflowdef: 5\n", 2, 10, "must be a list"),
        ("name: x\nflowdef:\n  - 5\n", 3, 5, "must be a table"),
        ("flowdef:\n  - {module: sealer, action: seal, args: 5}\n", 2, 42, "must be a table"),
        ("flowdef:\n  - {action: seal}\n", 2, 5, "'module' is missing"),
        ("name: x\nsteps:\n  - {node: a, action: b}\n", 3, 12, "no module 'a'"),
        ("name: x\n", 1, 1, "'steps' is missing"),
        ("name: x\nmodules: [{}]\nflowdef: []\n", 2, 11, "no name"),
    ],
)
def test_foreign_files_that_are_not_understood(text: str, line: int, column: int, says: str) -> None:
    findings = validate_workflow(parse_workflow(text, "f.yaml"), {}, BENCH.workcell, DESCRIPTIONS)
    fault = next(f for f in findings if says in f"{f.message} {f.remedy}")
    assert where(fault) == (line, column)


def test_wei_parameters_at_any_depth_and_in_what_runs() -> None:
    text = """\
name: x
parameters: [{name: which, default: sealer}, {name: n-1}, {name: empty, default: null}]
flowdef:
  - name: say $which
    node: $which
    action: ${which}
    args: {a: [$n-1, {b: "x${n-1}y"}], c: "$other", d: "at $n-1 h", foo: 2.0}
"""
    source = parse_workflow(text, "wei.yaml")
    report = FindingList("wei.yaml")
    file = validate(WorkflowFile, convert_workflow(source, report)[0], report)
    assert file is not None
    [step] = file.steps
    assert (step.name, step.module, step.action) == ("say $which", "payload.which", "payload.which")
    assert step.args == {
        "a": ["payload.n-1", {"b": "x${payload.n-1}y"}],
        "c": "$other",
        "d": "at ${payload.n-1} h",
        "foo": 2.0,
    }
    assert [name for name, parameter in file.parameters.items() if parameter.required] == ["n-1", "empty"]
    assert report.sort_findings() == ()


def test_the_oldest_steps_and_what_no_version_runs() -> None:
    text = """\
name: x
flowdef:
  - name: s
    module: sealer
    command: {instruction: seal, args: {time: 3}, checks: RESOURCES, comment: so}
"""
    source = parse_workflow(text, "old.yaml")
    result = compile_workflow(source, {}, BENCH.workcell, DESCRIPTIONS, bench=BENCH.bench)
    assert result.plan.steps[0].args["time"] == 3
    assert [where(finding) for finding in result.findings] == [(5, 51)]
    several = parse_workflow("name: x\nflowdef: [{name: s, module: a, commands: []}]\n", "old.yaml")
    [finding] = validate_workflow(several, {}, BENCH.workcell, DESCRIPTIONS)
    assert (where(finding), "Several commands" in finding.message) == ((2, 32), True)


def test_module_and_action_from_the_payload() -> None:
    text = 'labos: 1\nname: x\nsteps:\n  - {name: a, module: payload.arm, action: "${payload.verb}_lid"}\n'
    source = parse_workflow(text, "own.yaml")
    payload = {"arm": "cycler", "verb": "open"}
    [step] = compile_workflow(source, payload, BENCH.workcell, DESCRIPTIONS).plan.steps
    assert (step.module, step.action) == ("wc1/cycler", "open_lid")
    findings = validate_workflow(source, {}, BENCH.workcell, DESCRIPTIONS)
    assert [where(finding) for finding in findings] == [(4, 23), (4, 44)]


POSITIONS = """\
modules:
  - {name: pf400, type: wei_ros_node, model: pf400, config: {ros_node: /std_ns/pf400Node}}
  - name: sealer
    type: wei_ros_node
    model: sealer
    config: {ros_node: /std_ns/SealerNode}
    positions: {default: [231.8, -27.2, 313.0, 342.3, 0.0, 683.7]}
  - name: peeler
    type: wei_ros_node
    model: peeler
    config: {ros_node: /std_ns/PeelerNode}
    positions: {default: [264.6, -29.4, 284.4, 372.3, 0.0, 651.6], spare: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]}
"""
CARRY = """\
name: carry
flowdef:
  - name: Move
    module: pf400
    action: transfer
    args: {source: [231.8, -27.2, 313.0, 342.3, 0.0, 683.7], target: peeler.positions.default}
"""


def test_positions_without_an_owner_are_told_to_whoever_is_sent_there() -> None:
    """As WEI did; nobody was taught a place that is nothing but zeros."""
    cell = parse_workcell(POSITIONS, DESCRIPTIONS).workcell
    (arm,) = [module for module in cell.modules if module.name.endswith("pf400")]
    assert arm.config["config"]["representations"] == {
        "sealer.default": [231.8, -27.2, 313.0, 342.3, 0.0, 683.7],
        "peeler.default": [264.6, -29.4, 284.4, 372.3, 0.0, 651.6],
    }


def test_joint_angles_of_one_place_mean_that_place() -> None:
    cell = parse_workcell(POSITIONS, DESCRIPTIONS)
    plan = compile_workflow(parse_workflow(CARRY), {}, cell.workcell, DESCRIPTIONS, simulate=True).plan
    (step,) = plan.steps
    assert (step.args["source"], step.args["target"]) == ("sealer.default", "peeler.default")


@pytest.mark.parametrize(
    ("angles", "says"),
    [
        (
            "[231.8, -27.2, 313.0, 342.3, 20.0, 683.7]",
            "are those of sealer.default, but 20.0 in the place of 0.0",
        ),
        ("[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "joint angles do not show which station it is"),
        ("[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]", "joint angles do not show which station it is"),
    ],
)
def test_joint_angles_of_no_place_are_refused(angles: str, says: str) -> None:
    cell = parse_workcell(POSITIONS, DESCRIPTIONS)
    text = CARRY.replace("[231.8, -27.2, 313.0, 342.3, 0.0, 683.7]", angles)
    with pytest.raises(SpecErrors, match=re.escape(says)):
        compile_workflow(parse_workflow(text), {}, cell.workcell, DESCRIPTIONS, simulate=True)


def test_joint_angles_that_two_places_have_mean_neither() -> None:
    text = POSITIONS.replace(
        "spare: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "spare: [231.8, -27.2, 313.0, 342.3, 0.0, 683.7]"
    )
    cell = parse_workcell(text, DESCRIPTIONS)
    with pytest.raises(SpecErrors, match="joint angles do not show which station it is"):
        compile_workflow(parse_workflow(CARRY), {}, cell.workcell, DESCRIPTIONS, simulate=True)
