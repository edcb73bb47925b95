"""Lids and grips on paper: what the dry run says of them."""

from __future__ import annotations

from functools import cache

import pytest

from labos.bootstrap import descriptions
from labos.core.ids import StationName
from labos.core.model import Description
from labos.spec import find_spec, parse_workcell, parse_workflow, validate_workflow
from labos.spec.bench import BenchFile, Stock

GET = "- {name: get, module: sciclops, action: get_plate, args: {loc: tower1}}"
UNCOVER = "- {name: uncover, module: sciclops, action: remove_lid}"
COVER = "- {name: cover, module: sciclops, action: replace_lid}"
AGAIN = COVER.replace("cover", "again")
THROW = (
    "- {name: throw, module: pf400, action: transfer, args: {source: sciclops.exchange, target: wc.trash}}"
)
TO_READER = (
    "- {name: in, module: pf400, action: transfer, args: {source: sciclops.exchange, target: hidex.default}}"
)
READ = """\
- {name: shut, module: hidex, action: close_lid}
- {name: read, module: hidex, action: run_assay, args: {assay_name: od}}"""


@cache
def drivers() -> dict[str, Description]:
    return descriptions()


def list_findings(*steps: str, item: str = "plate96+lid96", cell: str = "") -> list[str]:
    text = (
        find_spec("workcells", "rpl")
        .read_text(encoding="utf-8")
        .replace("stations:\n", f"stations:\n{cell}", 1)
    )
    bench = BenchFile((Stock(StationName("rpl/sciclops.tower1"), item, 20),))
    source = parse_workflow("labos: 1\nname: w\nsteps:\n" + "\n".join(steps), "w.yaml")
    workcell = parse_workcell(text, drivers()).workcell
    return [finding.message for finding in validate_workflow(source, {}, workcell, drivers(), bench=bench)]


def test_a_lid_off_and_on_again_is_right() -> None:
    assert list_findings(GET, UNCOVER, COVER, THROW) == []
    assert list_findings(GET, THROW) == []


@pytest.mark.parametrize(
    ("steps", "item", "fault"),
    [
        ((GET, UNCOVER), "plate96", "'uncover': The labware at sciclops.exchange has no lid."),
        (
            (GET, UNCOVER, COVER, AGAIN),
            "plate96+lid96",
            "The labware at sciclops.exchange already has a lid.",
        ),
        (
            (GET, UNCOVER.replace("}", ", args: {target: exchange}}")),
            "plate96+lid96",
            "The lid and its plate cannot both be at sciclops.exchange.",
        ),
        ((GET, UNCOVER, THROW), "plate96+lid96", "its lid stays at sciclops.lidnest1"),
        ((GET, TO_READER, READ), "plate96+lid96", "run_assay needs the labware not lidded"),
    ],
)
def test_what_is_wrong_with_lids(steps: tuple[str, ...], item: str, fault: str) -> None:
    assert any(fault in message for message in list_findings(*steps, item=item))


def test_a_plate_does_not_stand_in_a_nest_for_lids() -> None:
    step = "- {name: park, module: sciclops, action: transfer, args: {source: exchange, target: lidnest1}}"
    assert any("sciclops.lidnest1 does not accept plate96" in message for message in list_findings(GET, step))


def test_a_grip_that_the_type_does_not_leave_is_refused() -> None:
    cell = "  hidex.default: {reach: {pf400: {plate96: [narrow]}}}\n"
    wide = TO_READER.replace("default}", "default, target_plate_rotation: wide}")
    assert list_findings(GET, wide, cell=cell) == [
        "Step 'in': pf400 cannot grip plate96 wide at hidex.default."
    ]
    assert list_findings(GET, wide.replace("wide", "narrow"), cell=cell) == []


def test_a_labware_type_says_how_it_can_be_held(monkeypatch: pytest.MonkeyPatch) -> None:
    from labos.spec import compile_stations

    known = compile_stations.load_packaged_labware()
    held = {**known, "plate96": known["plate96"].model_copy(update={"grips": ["narrow"]})}
    monkeypatch.setattr(compile_stations, "load_packaged_labware", lambda: held)
    wide = TO_READER.replace("default}", "default, target_plate_rotation: wide}")
    assert list_findings(GET, wide) == ["Step 'in': pf400 cannot grip plate96 wide at hidex.default."]
