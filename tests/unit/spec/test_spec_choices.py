"""Steps that one of several modules may do, as a workflow file says it."""

from __future__ import annotations

import pytest

from labos.core.ids import local
from labos.core.model import Plan
from labos.spec import Compiled, Finding, compile_workflow, parse_workcell, parse_workflow, validate_workflow
from labos.spec.choices import describe_choices, list_choices
from labos.spec.uses import read_uses
from tests.unit.spec.spec_bench import DESCRIPTIONS, WORKCELL, steps

TWICE = {"sealer": "A4S_sealer", "cycler": "biometra (96well)"}
_text = WORKCELL
for _name, _model in TWICE.items():
    _text = _text.replace("modules:\n", f"modules:\n  - {{name: {_name}_b, model: {_model}}}\n")
    _at = f"    {_name}.default: [1, 2]\n"
    _text = _text.replace(_at, _at + _at.replace(_name, f"{_name}_b"))
CELL = parse_workcell(_text, DESCRIPTIONS, "wc2.yaml")

FETCH = "  - {name: Get, module: stack, action: get_plate, args: {loc: tower1}}\n"
BRING = (
    "  - name: Bring\n    module: arm\n    action: transfer\n"
    "    args: {source: stack.exchange, target: '${Seal.module}.default'}\n"
)
AWAY = (
    "  - name: Away\n    module: arm\n    action: transfer\n"
    "    args: {source: '${Seal.module}.default', target: wc.trash}\n"
)


def flow(said: str, more: str = "", action: str = "seal") -> str:
    return steps(f"{FETCH}{BRING}  - {{name: Seal, module: {said}, action: {action}}}\n{more}{AWAY}")


def compile_flow(text: str) -> Compiled:
    return compile_workflow(parse_workflow(text, "w.yaml"), {}, CELL.workcell, DESCRIPTIONS, bench=CELL.bench)


def faults(text: str) -> list[Finding]:
    source = parse_workflow(text, "w.yaml")
    found = validate_workflow(source, {}, CELL.workcell, DESCRIPTIONS, bench=CELL.bench)
    return [finding for finding in found if finding.severity == "error"]


def where(plan: Plan) -> tuple[str, ...]:
    """Who seals, and where the plate is brought and fetched."""
    by_key = {step.key: step for step in plan.steps}
    return (
        local(by_key["Seal"].module),
        local(by_key["Bring"].args["target"]),
        local(by_key["Away"].args["source"]),
    )


@pytest.mark.parametrize("said", ["any sealer", "{any: [sealer_b, sealer]}", "'any sealer_b, sealer'"])
def test_there_is_a_plan_for_each_module_and_places_follow_it(said: str) -> None:
    found = compile_flow(flow(said))
    assert {where(plan) for plan in found.plans} == {
        (name, f"{name}.default", f"{name}.default") for name in ("sealer", "sealer_b")
    }
    assert list_choices(found.plans) == {"Seal": ["sealer_b", "sealer"]}
    assert describe_choices(list_choices(found.plans)) == ["By sealer_b or sealer: 'Seal'."]


def test_a_step_that_goes_with_another_has_its_module() -> None:
    more = "  - {name: Open, module: same as Seal, action: open_lid}\n"
    found = compile_flow(flow("any cycler", more, "close_lid"))
    assert len(found.plans) == 2
    for plan in found.plans:
        by_key = {step.key: step.module for step in plan.steps}
        assert by_key["Open"] == by_key["Seal"]


def test_what_names_one_module_leaves_no_choice() -> None:
    assert [where(plan)[0] for plan in compile_flow(flow("{any: [sealer_b]}")).plans] == ["sealer_b"]
    assert [where(plan)[0] for plan in compile_flow(flow("sealer")).plans] == ["sealer"]


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("any printer", "no module of the workcell has the driver 'printer'"),
        ("{any: [sealer, sealer_c]}", "there is no module 'sealer_c' to choose"),
        ("{any: []}", "a choice of modules is written"),
        ("{one: [sealer]}", "a choice of modules is written"),
        ("same as Nothing", "there is no step 'Nothing' with a module"),
        ("same as Seal", "refers to itself for its module"),
        ("{any: [sealer, cycler]}", "With 'Seal' by cycler: Step 'Seal': cycler has no action 'seal'"),
    ],
)
def test_what_cannot_be_chosen_is_told_with_its_place(said: str, message: str) -> None:
    found = faults(flow(said))
    assert message.lower() in found[0].message.lower()
    assert found[0].line
    assert found[0].field
    assert found[0].remedy


def test_there_may_be_so_many_choices_and_no_more() -> None:
    many = "".join(f"  - {{name: Look {n}, module: any sealer, action: observe}}\n" for n in range(4))
    assert "There are 32 ways to choose" in faults(flow("any sealer", many))[0].message


def test_a_step_for_an_emergency_goes_with_another_and_chooses_nothing() -> None:
    way_out = (
        "on_cancel:\n  - name: Out\n    module: arm\n    action: transfer\n"
        "    args: {source: '${Seal.module}.default', target: wc.trash}\n"
    )
    found = compile_flow(flow("any sealer") + way_out)
    for plan in found.plans:
        assert local(plan.steps[-1].args["source"]) == f"{where(plan)[0]}.default"
    text = flow("any sealer") + "on_cancel:\n  - {name: Out, module: any sealer, action: observe}\n"
    assert "for an emergency" in faults(text)[0].message


def test_a_file_that_is_used_is_handed_the_module() -> None:
    part = b"labos: 1\nname: part\nsteps:\n  - {name: open, module: payload.by, action: open_lid}\n"
    more = "  - {name: More, use: part.yaml, payload: {by: '${Seal.module}'}}\n"
    source = parse_workflow(flow("any cycler", more, "close_lid"), "w.yaml")
    found = compile_workflow(
        source, {}, CELL.workcell, DESCRIPTIONS, bench=CELL.bench, files={"part.yaml": part}
    )
    assert len(found.plans) == 2
    for plan in found.plans:
        by_key = {step.key: step.module for step in plan.steps}
        assert by_key["More/open"] == by_key["Seal"]


def test_drafts_of_workcells_know_what_is_asked_of_each_module() -> None:
    uses = read_uses([parse_workflow(flow("{any: [sealer_b, sealer]}"), "w.yaml")])
    assert {use.module for use in uses} == {"stack", "arm", "sealer", "sealer_b"}
    targets = {use.args["target"] for use in uses if use.module == "arm" and use.args["target"] != "wc.trash"}
    assert targets == {"sealer.default", "sealer_b.default"}
