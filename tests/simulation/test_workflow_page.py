"""Every right example of the page on workflows runs to its end in the simulated lab."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
import yaml

from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.spec import compile_workflow, parse_workflow
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.docs.markdown import REFERENCE, Block, blocks
from tests.simulation.mixes import CELL, DESCRIPTIONS, NODES

PAGE = [block for block in blocks((REFERENCE / "workflow.md").read_text()) if block.language == "yaml"]
RIGHT = [block for block in PAGE if "error" not in block.attributes]
BEFORE = "name: incubate\nsteps:\n- {name: Into incubator, module: hidex, action: close_lid}\n"
"""The run of the same experiment at which an example's window is anchored."""


def compile_example(text: str, payload: dict[str, Any], used: str = "") -> Any:
    return compile_workflow(
        parse_workflow(text, "example.yaml"),
        payload,
        CELL.workcell,
        DESCRIPTIONS,
        bench=CELL.bench,
        files={block.title: block.text.encode() for block in PAGE if used and block.title == used},
        simulate=True,
    )


@pytest.mark.parametrize("block", [pytest.param(block, id=f"line {block.line}") for block in RIGHT])
def test_the_example_runs(block: Block) -> None:
    """What it needs stands where it is needed; its run comes to its end, and the log is right."""
    text = block.text
    if "fragment" in block.attributes:
        text = f"labos: 1\nname: example\nsteps:\n{text}"
    payload = yaml.safe_load(block.attributes.get("payload", "{}"))
    outer = "incubation" in payload
    if outer:
        payload["incubation"] = "incubate"
    found = compile_example(text, payload, block.attributes.get("uses", ""))
    runs = [SubmitRun(found.plan, "ada", payload)]
    if outer:
        runs.insert(0, SubmitRun(compile_example(BEFORE, {}).plan, "ada"))
    stock = [(item.station, item.labware, item.count) for item in CELL.bench.stock]
    stocked = {place for place, _, _ in stock}
    stock += [(place, "plate96", 1) for place in found.inputs if place not in stocked]
    lab = SimulatedLab(Stand(CELL.workcell, tuple(stock), NODES), 1, QUIET)
    try:
        job = Job("example", "ada", tuple(runs), StartExperiment("page", "ada") if outer else None)
        state = lab.run([job], limit_s=3 * 24 * 3600.0)
        assert lab.world.crashes() == []
        if len(stock) == len(
            CELL.bench.stock
        ):  # of plates that came off no stack nobody can tell which is which
            assert lab.differences(state) == []
        count = Counter(record.head.type for record in lab.store.records)
        assert count["run.completed"] == len(runs)
        assert count["intervention.requested"] == 0
    finally:
        lab.close()
