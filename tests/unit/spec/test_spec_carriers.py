"""A step that names no module is carried by whoever can, from hand to hand if nobody reaches both ends."""

from __future__ import annotations

from functools import cache

import pytest

from labos.bootstrap import descriptions as installed
from labos.core.effects import Move, Take
from labos.core.model import Description, Plan
from labos.spec import SpecErrors, compile_workcell, compile_workflow, parse_workflow
from labos.spec.source import parse
from labos.spec.uses import uses_in

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


def plan_of(steps: str, payload: dict[str, str] | None = None) -> Plan:
    flow = parse(f"name: carry\nsteps:\n{steps}", "carry.yaml")
    cell = compile_workcell(parse(MADSCI, "settings.yaml"), drivers(), uses=uses_in([flow]))
    return compile_workflow(
        parse_workflow(f"name: carry\nsteps:\n{steps}", "carry.yaml"),
        payload or {},
        cell.workcell,
        drivers(),
        simulate=True,
        bench=cell.bench,
    ).plan


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
        ("{name: x, action: transfer, args: {source: storage, target: island}}", "Nobody carries labware"),
        ("{name: x, action: transfer, args: {source: storage, target: storage}}", "to where it stands"),
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
