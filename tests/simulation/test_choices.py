"""Runs that take either of two cyclers, with real drivers' simulators: the log and the bench agree."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.core.decide.runs import SubmitRun
from labos.core.registry import decode
from labos.core.runs import RunBound
from labos.spec import compile_workflow, parse_workflow
from labos.spec.choices import list_choices
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab
from tests.benchmarks.league.cases import RPL_STOCK, two_cyclers
from tests.benchmarks.league.play import Player
from tests.docs.markdown import REFERENCE, blocks
from tests.simulation.mixes import CELL, DESCRIPTIONS, stand

TEXT = next(
    block.text
    for block in blocks((REFERENCE / "workflow.md").read_text())
    if block.title == "cycle anywhere.yaml"
)


def cycle_anywhere() -> SubmitRun:
    found = compile_workflow(
        parse_workflow(TEXT, "cycle.yaml"),
        {},
        CELL.workcell,
        DESCRIPTIONS,
        bench=CELL.bench,
        simulate=True,
    )
    assert list_choices(found.plans)["Cycle"] == ["biometra", "biometra_192"]
    return SubmitRun(found.plan, "ada", others=found.others)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_plates_are_shared_between_two_cyclers_and_stand_where_the_log_says(seed: int) -> None:
    lab = SimulatedLab(stand(), seed, QUIET)
    try:
        state = lab.run([Job(f"j{n}", "ada", (cycle_anywhere(),)) for n in range(4)], limit_s=2 * 24 * 3600.0)
        assert lab.differences(state) == []
        assert lab.world.crashes() == []
        events = [
            decode(record.head.type, record.head.schema, record.payload)
            for record in lab.store.records
            if record.head.type == RunBound.TYPE
        ]
        taken = Counter(event.modules["Cycle"] for event in events if isinstance(event, RunBound))
        assert taken == {"rpl/biometra": 2, "rpl/biometra_192": 2}
        assert state.runs.plans == {}
    finally:
        lab.close()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_eight_unlike_pcr_that_choose_are_hardly_slower_than_with_a_fixed_share(seed: int) -> None:
    """With a fixed share the lab looks ahead, among runs that choose it does not."""
    fixed = Player(CELL.workcell, RPL_STOCK, together=False).play(two_cyclers(seed, share=True)).makespan_s
    free = Player(CELL.workcell, RPL_STOCK, together=False).play(two_cyclers(seed, share=False)).makespan_s
    assert free <= 1.03 * fixed
