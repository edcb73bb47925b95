"""A centrifuge: the plates of several runs are spun together, each of them once."""

from __future__ import annotations

import pytest

from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.decide.runs import SubmitRun
from labos.core.registry import decode
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Meddle, SimulatedLab, make_cancellers
from tests.simulation.corners import Corner, jobs
from tests.support.centrifuge import Centrifuge, count_spins, list_turns

CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: stack, model: sciclops}
  - {name: ur, model: ur5}
  - name: spinner
    driver: centrifuge
    together: {actions: [spin], wait: 20 min}
stations:
  spinner.rotor: {shelves: 4, access: {lid: open}}
  wc.trash: {kind: waste}
stock:
  stack.tower1: {plate96: 20}
""",
    Centrifuge,
)


def spin(g: int = 3000, user: str = "ada") -> SubmitRun:
    """A plate is spun and thrown away."""
    return CORNER.run(
        f"spin at {g}",
        "stack.get_plate loc=tower1",
        "ur.transfer source=stack.exchange target=spinner.rotor",
        f"spinner.spin g={g}",
        "ur.transfer source=spinner.rotor target=wc.trash",
        user=user,
    )


def live_through(runs: list[SubmitRun], seed: int, rates: FaultRates = QUIET) -> list[int]:
    """All runs to their ends, each plate spun once; returns how many plates were in each turn."""
    lab = SimulatedLab(CORNER.stand, seed, rates)
    try:
        state = lab.run(jobs(runs))
        assert lab.differences(state) == [], f"seed {seed}"
        assert set(count_spins(lab.world).values()) == {1}, f"seed {seed}: {list_turns(lab.world)}"
        return [len(plates) for plates in list_turns(lab.world)]
    finally:
        lab.close()


def test_eight_plates_in_two_turns() -> None:
    turns = live_through([spin() for _ in range(8)], 0)
    assert turns == [4, 4]


def test_what_is_spun_differently_is_not_spun_together() -> None:
    turns = live_through([spin(g) for g in (3000, 500, 3000, 500, 3000)], 1)
    assert sum(turns) == 5
    assert len(turns) >= 2


def test_each_run_has_an_action_and_a_result_of_its_own() -> None:
    lab = SimulatedLab(CORNER.stand, 2, QUIET)
    try:
        lab.run(jobs([spin() for _ in range(4)]))
        heads = [(record.head, record.payload) for record in lab.store.read()]
        events = [decode(head.type, head.schema, payload) for head, payload in heads]
        requests = [e for e in events if isinstance(e, ActionRequested) and e.name == "spin"]
        assert {e.run for e in requests} == {"R1", "R2", "R3", "R4"}
        assert {e.together for e in requests} == {tuple(e.action for e in requests)}
        ends = [e for e in events if isinstance(e, ActionSucceeded) and e.action in requests[0].together]
        [plates] = list_turns(lab.world)
        assert [e.result for e in ends] == [plates] * 4
    finally:
        lab.close()


def leave() -> SubmitRun:
    """The same; when it is cancelled, its plate is taken out."""
    return CORNER.run(
        "spin and leave",
        "stack.get_plate loc=tower1",
        "ur.transfer source=stack.exchange target=spinner.rotor",
        "spinner.spin g=3000",
        "ur.transfer source=spinner.rotor target=wc.trash",
        on_cancel=[
            "ur.transfer source=stack.exchange target=wc.trash",
            "ur.transfer source=spinner.rotor target=wc.trash",
        ],
    )


def cancel(cancels: dict[str, int], seed: int, rates: FaultRates = QUIET) -> tuple[int, list[int]]:
    """Four runs, of which some are cancelled when the step named has begun; how many have completed, and how
    many plates were in each turn. No plate is spun twice."""
    lab = SimulatedLab(CORNER.stand, seed, rates, meddles=make_cancellers(cancels))
    try:
        state = lab.run(jobs([leave() for _ in range(4)]))
        assert lab.differences(state) == [], f"seed {seed}"
        assert lab.world.crashes() == [], f"seed {seed}"
        assert set(count_spins(lab.world).values()) == {1}, f"seed {seed}: {list_turns(lab.world)}"
        completed = sum(record.head.type == "run.completed" for record in lab.store.records)
        return completed, [len(plates) for plates in list_turns(lab.world)]
    finally:
        lab.close()


def test_a_run_that_is_cancelled_while_it_waits_takes_its_plate_out_before_the_others_are_spun() -> None:
    completed, turns = cancel({"j0/0": 1}, 0)
    assert completed == 3
    assert sum(turns) == 3


def test_a_run_that_is_cancelled_while_the_rotor_turns_ends_after_its_action() -> None:
    completed, turns = cancel({"j1/0": 2}, 0)
    assert completed == 3
    assert turns == [4]


def test_who_stops_the_device_stops_all_of_them() -> None:
    """Nobody knows what was done then: each run fails, as after any stop."""
    lab = SimulatedLab(
        CORNER.stand, 3, QUIET, meddles=[Meddle("j3/0", 2, lambda run: [(30.0, "corner/spinner")])]
    )
    try:
        lab.run(jobs([spin() for _ in range(4)]))
        ends = [record.head.type for record in lab.store.records]
        assert ends.count("run.failed") == 4
        assert ends.count("action.failed") == 4
        assert len(list_turns(lab.world)) == 1
    finally:
        lab.close()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_cancelled_in_a_storm(seed: int) -> None:
    cancel({f"j{seed % 4}/0": seed % 3, f"j{(seed + 1) % 4}/0": 2}, seed, STORMY)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_in_a_storm_each_plate_is_spun_once_too(seed: int) -> None:
    wanted = [(3000, "ada"), (3000, "bo")] * 4 + [(500, "ada")] * 2
    live_through([spin(g, user) for g, user in wanted], seed, STORMY)
