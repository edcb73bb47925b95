"""Hotels with shelves in workcell files, and in the workflows that use them."""

from __future__ import annotations

import pytest

from labos.core.ids import local
from labos.spec import compile_workflow, parse_workcell, parse_workflow
from labos.spec.findings import SpecErrors
from labos.spec.workcell import CompiledWorkcell
from tests.simulation.mixes import DESCRIPTIONS

CELL = """\
labos: 1
name: corner
modules:
  - {name: stacker, model: sciclops}
  - {name: arm, model: pf400}
  - {name: eye, model: camera}
stations:
  wc.hotel: {shelves: 3, accepts: [plate96, pcr96], zone: table, observer: eye}
  wc.trash: {kind: waste}
locations:
  arm:
    stacker.exchange: [222.0, -38.1, 335.9, 325.4, 79.9, 995.1]
    wc.trash: [218.5, -2.4, 38.8, 683.5, 89.1, 995.1]
    wc.hotel: {first: [72.9, -20.3, 262.5, 371.9, 80.5, 640.2], step: [28.5, 0, 0, 0, 0, 0]}
stock:
  wc.hotel: {plate96: 1, pcr96: 1}
"""


def load(text: str = CELL) -> CompiledWorkcell:
    return parse_workcell(text, DESCRIPTIONS, "corner.yaml")


def faults(text: str) -> list[str]:
    with pytest.raises(SpecErrors) as told:
        load(text)
    return [str(finding) for finding in told.value.findings]


def test_shelves_are_stations_like_their_hotel() -> None:
    cell = load()
    known = {local(s.name): s for s in cell.workcell.stations if s.name.startswith("corner/wc.hotel")}
    assert list(known) == ["wc.hotel", "wc.hotel.1", "wc.hotel.2", "wc.hotel.3"]
    assert [s.capacity for s in known.values()] == [3, 1, 1, 1]
    assert {s.kind for s in known.values()} == {"hotel"}
    for shelf in list(known.values())[1:]:
        assert local(shelf.hotel) == "wc.hotel"
        assert shelf.accepts == ("plate96", "pcr96")
        assert (shelf.zone, shelf.observer, list(shelf.reach)) == (
            "corner/table",
            "corner/eye",
            ["corner/arm"],
        )
    assert "wc.hotel" not in [local(s.name) for s in cell.workcell.places]
    assert cell.findings == ()


def test_an_arm_learns_a_pose_for_each_shelf() -> None:
    poses = load().workcell.modules[1].config["poses"]
    assert {place: pose[0] for place, pose in poses.items() if "hotel" in place} == {
        "wc.hotel.1": 72.9,
        "wc.hotel.2": 101.4,
        "wc.hotel.3": 129.9,
    }
    written = "wc.hotel: {first: [72.9, -20.3, 262.5, 371.9, 80.5, 640.2], step: [28.5, 0, 0, 0, 0, 0]}"
    each = "\n    ".join(f"wc.hotel.{n}: [{n}, 0, 0, 0, 0, 0]" for n in (1, 2, 3))
    assert load(CELL.replace(written, each)).workcell.modules[1].config["poses"]["wc.hotel.3"][0] == 3


def test_its_stock_stands_on_the_lowest_shelves() -> None:
    stock = [(local(s.station), s.labware, s.count) for s in load().bench.stock]
    assert stock == [("wc.hotel.1", "plate96", 1), ("wc.hotel.2", "pcr96", 1)]


HOTEL = "wc.hotel: {shelves: 3, accepts: [plate96, pcr96], zone: table, observer: eye}"
POSES = "{first: [72.9, -20.3, 262.5, 371.9, 80.5, 640.2], step: [28.5, 0, 0, 0, 0, 0]}"


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("shelves: 3", "shelves: 3, capacity: 4", "8:36: stations.wc.hotel.capacity: 'wc.hotel' has shelves"),
        ("shelves: 3", "shelves: 3, kind: nest", "stations.wc.hotel.kind: 'wc.hotel' has shelves"),
        ("shelves: 3", "shelves: 0", "8:"),
        ("shelves: 3", "capacity: 3", "wc.hotel has no shelves, but arm has a pose for its first shelf."),
        (POSES, "[72.9, -20.3, 262.5, 371.9, 80.5, 640.2]", "arm was taught only one place there"),
        (", step: [28.5, 0, 0, 0, 0, 0]", ", step: [28.5]", "The first shelf has 6 values, the step 1."),
        (
            f"wc.hotel: {POSES}",
            "wc.hotel.2: [1, 2, 3, 4, 5, 6]",
            "these are missing: wc.hotel.1, wc.hotel.3.",
        ),
        ("plate96: 1, pcr96: 1", "plate96: 3, pcr96: 1", "wc.hotel holds 3, not 4."),
        (HOTEL, HOTEL + "\n  wc.hotel.2: {rotation: 90}", "wc.hotel.2 is a shelf of wc.hotel"),
    ],
)
def test_what_is_wrong_is_told(before: str, after: str, fault: str) -> None:
    assert CELL.count(before) == 1
    found = faults(CELL.replace(before, after))
    assert any(fault in told for told in found), found
    assert all(told.startswith("corner.yaml:") for told in found), found


STEPS = """\
labos: 1
name: flow
steps:
  - {name: out, module: arm, action: transfer, args: {source: SOURCE, target: wc.trash}}
"""


def test_a_step_names_the_hotel() -> None:
    cell = load()
    more = {"simulate": True, "bench": cell.bench}

    def compile_flow(source: str) -> None:
        text = parse_workflow(STEPS.replace("SOURCE", source), "flow.yaml")
        found = compile_workflow(text, {}, cell.workcell, DESCRIPTIONS, **more)  # type: ignore[arg-type]
        assert [str(finding) for finding in found.findings] == []

    compile_flow("wc.hotel")
    compile_flow("hotel")
    alike = load(CELL.replace("plate96: 1, pcr96: 1", "pcr96: 2").replace("plate96, pcr96]", "pcr96]"))
    small = CELL.replace("plate96: 1, pcr96: 1", "pcr96: 2").replace(
        "kind: waste", "kind: nest, accepts: [plate96]"
    )
    text = parse_workflow(STEPS.replace("SOURCE", "wc.hotel"), "flow.yaml")
    with pytest.raises(SpecErrors, match=r"wc\.trash does not accept pcr96"):
        compile_workflow(text, {}, load(small).workcell, DESCRIPTIONS, simulate=True, bench=alike.bench)
    with pytest.raises(SpecErrors, match=r"wc.hotel.2 is a shelf of wc.hotel.*Write wc.hotel"):
        compile_flow("wc.hotel.2")
    with pytest.raises(SpecErrors, match=r"There is no station 'hotel\.2'"):
        compile_flow("hotel.2")
