"""MADSci's transfer capabilities: costs, overrides, further arguments; and its own steps that carry."""

from __future__ import annotations

from functools import cache

import pytest

from labos.bootstrap import descriptions as installed
from labos.core.model import Description, Plan
from labos.errors import SpecError
from labos.spec import SpecErrors, compile_workcell, compile_workflow
from labos.spec.findings import suggest_name
from labos.spec.importing import import_spec
from labos.spec.source import parse
from labos.spec.uses import read_uses

NODES = """\
workcell_manager_name: corner
resource_default_templates:
  - {template_name: nest, base_resource: {base_type: slot, capacity: 1}}
  - {template_name: rack, base_resource: {base_type: stack, capacity: 16}}
workcell_nodes: {slow: "http://s", quick: "http://q", reader: "http://r"}
location_locations:
  - location_name: a
    location_id: 01AAA
    representations: {slow: [1], quick: [1]}
    resource_template_name: nest
  - {location_name: b, representations: {slow: [2], quick: [2]}, resource_template_name: nest}
  - {location_name: c, location_id: 01CCC, representations: {slow: [3]}, resource_template_name: nest}
  - {location_name: d, representations: {slow: [4], quick: [4]}, allow_transfers: false}
"""

TEMPLATES = """\
location_transfer_capabilities:
  transfer_templates:
    - {node_name: slow, action: transfer, cost_weight: %s}
    - {node_name: quick, action: carry, source_argument_name: source, target_argument_name: target}
"""


@cache
def drivers() -> dict[str, Description]:
    return installed()


def plan_of(cell: str, steps: str) -> Plan:
    flow = parse(f"name: carry\nsteps:\n{steps}", "carry.yaml")
    found = compile_workcell(parse(cell, "settings.yaml"), drivers(), uses=read_uses([flow]))
    return compile_workflow(flow, {}, found.workcell, drivers(), simulate=True, bench=found.bench).plan


def list_carriers(cell: str, source: str = "a", target: str = "b") -> list[tuple[str, str]]:
    """By whom, and by which action, a step that names no node is carried out."""
    plan = plan_of(
        cell, f"  - {{name: x, action: transfer, args: {{source: {source}, destination: {target}}}}}\n"
    )
    return [(step.module.partition("/")[2], step.action) for step in plan.steps]


@pytest.mark.parametrize(("cost", "by"), [("0.5", ("slow", "transfer")), ("2.0", ("quick", "carry"))])
def test_of_several_ways_the_one_that_costs_least_is_taken(cost: str, by: tuple[str, str]) -> None:
    assert list_carriers(NODES + TEMPLATES % cost) == [by]


def test_two_cheap_hops_go_before_a_dear_one() -> None:
    told = NODES + TEMPLATES % "1.0"
    assert list_carriers(told, "a", "c") == [("slow", "transfer")]
    dear = "{a: {01CCC: [{node_name: slow, action: transfer, cost_weight: 9}]}}"
    pair = f"  override_transfer_templates: {{pair_overrides: {dear}}}\n"
    assert list_carriers(told + pair, "a", "c") == [("slow", "transfer"), ("slow", "transfer")]


SPECIAL = "[{node_name: slow, action: %s, cost_weight: 8}]"
OVERRIDES = [
    ("source_overrides: {a: %s}", "gentle"),
    ("target_overrides: {b: %s}", "gentle"),
    ("destination_overrides: {b: %s}", "gentle"),
    ("source_overrides: {01AAA: %s}", "gentle"),
    ("pair_overrides: {a: {b: %s}}", "gentle"),
    ("source_overrides: {b: %s}", "carry"),
]


@pytest.mark.parametrize(("override", "action"), OVERRIDES)
def test_an_override_holds_for_its_locations_whatever_it_costs(override: str, action: str) -> None:
    told = f"  override_transfer_templates:\n    {override % (SPECIAL % 'gentle')}\n"
    assert [step[1] for step in list_carriers(NODES + TEMPLATES % "5.0" + told)] == [action]


def test_the_override_of_a_pair_goes_before_that_of_the_source_and_this_before_the_targets() -> None:
    said = {
        "target_overrides: {b: %s}": "soft",
        "source_overrides: {a: %s}": "firm",
        "pair_overrides: {a: {b: %s}}": "exact",
    }
    told = ""
    for override, action in said.items():
        told += f"    {override % (SPECIAL % action)}\n"
        cell = NODES + TEMPLATES % "5.0" + f"  override_transfer_templates:\n{told}"
        assert list_carriers(cell) == [("slow", action)]


def test_further_arguments_are_passed_on() -> None:
    cell = (
        NODES
        + """\
location_transfer_capabilities:
  transfer_templates:
    - node_name: slow
      action: transfer
      additional_args: {speed: 20}
      additional_location_args: {rest: c}
"""
    )
    (step,) = plan_of(cell, "  - {name: x, action: transfer, args: {source: 01AAA, target: b}}\n").steps
    assert step.args["speed"] == 20
    assert step.args["rest"].endswith("wc.c")


def refusal(steps: str) -> tuple[str, str, int]:
    """Why steps are refused, what to do about it, and the line."""
    with pytest.raises((SpecError, SpecErrors)) as caught:
        plan_of(NODES + TEMPLATES % "1.0", steps)
    error = caught.value
    found = error if isinstance(error, SpecError) else next(iter(error.findings))
    return found.message, found.remedy, found.line


def test_a_location_that_allows_no_transfers_is_refused_and_not_passed() -> None:
    message, remedy, line = refusal("  - {name: x, action: transfer, args: {source: d, target: b}}\n")
    assert "wc.d takes part in no transfer" in message
    assert "Name the `module:`" in remedy
    assert line == 3


def test_the_contents_of_a_location_are_carried_by_the_ids_of_locations() -> None:
    args = "{source_location_id: 01AAA, destination_location_id: 01CCC}"
    step = f"  - {{name: x, action: transfer_location_contents, args: {args}}}\n"
    (found,) = plan_of(NODES + TEMPLATES % "1.0", step).steps
    assert (found.module, found.action) == ("corner/slow", "transfer")


def test_a_resource_of_madsci_is_refused_with_what_to_write() -> None:
    message, remedy, line = refusal(
        "  - {name: x, action: transfer_resource, args: {resource_id: 01R, destination_location_id: b}}\n"
    )
    assert "names a resource of MADSci" in message
    assert "`action: transfer`" in remedy
    assert "`target: b`" in remedy
    assert line == 3


def warnings(told: str) -> list[str]:
    cell = compile_workcell(parse(NODES + told, "settings.yaml"), drivers(), uses=[])
    return [finding.message for finding in cell.findings]


def test_what_is_not_used_is_said() -> None:
    told = (
        TEMPLATES % "1.0"
        + "  capacity_cost_config: {enabled: true}\n"
        + "  override_transfer_templates: {source_overrides: {nowhere: []}}\n"
    )
    found = warnings(told)
    assert any("how full its target is" in message for message in found)
    assert any("No location is called 'nowhere'" in message for message in found)


def test_the_rewritten_file_says_the_same() -> None:
    """Costs, overrides and closed places stand in LabOS' own form, and lead to the same plan."""
    told = (
        NODES
        + TEMPLATES % "5.0"
        + f"  override_transfer_templates:\n    source_overrides: {{a: {SPECIAL % 'gentle'}}}\n"
    )
    step = "  - {name: x, action: transfer, args: {source: a, target: b}}\n"
    uses = read_uses([parse(f"name: carry\nsteps:\n{step}", "carry.yaml")])
    text = import_spec(parse(told, "settings.yaml"), drivers(), uses).text
    assert "from: [wc.a]" in text
    assert "transfers: false" in text
    assert [(each.module, each.action) for each in plan_of(text, step).steps] == [("corner/slow", "gentle")]


NATIVE = """\
labos: 1
name: corner
modules: [{name: pf400, model: pf400}, {name: sealer, model: a4s_sealer}]
locations: {pf400: {sealer.default: [1, 2, 3, 4, 5, 6], wc.nest: [1, 2, 3, 4, 5, 6]}}
transfers:
"""


@pytest.mark.parametrize(
    ("way", "says", "remedy"),
    [
        ("{module: pf40}", "No active module is called 'pf40'", "pf400"),
        ("{module: pf400, action: transfr}", "pf400 has no action 'transfr'", "transfer"),
        ("{module: pf400, source: sorce}", "has no argument 'sorce'", "source"),
        ("{module: pf400, args: {spead: 1}}", "has no argument 'spead'", "Known"),
        ("{module: pf400, from: [wc.nets]}", "no station 'wc.nets'", "wc.nest"),
        ("{module: pf400, cost: 0}", "greater than 0", ""),
    ],
)
def test_a_way_that_cannot_be_is_refused_with_its_line(way: str, says: str, remedy: str) -> None:
    with pytest.raises(SpecErrors) as caught:
        compile_workcell(parse(f"{NATIVE}  - {way}\n", "corner.yaml"), drivers())
    (fault,) = [finding for finding in caught.value.findings if finding.severity == "error"]
    assert says in fault.message
    assert remedy in fault.remedy
    assert fault.line == 6


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("ot2", "Did you mean 'ot2_alpha' or 'ot2_beta'?"),
        ("xyz", "Known: ot2_alpha, ot2_beta, pf400."),
        ("pf40", "Did you mean 'pf400'?"),
        ("PF400", "Did you mean 'pf400'? Upper and lower case count."),
    ],
)
def test_a_name_that_is_part_of_others_is_offered_those(name: str, says: str) -> None:
    assert suggest_name(name, ["ot2_beta", "pf400", "ot2_alpha"], "module") == says
