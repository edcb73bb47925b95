"""``interface:`` and ``about:`` of a module: foreign nodes in a workcell file."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from labos.adapter import ADAPTERS
from labos.adapter._types import type_of
from labos.adapter.madsci import describe as describe_madsci
from labos.adapter.wei import describe as describe_wei
from labos.adapter.wei import is_working, read_state
from labos.core.effects import Move, Needs
from labos.core.model import Description
from labos.errors import SpecError
from labos.spec import SpecErrors, compile_workflow, parse_workcell, parse_workflow
from labos.spec.about import About, find_description, make_about, make_description
from labos.spec.interfaces import PLANNED, REACHED

CELL = """
labos: 1
name: corner
modules:
  - name: arm
    interface: wei_rest_node
    config: {rest_node_address: "http://arm:2000"}
    about:
      manipulator: true
      stations: {gripper: {kind: gripper}, nest: {}}
      actions:
        carry:
          args:
            source: {type: station}
            target: {type: station}
            speed: {type: float, default: 0.5, minimum: 0.1, maximum: 1.0}
          effects:
            - move: {source: "{source}", target: "{target}"}
          duration: 2 min
locations:
  arm: {arm.nest: [1, 2, 3], wc.shelf: [4, 5, 6]}
stock: {arm.nest: {plate96: 1}}
"""

FLOW = """
labos: 1
name: carry
steps:
  - {name: carry, module: arm, action: carry, args: {source: arm.nest, target: wc.shelf}}
"""


def findings(text: str) -> Sequence[str]:
    try:
        return [str(finding) for finding in parse_workcell(text, {}, "corner.yaml").findings]
    except SpecErrors as errors:
        return [str(finding) for finding in errors.findings]
    except SpecError as error:
        return [str(error)]


def test_a_foreign_node_is_planned_by_its_about() -> None:
    cell = parse_workcell(CELL, {})
    (module,) = cell.workcell.modules
    assert module.driver == "wei_rest_node"
    assert module.config["interface"] == "wei_rest_node"
    about = find_description(module, {})
    assert about is not None
    action = about.action("carry")
    assert action is not None
    assert (action.duration_s, action.args[2].default) == (120.0, 0.5)
    plan = compile_workflow(parse_workflow(FLOW), {}, cell.workcell, {}, bench=cell.bench).plan
    (effect,) = plan.steps[0].effects
    assert isinstance(effect, Move)
    assert (effect.source, effect.target) == ("corner/arm.nest", "corner/wc.shelf")


def test_what_is_wrong_is_said_with_its_place() -> None:
    (found,) = findings(CELL.replace("interface: wei_rest_node", "interface: wei_rest_nod"))
    assert found.startswith("corner.yaml:6:")
    assert "no adapter for the interface 'wei_rest_nod'" in found
    assert "wei_rest_node" in found
    (found,) = findings(CELL.replace("rest_node_address", "address"))
    assert "wei_rest_node needs `rest_node_address`" in found
    found = findings(CELL.replace("- move:", "- moves:"))[0]
    assert found.startswith("corner.yaml:18:")
    assert "the effect 'moves' does not fit" in found
    driven = CELL.replace("interface: wei_rest_node", "driver: pf400")
    assert any("`about:` describes a node that no driver describes" in f for f in findings(driven))


def test_a_mapping_is_checked_when_the_file_is_read() -> None:
    text = CELL.replace("wei_rest_node", "rest_node").replace(
        '"http://arm:2000"}', '"http://arm:2000", rest: {action: {pat: /x}}}'
    )
    assert any("In `rest:`, path: is missing" in found for found in findings(text))


def test_a_mapping_of_process_variables_is_checked_too() -> None:
    def list_epics_findings(epics: str) -> str:
        text = CELL.replace("wei_rest_node", "epics_node")
        return "\n".join(findings(text.replace('{rest_node_address: "http://arm:2000"}', epics)))

    assert list_epics_findings("{epics: {actions: {carry: {start: {pv: Go}}}}}") == ""
    assert "epics_node needs `epics`" in list_epics_findings("{}")
    wrong = "{epics: {actions: {carry: {start: {pv: Go}, done: {pv: At}}}}}"
    assert "At needs `is`, `near`, `minimum` or `maximum`" in list_epics_findings(wrong)
    assert "actions.carry.start: is missing" in list_epics_findings(
        "{epics: {actions: {carry: {set: {pv: Go}}}}}"
    )


def test_a_mapping_of_ros_names_is_checked_too() -> None:
    def list_ros_findings(ros: str) -> str:
        text = CELL.replace("wei_rest_node", "ros_node")
        return "\n".join(findings(text.replace('{rest_node_address: "http://arm:2000"}', ros)))

    assert list_ros_findings("{ros: {action: {service: /home, type: std_srvs/srv/Trigger}}}") == ""
    assert "ros_node needs `ros`" in list_ros_findings("{}")
    assert "action: `type` is missing" in list_ros_findings("{ros: {action: {service: /home}}}")
    both = "{ros: {action: {service: /home, action: /dock, type: x/srv/Y}}}"
    assert "write one of `service`, `action` and `frame`" in list_ros_findings(both)


def test_every_interface_that_is_reached_has_an_adapter() -> None:
    assert set(ADAPTERS) == set(REACHED)
    assert not set(ADAPTERS) & set(PLANNED)


def test_a_description_survives_being_written_down() -> None:
    info = {
        "node_name": "shaker",
        "actions": {
            "shake": {
                "description": "Shake it.\nLong.",
                "args": {"speed": {"argument_type": "Optional[float]", "required": False, "default": 3.0}},
                "locations": {"place": {"required": True}},
                "files": {"protocol": {"required": False}},
                "blocking": False,
            }
        },
    }
    told = describe_madsci(info)
    again = make_description(About.model_validate(make_about(told)), told.driver)
    assert again.actions == told.actions
    assert [arg.type for arg in told.actions[0].args] == ["float", "station", "file"]
    assert make_about(Description("d", "1", "")) == {"actions": {}}


def test_effects_are_written_down_too() -> None:
    told = make_about(parse_about())
    assert told["actions"]["seal"]["effects"] == [{"needs": {}}, {"needs": {"station": "nest"}}]


def parse_about() -> Description:
    table = {"actions": {"seal": {"effects": [{"needs": {}}, {"needs": {"station": "nest"}}]}}}
    found = make_description(About.model_validate(table), "x")
    assert found.actions[0].effects[0] == Needs()
    return found


@pytest.mark.parametrize(
    ("written", "kind"),
    [
        ("int", "int"),
        ("<class 'float'>", "float"),
        ("Optional[str]", "str"),
        ("list[int]", "list"),
        ("float | None", "float"),
        ("int | str", "any"),
        (["int", "None"], "int"),
        ("Location[list]", "station"),
        ("numpy.ndarray", "any"),
    ],
)
def test_foreign_types(written: object, kind: str) -> None:
    assert type_of(written) == kind


def test_wei_states_of_all_ages() -> None:
    assert read_state({"status": {"READY": False, "BUSY": True}, "error": None}) == ({"BUSY"}, "")
    assert read_state({"State": "IDLE"}) == ({"IDLE"}, "")
    assert read_state("BUSY") == ({"BUSY"}, "")
    assert read_state({"status": "ERROR", "error": ["a", "b"]}) == ({"ERROR"}, "a; b")
    assert is_working({"BUSY"})
    # An action that raised leaves the node busy in its own eyes.
    assert not is_working({"BUSY", "ERROR"})


def test_wei_files_are_arguments() -> None:
    about = {"name": "x", "actions": [{"name": "run", "args": [], "files": [{"name": "protocol"}]}]}
    (arg,) = describe_wei(about).actions[0].args
    assert (arg.name, arg.type, arg.required) == ("protocol", "file", True)


@pytest.mark.parametrize(
    ("effect", "remedy"),
    [
        ("{sets: {latch: open}}", "Write `sets: {of: …, variable: …, value: …}`; it may also have labware."),
        ("{moves: {}}", "Known effects: claims, "),
        ("{take: {}}", "Write `take: {stack: …, target: …}`; it may also have labware."),
    ],
)
def test_an_effect_that_does_not_fit_says_how_it_is_written(effect: str, remedy: str) -> None:
    text = (
        "labos: 1\nname: bench\nmodules:\n  - name: shaker\n    about: {actions: {latch: {effects: ["
        f"{effect}]}}}}}}\n"
    )
    with pytest.raises(SpecErrors) as caught:
        parse_workcell(text, {})
    (fault,) = caught.value.findings
    assert fault.remedy.startswith(remedy)


OVEN = """
labos: 1
name: corner
modules:
  - name: oven
    about:
      stations: {nest: {}}
      actions:
        bake:
          args:
            minutes: {type: float, unit: min, required: false}
            recipe: {type: file, required: false}
          duration: 30 min
          duration_from: DURATION
"""

BAKE = """
labos: 1
name: bake
steps:
  - {name: bake, module: oven, action: bake, args: ARGS}
"""


def bake_s(duration_from: str, args: str, files: dict[str, bytes]) -> float:
    """How long baking takes, in seconds."""
    cell = parse_workcell(OVEN.replace("DURATION", f'"{duration_from}"'), {})
    flow = parse_workflow(BAKE.replace("ARGS", args))
    compiled = compile_workflow(flow, {}, cell.workcell, {}, bench=cell.bench, files=files)
    return compiled.plan.steps[0].duration_s


def test_arguments_and_the_recipe_decide_how_long_a_step_takes() -> None:
    assert bake_s("{minutes}", "{minutes: 5}", {}) == 300
    assert bake_s("90 + {minutes}", "{minutes: 5}", {}) == 390
    assert bake_s("{minutes}", "{}", {}) == 1800
    recipe = {"r.yaml": b"resources:\n  seconds: 77\n"}
    assert bake_s("{file:recipe:resources.seconds|1800}", "{recipe: r.yaml}", recipe) == 77
    assert bake_s("{file:recipe:resources.seconds|1800}", "{recipe: r.yaml}", {"r.yaml": b"a: 1\n"}) == 1800
    with pytest.raises(SpecErrors, match=r"r\.yaml:1:10: seconds: .*'long'"):
        bake_s("{file:recipe:seconds|1}", "{recipe: r.yaml}", {"r.yaml": b"seconds: long\n"})
    with pytest.raises(SpecErrors, match="There is no argument 'minute'"):
        bake_s("{minute.sum}", "{minutes: 5}", {})
