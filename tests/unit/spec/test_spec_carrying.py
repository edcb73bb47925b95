"""How labware is gripped at a station goes from foreign workflows to the workcell's file."""

from __future__ import annotations

from labos.bootstrap import descriptions
from labos.spec.importing import Imported, import_spec
from labos.spec.source import make_plain, parse
from labos.spec.uses import read_uses

CELL = """\
name: cell
modules:
  - {name: arm, model: pf400}
  - {name: sealer, model: A4S_sealer}
  - {name: camera, model: camera (logitech)}
locations:
  arm:
    sealer.default: [1, 2, 3, 4, 5, 6]
    camera.plate_station: [1, 2, 3, 4, 5, 6]
    wc.shelf: [1, 2, 3, 4, 5, 6]
    wc.gate: [1, 2, 3, 4, 5, 6]
"""


def flow(name: str, *steps: str) -> str:
    lines = [f"  - {{name: s{number}, module: arm, {step}}}" for number, step in enumerate(steps)]
    return "\n".join([f"name: {name}", "flowdef:", *lines, ""])


def carry(source: str, target: str, **args: str) -> str:
    told = {"source": source, "target": target, **args}
    return f"action: transfer, args: {{{', '.join(f'{name}: {value}' for name, value in told.items())}}}"


def import_flows(*flows: str) -> tuple[Imported, list[Imported]]:
    sources = [parse(text, f"{number}.yaml") for number, text in enumerate(flows)]
    cell = import_spec(parse(CELL, "cell.yaml"), descriptions(), read_uses(sources))
    assert cell.moved is not None
    return cell, [import_spec(source, descriptions(), None, [cell.moved]) for source in sources]


def reach(cell: Imported) -> dict[str, object]:
    stations = make_plain(parse(cell.text).data).get("stations", {})
    return {place: entry["reach"]["arm"] for place, entry in stations.items() if "reach" in entry}


def args(file: Imported) -> list[dict[str, object]]:
    return [step["args"] for step in make_plain(parse(file.text).data)["steps"]]


def test_what_all_say_alike_stands_in_the_workcell() -> None:
    grips = {"source_plate_rotation": "narrow", "target_plate_rotation": "wide"}
    there = carry("sealer.positions.default", "camera.plate_station", **grips)
    back = carry("camera.plate_station", "wc.shelf", source_plate_rotation="wide")
    cell, (one, two) = import_flows(flow("one", there), flow("two", there, back))
    assert reach(cell) == {"sealer.default": ["narrow"], "camera.plate_station": ["wide"]}
    assert "# The workflows say that arm grips narrow here." in cell.text
    assert args(one) == [{"source": "sealer.positions.default", "target": "camera.plate_station"}]
    assert [list(each) for each in args(two)] == [["source", "target"]] * 2
    assert "# How labware is gripped stands in the workcell's file." in two.text


def test_what_they_do_not_agree_on_stays_where_it_is() -> None:
    cell, (one, two, three) = import_flows(
        flow("one", carry("sealer.default", "wc.shelf", source_plate_rotation="narrow")),
        flow("two", carry("sealer.default", "wc.shelf", source_plate_rotation="wide")),
        flow("three", carry("camera.plate_station", "wc.shelf", source_plate_rotation="payload.grip")),
    )
    assert reach(cell) == {}
    assert [args(file)[0].get("source_plate_rotation") for file in (one, two, three)] == [
        "narrow", "wide", "payload.grip"
    ]  # fmt: skip
    assert "How labware is gripped" not in one.text


def test_an_approach_goes_to_the_arm() -> None:
    through = carry("wc.shelf", "sealer.default", source_approach="wc.gate")
    cell, (file,) = import_flows(flow("one", through))
    arm = next(module for module in make_plain(parse(cell.text).data)["modules"] if module["name"] == "arm")
    assert arm["config"] == {"approach": {"wc.shelf": "wc.gate"}}
    assert args(file) == [{"source": "wc.shelf", "target": "sealer.default"}]


def test_an_arm_that_was_taught_nothing_is_told_by_the_workflow() -> None:
    grips = {"source_plate_rotation": "narrow", "target_plate_rotation": "wide"}
    source = parse(flow("one", carry("sealer.default", "camera.plate_station", **grips)), "one.yaml")
    cell = import_spec(parse(CELL[: CELL.index("locations:")], "c.yaml"), descriptions(), read_uses([source]))
    assert cell.moved is not None
    assert args(import_spec(source, descriptions(), None, [cell.moved]))[0].keys() >= grips.keys()


def test_a_workflow_of_two_workcells_is_shorter_by_what_both_say() -> None:
    narrow = parse(
        flow("one", carry("sealer.default", "wc.shelf", source_plate_rotation="narrow")), "one.yaml"
    )
    wide = parse(flow("two", carry("sealer.default", "wc.shelf", source_plate_rotation="wide")), "two.yaml")
    cells = [
        import_spec(parse(CELL, "cell.yaml"), descriptions(), read_uses(uses))
        for uses in ([narrow], [narrow, wide])
    ]
    moved = [cell.moved for cell in cells if cell.moved is not None]
    assert args(import_spec(narrow, descriptions(), None, moved[:1])) == [
        {"source": "sealer.default", "target": "wc.shelf"}
    ]
    assert "source_plate_rotation" in args(import_spec(narrow, descriptions(), None, moved))[0]
