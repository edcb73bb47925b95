"""What the inventory says runs out, and in which run, is what happens in a whole simulated lab."""

from __future__ import annotations

import random

import pytest

from labos.core.ids import local
from labos.core.runs import PENDING, RunSubmitted
from labos.core.state import LabState
from labos.runtime.ledger import fold
from labos.services.inventory import Inventory, Shortfall, count_inventory, list_shortfalls
from labos.services.log import decode_events
from labos.services.times import iso_time
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.corners import Corner, jobs

CORNER = """
labos: 1
name: corner
modules:
  - {{name: left, model: sciclops}}
  - {{name: ur, model: ur5}}
  - {{name: sealer, model: A4S_sealer, resources: {{foil: {foil}}}}}
  - {{name: peeler, model: brooks_xpeel, resources: {{tape: {tape}}}}}
stations:
  wc.trash: {{kind: waste, capacity: 50}}
stock:
  left.tower1: {{plate96: {plates}}}
"""
FETCH = "left.get_plate loc=tower1"
SEAL = ("ur.transfer source=left.exchange target=sealer.default", "sealer.seal")
PEEL = ("ur.transfer source=sealer.default target=peeler.default", "peeler.peel")
AGAIN = ("ur.transfer source=peeler.default target=sealer.default", "sealer.seal")
KINDS = {
    "once": (FETCH, *SEAL, "ur.transfer source=sealer.default target=wc.trash"),
    "twice": (FETCH, *SEAL, *PEEL, *AGAIN, "ur.transfer source=sealer.default target=wc.trash"),
    "peeled": (FETCH, *SEAL, *PEEL, "ur.transfer source=peeler.default target=wc.trash"),
}
LONG_ENOUGH_S = 2 * 3600.0


def compare_inventories(
    corner: Corner, kinds: list[str], seed: int
) -> tuple[Inventory, LabState, dict[str, set[str]]]:
    """What the inventory said when everything was queued; the state when nothing went on any more;
    and what each run that is left waits for."""
    lab = SimulatedLab(corner.stand, seed, QUIET)
    try:
        asked = jobs([corner.run(kind, *KINDS[kind]) for kind in kinds])
        end = lab.run_for(in_turn(asked), LONG_ENOUGH_S)
        kernel = lab.kernel
        assert kernel is not None
        runs = [*end.runs.active.values(), *end.runs.queued.values()]
        waits = {
            run.id: {
                ":".join(map(str, wait.names[:2]))
                for _, wait in kernel.scheduler.list_waits(end, run, kernel.clock.now_ns())
                if wait.code in ("used_up", "stack_empty")
            }
            for run in runs
        }
        assert lab.world.crashes() == []
        records = list(lab.store.read())
    finally:
        lab.close()
    submitted = [head.position for event, head in decode_events(records) if isinstance(event, RunSubmitted)]
    before = LabState()
    fold(before, records[: submitted[len(kinds) - 1]])
    return count_inventory(before, before.recorded_at, iso_time(before.recorded_at)[:10]), end, waits


def in_turn(asked: list[Job]) -> list[Job]:
    """Submitted one by one, within a second."""
    return [Job(job.name, job.user, job.runs, after_s=0.1 * number) for number, job in enumerate(asked)]


def position(name: str) -> int:
    return int(name[1:])


def first_short(found: Inventory) -> tuple[str, set[str]]:
    """The oldest run that is told to find too little, and of what."""
    told: list[tuple[str, Shortfall]] = list_shortfalls(found)
    if not told:
        return "", set()
    run = min((out.run for _, out in told), key=position)
    return run, {name for name, out in told if out.run == run}


@pytest.mark.parametrize("seed", range(5))
def test_the_run_that_is_told_to_find_too_little_does(seed: int) -> None:
    rng = random.Random(seed)
    corner = Corner(CORNER.format(foil=rng.randint(2, 6), tape=rng.randint(1, 4), plates=rng.randint(2, 6)))
    found, end, waits = compare_inventories(corner, [rng.choice(list(KINDS)) for _ in range(6)], seed)
    run, lacks = first_short(found)
    left = {*end.runs.active, *end.runs.queued}
    if not run:
        assert not left
        return
    assert min(left, key=position) == run, "all before it have ended"
    assert waits[run] & lacks, "and this is what it waits for"


def test_the_step_at_which_a_run_stops_half_way_is_told() -> None:
    corner = Corner(CORNER.format(foil=1, tape=5, plates=5))
    found, end, waits = compare_inventories(corner, ["twice"], 0)
    ((name, out),) = list_shortfalls(found)
    assert local(name) == "sealer:foil"
    (run,) = end.runs.active.values()
    step = end.runs.plan_of(run).steps[run.statuses.index(PENDING)]
    assert (out.run, out.step) == (run.id, step.key)
    assert waits == {run.id: {name}}
