"""What another lab's workcell does not say is drafted from the workflows that use it."""

from __future__ import annotations

from collections import Counter
from functools import cache

import pytest

from labos.bootstrap import descriptions as installed
from labos.core.effects import Move
from labos.core.model import Description, Plan
from labos.spec import (
    BenchFile,
    CompiledWorkcell,
    SpecErrors,
    compile_workcell,
    compile_workflow,
    parse_workflow,
)
from labos.spec.importing import import_spec
from labos.spec.serving import list_drivers, suggest_driver
from labos.spec.source import parse
from labos.spec.uses import read_uses, sort_workflows_by_workcell

CELL = """\
name: corner
modules:
  - {name: arm, type: wei_ros_node, model: Acme Mover 7}
  - {name: ot2_alpha, type: wei_ros_node}
  - {name: sealer, type: wei_ros_node}
  - {name: oven, type: wei_ros_node, model: Acme Oven}
locations:
  arm:
    sealer.default: [1, 2, 3, 4, 5, 6]
    wc.rack: [2, 2, 3, 4, 5, 6]
"""
FLOW = """\
name: Bake
flowdef:
  - {name: fetch, module: arm, action: grab, args: {source: wc.rack, target: ot2_alpha_deck1}}
  - {name: mix, module: ot2_alpha, action: run_protocol, args: {config_path: mix.yaml, color: red}}
  - {name: shelve, module: arm, action: grab, args: {source: ot2_alpha.positions.deck1, target: Sealer}}
  - {name: seal, module: sealer, action: seal, args: {time: "3"}}
  - {name: bake, module: oven, action: bake, args: {how: well done, minutes: 3}}
"""


@cache
def drivers() -> dict[str, Description]:
    return installed()


def cell_for(flow: str = FLOW, cell: str = CELL) -> CompiledWorkcell:
    return compile_workcell(parse(cell, "corner.yaml"), drivers(), uses=read_uses([parse(flow, "bake.yaml")]))


def plan_of(flow: str = FLOW, cell: str = CELL) -> Plan:
    compiled = cell_for(flow, cell)
    bench: BenchFile = compiled.bench
    return compile_workflow(
        parse_workflow(flow, "bake.yaml"), {}, compiled.workcell, drivers(), simulate=True, bench=bench
    ).plan


def list_assumed(flow: str = FLOW, cell: str = CELL) -> list[tuple[str, str]]:
    return [(f.assumed, f.message) for f in cell_for(flow, cell).findings if f.assumed]


def test_the_whole_workflow_can_be_planned() -> None:
    plan = plan_of()
    moves = [effect for step in plan.steps for effect in step.effects if isinstance(effect, Move)]
    assert [(move.source, move.target) for move in moves] == [
        ("corner/wc.rack", "corner/ot2_alpha.deck1"),
        ("corner/ot2_alpha.deck1", "corner/sealer.default"),
    ]
    assert plan.steps[1].args["color"] == "red", "what is not understood is passed on"
    assert plan.steps[3].args["time"] == 3.0, "a number in quotes is a number"
    assert plan.steps[4].args == {"how": "well done", "minutes": 3}


def test_all_that_was_assumed_is_told() -> None:
    told = list_assumed()
    counts = Counter(what for what, _ in told)
    assert counts == {"module": 2, "driver": 2, "action": 1, "place": 1, "pose": 1}, told
    text = " ".join(message for _, message in told)
    for said in (
        "There is no driver for the module 'arm' (the model 'Acme Mover 7'); its actions are drafted "
        "from the workflows: grab.",
        "'ot2_alpha' is assumed to have the driver ot2, because of its name",
        "The driver ot2 does not know what color of 'run_protocol' means (bake.yaml, line 4)",
        "'sealer' is assumed to have the driver a4s_sealer, because of its name",
        "There is no description of the place 'ot2_alpha_deck1' (bake.yaml, line 3): it is assumed to be "
        "ot2_alpha.deck1.",
        "arm was never taught ot2_alpha.deck1, which it reaches in bake.yaml, line 3",
    ):
        assert said in text, said


def test_without_workflows_it_is_as_before() -> None:
    cell = compile_workcell(parse(CELL, "corner.yaml"), drivers())
    assert [module.name for module in cell.workcell.modules] == ["corner/ot2_alpha", "corner/sealer"]


def test_what_is_written_plans_the_same(tmp_path: object) -> None:
    found = import_spec(parse(CELL, "corner.yaml"), drivers(), read_uses([parse(FLOW, "bake.yaml")]))
    again = compile_workcell(parse(found.text, "again.yaml"), drivers())
    flow = import_spec(parse(FLOW, "bake.yaml"), drivers()).text
    compiled = compile_workflow(
        parse_workflow(flow), {}, again.workcell, drivers(), simulate=True, bench=again.bench
    )
    assert compiled.plan.steps == plan_of().steps
    assert not [finding for finding in again.findings if finding.severity == "error"]


def test_an_action_with_other_arguments_takes_the_place_of_the_drivers() -> None:
    flow = FLOW.replace("action: seal, args: {time: ", "action: seal, args: {pressure: ")
    cell = CELL.replace("name: sealer, type", "name: sealer, model: pf400, type")
    flow = flow.replace(
        "module: sealer, action: seal, args: {pressure: ", "module: sealer, action: transfer, args: {way: "
    )
    assert any("knows 'transfer' with other arguments" in message for _, message in list_assumed(flow, cell))


def test_a_step_with_other_arguments_does_not_spoil_the_action_for_the_others() -> None:
    """What the driver knows of its action holds for the steps that fit; the odd one is refused by itself."""
    cell = CELL.replace("model: Acme Mover 7", "model: pf400")
    flow = "name: Carry\nflowdef:\n"
    flow += (
        "  - {name: one, module: arm, action: transfer, args: {source: wc.rack, target: sealer.default}}\n"
    )
    odd = "  - {name: odd, module: arm, action: transfer, args: {from_here: wc.rack, to_there: wc.rack}}\n"
    compiled = cell_for(flow + odd, cell)
    (step,) = compile_workflow(
        parse_workflow(flow), {}, compiled.workcell, drivers(), simulate=True, bench=compiled.bench
    ).plan.steps
    assert any(isinstance(effect, Move) for effect in step.effects)
    with pytest.raises(SpecErrors, match="Step 'odd': The action 'transfer' needs the argument 'source'"):
        compile_workflow(parse_workflow(flow + odd), {}, compiled.workcell, drivers(), simulate=True)


def test_several_spellings_of_one_action_are_one_action() -> None:
    """One step calls it by the driver's alias and with a file, another by its name and with a number."""
    cell = CELL.replace("name: oven, type: wei_ros_node, model: Acme Oven", "name: oven, model: biometra")
    flow = "name: Cycle\nflowdef:\n"
    flow += "  - {name: shut, module: oven, action: close_lid}\n"
    old = "  - {name: old, module: oven, action: thermocycle, args: {protocol_file: pcr.yaml}}\n"
    new = "  - {name: new, module: oven, action: run_program, args: {prog: 4}}\n"
    assert plan_of(flow + old, cell).steps[1].args == {"protocol_file": "pcr.yaml"}
    assert plan_of(flow + new, cell).steps[1].args == {"program_n": 4}
    with pytest.raises(SpecErrors, match="Step 'old': The action 'run_program' needs"):
        plan_of(flow + old + new, cell)


def test_joint_values_are_no_places() -> None:
    flow = FLOW.replace("source: wc.rack, target: ot2_alpha_deck1", "source: [1, 2, 3], target: wc.rack")
    with pytest.raises(SpecErrors, match="must name a station; joint angles do not show which station it is"):
        plan_of(flow)


def test_a_place_that_nobody_describes_is_a_nest() -> None:
    flow = FLOW.replace("target: Sealer", "target: Bench 3").replace(
        'module: sealer, action: seal, args: {time: "3"}', "module: oven, action: rest, args: {}"
    )
    cell = cell_for(flow)
    (place,) = [station for station in cell.workcell.stations if station.name == "corner/wc.Bench 3"]
    assert (place.kind, "corner/arm" in place.reach) == ("nest", True)
    assert any(
        "There is no description of the place 'Bench 3'" in message for _, message in list_assumed(flow)
    )


@pytest.mark.parametrize(
    ("model", "driver"),
    [
        ("Opentrons OT-2", "ot2"),
        ("UR-5e", "ur"),
        ("Inheco single plate incubator shaker", "inheco"),
        ("Azenta XPeel", "brooks_peeler"),
        ("Precise Automation PF400", "pf400"),
        ("PreciseFlex 400SXL collaborative robot", "pf400"),
        ("Tecan Infinite M200", "tecan"),
        ("ot2_pcr_alpha", "ot2"),
        ("camera_module", "camera"),
        ("pf400_camera_right", None),
        ("Opentrons Flex", None),
        ("plate reader", None),
        ("pealer", None),
        ("module", None),
        ("96", None),
    ],
)
def test_what_a_name_speaks_of(model: str, driver: str | None) -> None:
    assert suggest_driver(model, drivers()) == driver


def test_spelling_of_models_does_not_matter() -> None:
    assert list_drivers("a4s sealer", drivers()) == list_drivers("A4S_Sealer", drivers()) == ["a4s_sealer"]


def test_workflows_belong_to_the_workcell_that_they_name_or_that_has_their_modules() -> None:
    other = CELL.replace("name: corner", "name: other").replace("ot2_alpha", "ot2_beta")
    sources = [
        parse(CELL, "a/corner.yaml"),
        parse(other, "b/other.yaml"),
        parse(FLOW, "b/bake.yaml"),
        parse(FLOW.replace("name: Bake", "name: Bake\nworkcell: /home/x/other.yaml"), "a/named.yaml"),
        parse("name: x\nflowdef:\n  - {name: s, module: nobody, action: rest}\n", "a/none.yaml"),
    ]
    found = {
        cell: [source.file for source in flows] for cell, flows in sort_workflows_by_workcell(sources).items()
    }
    assert found == {"a/corner.yaml": ["b/bake.yaml"], "b/other.yaml": ["a/named.yaml"]}


PLACES = CELL.replace(
    "locations:\n  arm:\n",
    "locations:\n"
    "  armm: {wc.rack: [7, 7, 7], wc.shelf: {pose: [1, 2], path: [[3, 4]]}}\n"
    "  arm:\n"
    "    oven.positions.tray: {pose: [1, 2, 3], path: [[4, 5, 6]]}\n",
)
ADDRESS = "config: {ros_node_address: /arm}, "


def test_locations_of_modules_that_are_not_there_are_kept() -> None:
    found = import_spec(parse(PLACES, "corner.yaml"), drivers(), read_uses([parse(FLOW, "bake.yaml")]))
    again = parse(found.text, "again.yaml")
    assert again.data["config"]["locations_of_others"] == {
        "armm": {"wc.rack": [7, 7, 7], "wc.shelf": {"pose": [1, 2], "path": [[3, 4]]}}
    }
    assert not [f for f in compile_workcell(again, drivers()).findings if f.severity == "error"]


def test_a_foreign_node_is_told_places_in_its_own_words() -> None:
    cell = PLACES.replace("{name: arm, ", "{name: arm, " + ADDRESS)
    flow = FLOW + "  - {name: load, module: arm, action: grab, args: {source: Sealer, target: oven.tray}}\n"
    (arm,) = [m for m in cell_for(flow, cell).workcell.modules if m.name == "corner/arm"]
    assert arm.config["config"]["representations"] == {
        "ot2_alpha.deck1": "ot2_alpha_deck1",
        "oven.tray": {"pose": [1, 2, 3], "path": [[4, 5, 6]]},
    }
    assert arm.config["poses"]["sealer.default"] == [1, 2, 3, 4, 5, 6]


def test_a_module_that_is_left_out_is_called_so() -> None:
    cell = CELL.replace("{name: oven, ", "{name: oven, active: false, ")
    compiled = cell_for(FLOW, cell)
    assert compiled.left_out == {"oven": "it is switched off (`active: false`)"}
    bare = compile_workcell(parse(CELL, "corner.yaml"), drivers())
    assert bare.left_out == {"arm": "there is no driver for it", "oven": "there is no driver for it"}
    with pytest.raises(
        SpecErrors, match=r"the module 'oven' is left out: it is switched off \(`active: false`\)"
    ):
        compile_workflow(
            parse_workflow(FLOW, "bake.yaml"), {}, compiled.workcell, drivers(), simulate=True,
            bench=compiled.bench, left_out=compiled.left_out,
        )  # fmt: skip


READ = """\
name: Read
flowdef:
  - {name: look, module: oven, action: look}
  - {name: seal, module: sealer, action: seal, args: {time: steps.look.result.hot.s, temperature: "175"}}
  - {name: mix, module: ot2_alpha, action: run_protocol, args: {config_path: steps.look.result.protocol}}
  - {name: bake, module: oven, action: bake,
     args: {how: steps.look.result.files.recipe, c: steps.look.result.c}}
"""


def test_a_drafted_action_returns_what_later_steps_read() -> None:
    """In the kind that the later step takes, as far as somebody knows it."""
    (oven,) = [m for m in cell_for(READ).workcell.modules if m.name.endswith("oven")]
    file = {"file": "simulated.txt", "text": "simulated\n"}
    assert oven.config["about"]["actions"]["look"]["returns"] == {
        "hot": {"s": 3.0},
        "protocol": file,
        "files": {"recipe": file},
        "c": 0,
    }
