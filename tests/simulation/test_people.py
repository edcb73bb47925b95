"""A person as a module in whole labs: sometimes late, in storms, with plates that are really moved."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.core.decide import LABOS, decide
from labos.core.decide._base import DECIDERS, Decision
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.runs import SubmitRun
from labos.core.decide.work import NoteOverdue
from labos.core.state import LabState
from labos.spec import compile_workflow, find_spec, parse_workcell, parse_workflow
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import DESCRIPTIONS, NODES, on

BY_HAND = "\n".join(
    (
        "name: by hand",
        "flowdef:",
        on("sciclops", "get_plate", "loc: tower1"),
        on("operator", "carry_plate", "source: sciclops.exchange, target: camera_module.plate_station"),
        on("camera_module", "take_picture", "file_name: a.jpg"),
        on("operator", "do", "instruction: look at it, within: 60"),
        on("pf400", "transfer", "source: camera_module.plate_station, target: sealer.default"),
        on("sealer", "seal", "time: 3.0, temperature: 175"),
        on("operator", "carry_plate", "source: sealer.default, target: wc.trash"),
    )
)


RPL = find_spec("workcells", "rpl").read_text()
PERSON = "modules:\n  - {name: operator, model: person, config: {alone: false}}\n"
CELL = parse_workcell(RPL.replace("modules:\n", PERSON, 1), DESCRIPTIONS)
"""RPL with a person, whose hands are those of whoever walks by in the simulated lab."""


def by_hand(name: str, user: str, after_s: float = 0.0) -> Job:
    compiled = compile_workflow(
        parse_workflow(_name_steps(BY_HAND), "by_hand.yaml"),
        {},
        CELL.workcell,
        DESCRIPTIONS,
        simulate=True,
        bench=CELL.bench,
    )
    return Job(name, user, (SubmitRun(compiled.plan, user),), after_s=after_s)


def _name_steps(text: str) -> str:
    return "\n".join(
        line.replace("- {", f"- {{name: s{index}, ") for index, line in enumerate(text.split("\n"))
    )


def live_through(seed: int, rates: FaultRates) -> Counter[str]:
    """Four plates by hand; the bench and the log agree in every one of them."""
    stock = tuple((s.station, s.labware, s.count) for s in CELL.bench.stock)
    lab = SimulatedLab(Stand(CELL.workcell, stock, NODES), seed, rates)
    try:
        state = lab.run([by_hand(f"j{number}", "ada", number * 300.0) for number in range(4)])
        assert lab.differences(state) == [], f"seed {seed}"
        assert lab.world.crashes() == []
        assert not state.interventions.open
        carried = [m.plate for m in lab.world.motions("grip") if m.device == "operator"]
        assert len(carried) == 8, "each carry was done once"
        return Counter(record.head.type for record in lab.store.records)
    finally:
        lab.close()


def test_a_person_is_sometimes_late_and_nothing_fails() -> None:
    count = Counter[str]()
    for seed in range(4):
        count += live_through(seed, QUIET)
    assert count["run.completed"] == 16
    assert count["intervention.overdue"] > 0
    assert count["run.failed"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_in_a_storm_planned_work_is_done_once(seed: int) -> None:
    live_through(seed, STORMY)


def test_believed_when_its_time_is_over_work_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who is late is asked again, and is not taken at a word that nobody gave."""

    real = DECIDERS[NoteOverdue]

    def believe(state: LabState, command: NoteOverdue) -> Decision:
        return real(state, command) and decide(
            state, ResolveIntervention(command.intervention, "done", "nobody"), LABOS
        )

    monkeypatch.setitem(DECIDERS, NoteOverdue, believe)
    stock = tuple((s.station, s.labware, s.count) for s in CELL.bench.stock)
    wrong: list[str] = []
    for seed in range(4):
        lab = SimulatedLab(Stand(CELL.workcell, stock, NODES), seed, QUIET)
        lab.late = 0.97
        try:
            wrong += lab.differences(lab.run_for([by_hand("late", "ada")], 4 * 3600.0))
        finally:
            lab.close()
    assert wrong
