"""Workflow files: what they compile to, and what can be wrong with them."""

from __future__ import annotations

from typing import Any

import pytest
from spec_bench import BENCH, DESCRIPTIONS, compile_steps, faults, steps, where

from labos.core.canonical import digest
from labos.core.effects import Move, Needs
from labos.core.ids import local
from labos.core.model import Window
from labos.errors import SpecError
from labos.spec import (
    SpecErrors,
    compile_workflow,
    parse_workflow,
    read_workflow,
    validate_workflow,
)

SEAL = "- {name: seal, module: sealer, action: seal}\n"
GET = "- {name: get, module: stack, action: get_plate, args: {loc: tower1}}\n"


def move(source: str, target: str, name: str = "go", more: str = "", grips: str = "") -> str:
    return (
        f"- {{name: {name}, module: arm, action: transfer,"
        f" args: {{source: {source}, target: {target}{grips}}}{more}}}\n"
    )


# -- references -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("written", "payload", "value"),
    [
        ("payload.t", {"t": 2.5}, 2.5),
        ("payload:t", {"t": 2}, 2),
        ("payload.a.b", {"a": {"b": 4}}, 4),
        ("payload.a.b", {"a.b": 4, "a": {"b": 5}}, 4),
        ("payload:a.b.c", {"a.b": {"c": 6}}, 6),
        ('"${payload.t}"', {"t": 7}, 7),
        ("2 min", {}, 120.0),
        ('"90 s"', {}, 90.0),
        ("payload.t", {"t": "1 min"}, 60.0),
    ],
)
def test_references_keep_their_type(written: str, payload: dict[str, Any], value: Any) -> None:
    text = f"- {{name: seal, module: sealer, action: seal, args: {{time: {written}}}}}\n"
    result = compile_steps(text, payload)
    assert result.plan.steps[0].args["time"] == value


def test_references_inside_text_and_defaults_of_parameters() -> None:
    text = (
        "labos: 1\nname: w\nparameters: {run: {default: 7}, a.b: {default: 1}}\nsteps:\n"
        "- {name: p, module: cam, action: take_picture,"
        ' args: {file_name: "i_${payload.run}_${payload.a.b}"}}\n'
    )
    for payload, name in (({}, "i_7_1"), ({"a": {"b": 2}}, "i_7_2"), ({"run": True}, "i_true_1")):
        result = compile_workflow(parse_workflow(text), payload, BENCH.workcell, DESCRIPTIONS)
        assert result.plan.steps[0].args == {"file_name": name}


def test_results_of_earlier_steps() -> None:
    picture = "- {name: p, module: cam, action: take_picture}\n"
    again = "- {name: q, module: cam, action: take_picture, args: {file_name: steps.p.result.image.name}}\n"
    result = compile_steps(picture + again)
    assert result.plan.steps[1].args["file_name"] == {"$result": [0, "image", "name"]}
    assert result.plan.feeds == (0,)


# -- order ------------------------------------------------------------------------------------


def test_names_may_repeat_and_after_makes_branches() -> None:
    text = (
        "- {name: p, module: cam, action: take_picture}\n"
        "- {name: p, module: cam, action: take_picture, after: []}\n"
        "- {name: q, module: cam, action: take_picture, after: ['p#1', 'p#2']}\n"
    )
    plan = compile_steps(text).plan
    assert [step.key for step in plan.steps] == ["p", "p#2", "q"]
    assert [step.after for step in plan.steps] == [(), (), (0, 1)]


def test_windows() -> None:
    text = (
        "- {name: a, module: cam, action: take_picture}\n"
        "- {name: b, module: cam, action: take_picture}\n"
        "- {name: c, module: cam, action: take_picture, after: [a], wait: {after: a, at_least: 30 s},\n"
        "   within: [{after: a, at_most: 10 min, on_breach: fail}, {after: b, at_most: 12 h}]}\n"
    )
    plan = compile_steps(text).plan
    assert plan.steps[2].windows == (Window(0, 30, 600, "fail"), Window(1, 0, 43200))
    assert plan.steps[2].after == (0, 1)


def test_windows_of_another_run() -> None:
    text = (
        "- {name: a, module: cam, action: take_picture,\n"
        "   wait: {of: incubate, after: Put in, at_least: 12 h},\n"
        "   within: [{of: incubate, after: Put in, at_most: 13 h, on_breach: ask},\n"
        "            {of: payload.plate, after: Shake, at_most: 5}]}\n"
    )
    (step,) = compile_steps(text, {"plate": "R7"}).plan.steps
    assert step.after == ()
    assert step.windows == (
        Window(None, 43200, 46800, "ask", "incubate", "Put in"),
        Window(None, 0, 5, of="R7", of_step="Shake"),
    )


@pytest.mark.parametrize(
    ("window", "payload", "message"),
    [
        ("within: {of: payload.plate, after: x, at_most: 5}", {}, "The payload has no 'plate'"),
        ("within: {of: payload.plate, after: x, at_most: 5}", {"plate": 7}, "`of` is not a text"),
        (
            "wait: {of: w, after: x, at_least: 9}, within: {of: w, after: x, at_most: 5}",
            {},
            "It waits 9 s, but must start within 5 s",
        ),
        ("within: {of: '', after: x, at_most: 5}", {}, "There is no step 'x'"),
    ],
)
def test_faults_of_windows_of_another_run(window: str, payload: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecErrors, match=message):
        compile_steps(f"- {{name: a, module: cam, action: take_picture, {window}}}\n", payload)


# -- effects ----------------------------------------------------------------------------------


def test_a_change_of_grip_goes_by_the_regrip_station() -> None:
    grips = ", source_plate_rotation: narrow, target_plate_rotation: wide"
    [effect] = compile_steps(move("sealer", "cam", grips=grips)).plan.steps[0].effects
    assert isinstance(effect, Move)
    assert effect.via == "wc1/wc.regrip"
    grips = ", source_plate_rotation: wide, target_plate_rotation: wide"
    [effect] = compile_steps(move("sealer", "cam", grips=grips)).plan.steps[0].effects
    assert isinstance(effect, Move)
    assert effect.via == ""


def test_inputs_and_outputs() -> None:
    result = compile_steps(SEAL + move("sealer", "wc.hotel") + move("cam", "wc.hotel"))
    assert result.inputs == ("wc1/sealer.default", "wc1/cam.plate_station")
    assert result.outputs == ("wc1/wc.hotel", "wc1/wc.hotel")
    assert isinstance(result.plan.steps[0].effects[0], Needs)


def test_files_are_pinned_and_looked_up_beside_the_workflow(tmp_path: Any) -> None:
    (tmp_path / "w.yaml").write_text(
        steps("- {name: r, module: ot2, action: run_protocol, args: {config_path: p/x.yaml}}\n")
    )
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "x.yaml").write_bytes(b"hello")
    result = compile_workflow(read_workflow(tmp_path / "w.yaml"), {}, BENCH.workcell, DESCRIPTIONS)
    assert result.plan.files == {"p/x.yaml": digest(b"hello")}
    assert result.files == {digest(b"hello"): b"hello"}
    assert "no earlier step puts any there" in result.findings[0].message


@pytest.mark.parametrize("path", ["../secret.yaml", "/etc/hostname"])
def test_files_outside_the_folder_are_not_read(path: str, tmp_path: Any) -> None:
    (tmp_path / "secret.yaml").write_text("x: 1")
    (tmp_path / "in").mkdir()
    workflow = tmp_path / "in" / "w.yaml"
    workflow.write_text(
        steps(f"- {{name: r, module: ot2, action: run_protocol, args: {{config_path: {path}}}}}\n")
    )
    findings = validate_workflow(workflow, {}, BENCH.workcell, DESCRIPTIONS)
    assert "outside the workflow's folder" in findings[0].message


# -- faults -----------------------------------------------------------------------------------


def seal(args: str) -> str:
    return f"- {{name: seal, module: sealer, action: seal, args: {{{args}}}}}\n"


FAULTS: list[tuple[str, int, int, str, str]] = [
    # targets
    ("- {name: a, module: seeler, action: seal}\n", 4, 21, "steps[0].module", "Did you mean 'sealer'"),
    ("- {name: a, module: sealer, action: sael}\n", 4, 37, "steps[0].action", "Did you mean 'seal'"),
    ("- {name: a, module: sealer, acton: seal}\n", 4, 29, "steps[0].acton", "Did you mean 'action'"),
    ("- {name: a, module: sealer}\n", 4, 3, "steps[0].action", "'action' is missing"),
    ("- {name: 5, module: sealer, action: seal}\n", 4, 10, "steps[0].name", "it should be text"),
    # arguments
    (seal("tiem: 3"), 4, 53, "steps[0].args.tiem", "Did you mean 'time'"),
    (seal("time: '3 bar'"), 4, 59, "steps[0].args.time", "is in s, not in 'bar'"),
    (seal("time: three"), 4, 59, "steps[0].args.time", "must be a number, not 'three'"),
    (seal("time: true"), 4, 59, "steps[0].args.time", "must be a number, not True"),
    (seal("time: 0.1"), 4, 59, "steps[0].args.time", "less than 0.5 s"),
    (seal("time: 20 min"), 4, 59, "steps[0].args.time", "more than 999.9 s"),
    (seal("time: 20 µL"), 4, 59, "steps[0].args.time", "is in s, not in 'µL'"),
    (seal("temperature: 175.5"), 4, 66, "steps[0].args.temperature", "whole number"),
    (seal("temperature: 300"), 4, 66, "steps[0].args.temperature", "from 50 to 200 °C"),
    (seal("time: 3, seal_time: 4"), 4, 73, "steps[0].args.seal_time", "given twice"),
    (seal("time: payload.tiem"), 4, 59, "steps[0].args.time", "Did you mean 'time'"),
    (seal("time: [steps.x.result]"), 4, 59, "steps[0].args.time", "whole argument"),
    (move("sealer.defalt", "cam"), 4, 60, "steps[0].args.source", "Did you mean 'sealer.default'"),
    (move("[1, 2]", "cam"), 4, 60, "steps[0].args.source", "joint angles do not show"),
    (move("payload.a.x", "cam"), 4, 60, "steps[0].args.source", "no 'a.x'"),
    ("- {name: a, module: arm, action: transfer, args: {source: cam}}\n", 4, 50, "", "needs the argument"),
    ("- {name: a, module: arm, action: transfer}\n", 4, 3, "", "needs the argument 'source'"),
    (move("sealer", "cam", grips=", source_plate_rotation: tall"), 4, 104, "", "'narrow', 'wide'"),
    # steps' results
    (SEAL + seal("time: steps.nobody.result.x"), 5, 59, "steps[1].args.time", "no step 'nobody'"),
    (seal("time: steps.seal.result"), 4, 59, "steps[0].args.time", "not done before"),
    (
        SEAL.replace("seal,", "s,", 1) + move("steps.s.result", "cam"),
        5,
        60,
        "steps[1].args.source",
        "decides what moves",
    ),
    # order
    (
        SEAL + SEAL + move("sealer", "cam", more=", after: [seal]"),
        6,
        90,
        "steps[2].after[0]",
        "called 'seal'",
    ),
    (SEAL + move("sealer", "cam", more=", after: [sael]"), 5, 90, "steps[1].after[0]", "Did you mean 'seal'"),
    (move("sealer", "cam", more=", after: [go]"), 4, 3, "steps[0]", "waits for itself"),
    (
        move("sealer", "cam", "a", ", after: [b]") + move("cam", "sealer", "b", ", after: [a]"),
        4,
        88,
        "steps[0].after",
        "through other steps",
    ),
    (
        SEAL + move("sealer", "cam", more=", wait: {after: seal, at_least: 3 parsecs}"),
        5,
        112,
        "steps[1].wait.at_least",
        "'parsecs' is not known",
    ),
    (
        SEAL + move("sealer", "cam", more=", within: {after: x, at_most: 3}"),
        5,
        98,
        "steps[1].within[0].after",
        "no step 'x'",
    ),
    (
        SEAL
        + move("sealer", "cam", more=", wait: {after: seal, at_least: 9}, within: {after: seal, at_most: 3}"),
        5,
        124,
        "steps[1].within[0]",
        "at_most",
    ),
    # the dry run
    (move("sealer", "ot2.deck1"), 4, 3, "steps[0]", "arm was never taught ot2.deck1"),
    (
        move("sealer", "ot2.deck2", grips=", target_plate_rotation: wide"),
        4,
        3,
        "steps[0]",
        "cannot grip wide at ot2.deck2",
    ),
    (move("sealer", "cam") + move("cycler", "cam"), 5, 3, "steps[1]", "cam.plate_station is full"),
    (GET + GET, 5, 3, "steps[1]", "stack.exchange is full"),
    (GET + move("stack.exchange", "wc.pcr"), 5, 3, "steps[1]", "does not accept plate96"),
    (move("sealer", "cam") + SEAL, 5, 3, "steps[1]", "labware of this run is no longer at sealer.default"),
    (move("wc.trash", "cam"), 4, 3, "steps[0]", "Labware cannot be taken out of wc.trash"),
    (move("cam", "cam"), 4, 3, "steps[0]", "to the same place"),
    (SEAL + SEAL, 5, 3, "steps[1]", "needs the labware not sealed, but then the labware sealed"),
    (
        "- {name: a, module: cycler, action: close_lid}\n" + move("sealer", "cycler"),
        5,
        3,
        "steps[1]",
        "cycler.default is out of reach: lid of cycler closed",
    ),
    (
        "- {name: a, module: cycler, action: run_program, args: {program_n: 3}}\n",
        4,
        3,
        "steps[0]",
        "needs lid of cycler closed, but then lid of cycler open",
    ),
    (
        "- {name: a, module: stack, action: get_plate, args: {loc: exchange, target: tower1}}\n",
        4,
        3,
        "steps[0]",
        "is not a stack",
    ),
    (
        "- {name: a, module: stack, action: get_plate, args: {loc: tower1, target: wc.trash}}\n",
        4,
        3,
        "steps[0]",
        "gets its id where it is put down, which cannot be in wc.trash",
    ),
]


@pytest.mark.parametrize(("text", "line", "column", "field", "says"), FAULTS)
def test_faults(text: str, line: int, column: int, field: str, says: str) -> None:
    found = [f for f in faults(text, {"a": {"b": 1}, "time": 1}) if f.severity == "error"]
    assert found
    fault = found[0]
    assert says in f"{fault.message} {fault.remedy}"
    assert (*where(fault), fault.file) == (line, column, "w.yaml")
    if field:
        assert fault.field == field
    assert fault.remedy
    assert len(found) == len({(f.message, f.line) for f in found})
    with pytest.raises(SpecErrors) as caught:
        compile_steps(text, {"a": {"b": 1}, "time": 1})
    assert len(caught.value.errors) == len(found)
    assert str(caught.value).startswith("w.yaml:")


def test_what_branches_may_break_is_only_a_warning() -> None:
    text = move("sealer", "cam", "a") + move("cycler", "cam", "b", ", after: []")
    [finding] = compile_steps(text).findings
    assert finding.severity == "warning"
    assert "is full" in finding.message


def test_a_missing_file_is_a_warning_on_the_simulated_bench() -> None:
    text = "- {name: r, module: ot2, action: run_protocol, args: {config_path: none.yaml}}\n"
    assert {f.severity for f in faults(text, simulate=True)} == {"warning"}
    assert faults(text)[0].severity == "error"


@pytest.mark.parametrize("payload", [{"x": float("nan")}, {"x": {1, 2}.__iter__()}, {"x": object()}])
def test_a_payload_that_cannot_be_recorded(payload: dict[str, Any]) -> None:
    [finding] = faults(SEAL, payload)
    assert "cannot be recorded" in finding.message
    with pytest.raises(SpecError):
        compile_steps(SEAL, payload)


def test_a_payload_cannot_smuggle_in_a_reference() -> None:
    for value in ({"$result": [0]}, "steps.seal.result"):
        [finding] = faults(seal("time: payload.t"), {"t": value})
        assert "whole argument" in finding.message


# -- keeping a module ---------------------------------------------------------------------------

OPEN_AND_FILL = "".join(
    (
        "- {name: open, module: cycler, action: open_lid}\n",
        SEAL,
        move("sealer", "cycler", "fill"),
        "- {name: close, module: cycler, action: close_lid}\n",
    )
)


def holds(head: str) -> list[tuple[str, int, int]]:
    return [
        (local(hold.module), hold.first, hold.last) for hold in compile_steps(OPEN_AND_FILL + head).plan.holds
    ]


def test_who_works_on_a_module_first_keeps_it_until_the_labware_has_come() -> None:
    assert holds("") == [("cycler", 0, 2)]
    assert holds("hold: {cycler: none}\n") == []
    assert holds("hold: {cycler: {from: seal, until: close}, arm: {from: open, until: fill}}\n") == [
        ("cycler", 1, 3),
        ("arm", 0, 2),
    ]


@pytest.mark.parametrize(
    ("hold", "says"),
    [
        ("{cyclr: none}", "no module 'cyclr'"),
        ("{cycler: {from: opn, until: fill}}", "no step 'opn'"),
        ("{cycler: {from: fill, until: open}}", "'open' comes before 'fill'"),
    ],
)
def test_faults_of_holds(hold: str, says: str) -> None:
    found = faults(f"{OPEN_AND_FILL}hold: {hold}\n")
    assert len(found) == 1
    assert says in found[0].message
    assert found[0].line == 8
