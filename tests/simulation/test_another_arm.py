"""The paper's PCR runs on a workcell with another arm when only the module's name is changed in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from labos.core.decide.runs import SubmitRun
from labos.spec import compile_workcell, compile_workflow
from labos.spec.importing import import_spec
from labos.spec.source import parse, read
from labos.spec.uses import read_uses
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import DESCRIPTIONS, NODES

PAPER = Path(__file__).parents[1] / "unit/spec/paper"
PAYLOAD = {"seal": {"time": 3}, "seal.time": 3}


def import_cell() -> tuple[str, str]:
    """The paper's workcell and PCR in LabOS' own form."""
    flow = read(PAPER / "pcr_demo_wf.yaml", last_wins=True)
    cell = import_spec(
        read(PAPER / "rpl_modular_workcell.yaml", last_wins=True), DESCRIPTIONS, read_uses([flow])
    )
    assert cell.moved is not None
    return cell.text, import_spec(flow, DESCRIPTIONS, None, [cell.moved]).text


@pytest.mark.parametrize("model", ["pf400", "ur5e", "platecrane"])
def test_only_the_name_is_changed(model: str) -> None:
    cell_text, flow_text = import_cell()
    if model != "pf400":
        # Another lab's arm has another name, and nobody told how it grips.
        cell_text = re.sub(r"reach: \{pf400: \[\w+\]\}", "comment: none", cell_text)
        cell_text = cell_text.replace("model: pf400", f"model: {model}").replace("pf400:", "carrier:")
        cell_text = cell_text.replace("name: pf400", "name: carrier")
        flow_text = flow_text.replace("module: pf400", "module: carrier").replace("pf400,", "carrier,")
    cell = compile_workcell(parse(cell_text, "cell.yaml"), DESCRIPTIONS)
    flow = parse(flow_text, "pcr.yaml", PAPER)
    plan = compile_workflow(flow, PAYLOAD, cell.workcell, DESCRIPTIONS, simulate=True, bench=cell.bench)
    stock = tuple((item.station, item.labware, item.count) for item in cell.bench.stock)
    lab = SimulatedLab(Stand(cell.workcell, stock, NODES), 1, QUIET)
    try:
        lab.run([Job("it", "ada", (SubmitRun(plan.plan, "ada", PAYLOAD),))])
        assert lab.world.crashes() == []
        assert [record.head.type for record in lab.store.records].count("run.completed") == 1
    finally:
        lab.close()
