"""The packaged specs, and public files that nobody wrote for LabOS."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import pytest
from spec_bench import DESCRIPTIONS

from labos.core.model import Description
from labos.errors import NotFound, SpecError
from labos.node import Node
from labos.spec import (
    compile_workflow,
    find_spec,
    list_specs,
    load_labware,
    load_workcell,
    validate_workcell,
    validate_workflow,
)
from tests.support.corpus import corpus

PAYLOADS: dict[str, dict[str, Any]] = {
    "cp_mixcolor": {
        "color_A_volumes": [10.0],
        "color_B_volumes": [20.0],
        "color_C_volumes": [30.0],
        "destination_wells": ["A1"],
    }
}
ENDS = {
    "pcr": ((), ("rpl/wc.output",)),
    "cp_newplate": ((), ("rpl/wc.parking",)),
    "cp_mixcolor": (("rpl/wc.parking",), ("rpl/wc.parking",)),
    "cp_trashplate": (("rpl/wc.parking",), ("rpl/wc.trash",)),
}


def real_drivers() -> dict[str, Description]:
    package = importlib.import_module("labos_drivers")
    found: dict[str, Description] = {}
    for info in pkgutil.iter_modules(package.__path__):
        if info.name.startswith("_"):
            continue
        for value in vars(importlib.import_module(f"labos_drivers.{info.name}")).values():
            if isinstance(value, type) and issubclass(value, Node) and value.driver == info.name:
                found[info.name] = value.describe()
    return found


@pytest.fixture(params=["by hand", "drivers"])
def descriptions(request: pytest.FixtureRequest) -> dict[str, Description]:
    return DESCRIPTIONS if request.param == "by hand" else real_drivers()


def test_the_packaged_workcell_and_workflows_compile(descriptions: dict[str, Description]) -> None:
    loaded = load_workcell(find_spec("workcells", "rpl"), descriptions)
    assert loaded.findings == ()
    assert len(loaded.workcell.modules) == 14
    for name, (inputs, outputs) in ENDS.items():
        result = compile_workflow(
            find_spec("workflows", name),
            PAYLOADS.get(name, {}),
            loaded.workcell,
            descriptions,
            bench=loaded.bench,
        )
        assert (result.inputs, result.outputs, result.findings) == (inputs, outputs, ())


def test_every_packaged_workflow_is_tested() -> None:
    assert set(list_specs("workflows")) == set(ENDS)


def test_labware() -> None:
    plates = load_labware(find_spec("labware", "plates"))
    assert set(plates) == {"plate96", "pcr96", "lid96"}
    assert plates.pop("lid96").wells is None
    for plate in plates.values():
        assert (plate.footprint.length_mm, plate.footprint.width_mm) == (127.76, 85.48)
        assert plate.wells is not None
        assert plate.wells.rows * plate.wells.columns == 96


def test_an_unknown_spec() -> None:
    with pytest.raises(NotFound, match="Did you mean 'rpl'"):
        find_spec("workcells", "rlp")


def test_public_files_load_or_say_why_not() -> None:
    """Whatever is in them, each gives findings with a place, and nothing else is raised."""
    root = corpus() / "corpus"
    descriptions = real_drivers()
    workcells, workflows = 0, 0
    for path in sorted(root.rglob("*.y*ml")):
        if "workflows" in path.parts:
            loaded = load_workcell(find_spec("workcells", "rpl"), descriptions)
            findings = validate_workflow(path, {}, loaded.workcell, descriptions, simulate=True)
            workflows += not any(finding.severity == "error" for finding in findings)
        else:
            findings = validate_workcell(path, descriptions)
            workcells += not any(finding.severity == "error" for finding in findings)
        for finding in findings:
            assert finding.file == str(path)
            assert finding.remedy
            assert finding.line or isinstance(finding.as_error(), SpecError)
    assert workcells >= 5
    assert workflows >= 3


def test_the_papers_folder_loads() -> None:
    root = corpus() / "paper"
    descriptions = real_drivers()
    loaded = load_workcell(root / "rpl_modular_workcell.yaml", descriptions)
    assert [finding.severity for finding in loaded.findings] == ["warning"]
