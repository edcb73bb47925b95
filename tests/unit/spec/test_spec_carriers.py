"""A step that names no module is carried by whoever can, over several arms if none reaches both ends."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from labos.bootstrap import descriptions as installed
from labos.core.effects import Move, Take
from labos.core.model import Description, Plan
from labos.spec import SpecErrors, compile_workcell, compile_workflow, parse_workflow
from labos.spec.source import parse
from labos.spec.uses import read_uses

MADSCI = """\
workcell_manager_name: corner
resource_default_templates:
  - {template_name: nest, base_resource: {base_type: slot, capacity: 1}}
  - {template_name: rack, base_resource: {base_type: stack, capacity: 16}}
workcell_nodes: {handler: "http://h", arm: "http://a", reader: "http://r"}
location_locations:
  - location_name: handler.deck_1
    representations: {handler: {position: 1}, arm: {position: [10, 15, 5]}}
    resource_template_name: nest
  - {location_name: handler.deck_2, representations: {handler: {position: 2}}, resource_template_name: nest}
  - {location_name: reader.carriage, representations: {arm: [1, 2, 3]}, resource_template_name: nest}
  - {location_name: storage, representations: {arm: [4, 5, 6]}, resource_template_name: rack}
  - {location_name: island, representations: {reader: 1}, resource_template_name: nest}
location_transfer_capabilities:
  transfer_templates:
    - {node_name: arm, action: transfer, source_argument_name: source, target_argument_name: target}
    - {node_name: handler, action: deck_transfer}
"""


@cache
def drivers() -> dict[str, Description]:
    return installed()


def compile_plan(text: str, payload: dict[str, Any] | None = None) -> Plan:
    cell = compile_workcell(
        parse(MADSCI, "settings.yaml"), drivers(), uses=read_uses([parse(text, "carry.yaml")])
    )
    flow = parse_workflow(text, "carry.yaml")
    return compile_workflow(
        flow, payload or {}, cell.workcell, drivers(), simulate=True, bench=cell.bench
    ).plan


def plan_of(steps: str, payload: dict[str, Any] | None = None) -> Plan:
    return compile_plan(f"name: carry\nsteps:\n{steps}", payload)


def motions(plan: Plan) -> list[tuple[str, str, str, str]]:
    found = []
    for step in plan.steps:
        for effect in step.effects:
            match effect:
                case Take():
                    ends = effect.stack, effect.target
                case Move():
                    ends = effect.source, effect.target
                case _:
                    continue
            words = [end.partition("/")[2] for end in ends]
            found.append((step.key, step.action, *words))
    return found


def test_several_carry_where_nobody_reaches_both_ends() -> None:
    plan = plan_of("""\
  - {name: Fill, action: transfer, args: {source: storage, target: handler.deck_2}}
  - {name: Read, action: transfer, locations: {source: handler.deck_2, target: reader.carriage}}
  - {name: Away, action: transfer, args: {source: reader.carriage, target: storage}}
""")
    assert motions(plan) == [
        ("Fill[1]", "transfer", "wc.storage", "handler.deck_1"),
        ("Fill[2]", "deck_transfer", "handler.deck_1", "handler.deck_2"),
        ("Read[1]", "deck_transfer", "handler.deck_2", "handler.deck_1"),
        ("Read[2]", "transfer", "handler.deck_1", "reader.carriage"),
        ("Away", "transfer", "reader.carriage", "wc.storage"),
    ]
    assert [step.after for step in plan.steps] == [(), (0,), (1,), (2,), (3,)]


def test_what_waits_for_a_transfer_waits_for_its_last_part() -> None:
    plan = plan_of("""\
  - {name: Fill, action: transfer, args: {source: storage, target: handler.deck_2}}
  - {action: wait, args: {seconds: 5}}
  - {name: Mix, node: handler, action: mix, args: {}}
""")
    (window,) = plan.steps[2].windows
    assert (window.anchor, window.wait_s) == (1, 5.0)


@pytest.mark.parametrize(
    ("steps", "says"),
    [
        ("{name: x, action: transfer, args: {source: storage, target: island}}", "No module moves labware"),
        ("{name: x, action: transfer, args: {source: storage, target: storage}}", "to the same place"),
        ("{name: x, action: transfer, args: {source: storage, target: nowhere}}", "no station 'nowhere'"),
        ("{name: x, action: transfer, args: {source: storage}}", "takes `source` and `target`"),
    ],
)
def test_what_cannot_be_carried_is_refused_with_its_line(steps: str, says: str) -> None:
    with pytest.raises(SpecErrors) as caught:
        plan_of(f"  - {steps}\n")
    (fault,) = [finding for finding in caught.value.findings if finding.severity == "error"]
    assert says in fault.message
    assert fault.line == 3
    assert fault.remedy


BACK = "{name: Back, action: transfer, args: {source: handler.deck_2, target: reader.carriage}}"
NATIVE = f"""\
labos: 1
name: carry
steps:
  - {{name: Fill, action: transfer, args: {{source: storage, target: handler.deck_2}}}}
  - {{name: Mix, module: handler, action: mix, args: {{}}, on_error: {{run: [{BACK}], then: fail}}}}
on_cancel:
  - {BACK}
"""


def test_over_several_arms_after_a_cancellation_and_after_a_failure() -> None:
    plan = compile_plan(NATIVE)
    found = [motion for motion in motions(plan) if "Back" in motion[0]]
    there = [
        ("deck_transfer", "handler.deck_2", "handler.deck_1"),
        ("transfer", "handler.deck_1", "reader.carriage"),
    ]
    assert [motion[1:] for motion in found] == [*there, *there]
    assert [key for key, *_ in found] == [
        "on_cancel/Back[1]",
        "on_cancel/Back[2]",
        "Mix/on_error/Back[1]",
        "Mix/on_error/Back[2]",
    ]


def test_for_each_place() -> None:
    plan = compile_plan(
        """\
labos: 1
name: carry
steps:
  - name: Carry
    action: transfer
    args: {source: payload.item.from, target: payload.item.to}
    for_each: {item: item, in: payload.ways}
""",
        {"ways": [{"from": "storage", "to": "handler.deck_2"}, {"from": "handler.deck_2", "to": "storage"}]},
    )
    assert [motion[0] for motion in motions(plan)] == [
        "Carry[1][1]", "Carry[1][2]", "Carry[2][1]", "Carry[2][2]"
    ]  # fmt: skip
    assert [step.after for step in plan.steps] == [(), (0,), (1,), (2,)]


def test_rounds_side_by_side_still_carry_hop_after_hop() -> None:
    plan = compile_plan(
        """\
labos: 1
name: carry
steps:
  - name: Carry
    action: transfer
    args: {source: payload.item, target: reader.carriage}
    for_each: {item: item, in: [storage, handler.deck_2], parallel: true}
""",
    )
    before = {plan.steps[n].key: [plan.steps[m].key for m in step.after] for n, step in enumerate(plan.steps)}
    assert before == {"Carry[1]": [], "Carry[2][1]": [], "Carry[2][2]": ["Carry[2][1]"]}
