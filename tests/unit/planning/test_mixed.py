"""Labs in which everything that can keep others from something comes together: nobody is trapped."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from labos.planning.scheduler import Scheduler
from tests.unit.planning.mixed import Mixed, end


def find_trapped(seed: int) -> str:
    """Who cannot go on at the end of a lab in which nothing is broken; empty if nobody."""
    rng = random.Random(seed)
    stays = 0.3 if seed % 5 == 0 else 0.0
    lab = Mixed(rng, stays=stays).submit_all()

    def pump() -> None:
        if rng.random() < 0.05:  # planning has forgotten all that it knew
            lab.scheduler = Scheduler()
            lab.keys.clear()
        lab.pump()

    done = lab.work(rng, pump, end=lambda rng, action: end(lab, rng, action))
    return "" if done or (stays and not lab.state.runs.active) else f"seed {seed}: {lab.describe_stuck()}"


def find_all_trapped(seeds: Iterable[int]) -> list[str]:
    return [who for who in map(find_trapped, seeds) if who]


@pytest.mark.slow
def test_nobody_is_trapped_where_everything_comes_together() -> None:
    assert find_all_trapped([*range(80), 3758]) == []


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_nobody_is_trapped_in_5000_labs() -> None:
    assert find_all_trapped(range(5000)) == []
