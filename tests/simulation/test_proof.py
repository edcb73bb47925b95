"""Two hundred small labs on very bad days; every crash point together with every fault. See docs/proof.md.

``--range A:B`` takes other seeds; a failing seed prints the one line that replays it.
"""

from __future__ import annotations

import pytest

from tests.simulation.proof.__main__ import seeds_of
from tests.simulation.proof.campaign import ENOUGH, campaign, told
from tests.simulation.proof.day import live

CI_SEEDS = range(200)


def test_the_same_seed_gives_the_same_hash() -> None:
    for seed in (3, 11):
        assert live(seed) == live(seed)


@pytest.mark.timeout(600)
def test_nothing_is_lost_and_nothing_moves_twice(request: pytest.FixtureRequest) -> None:
    asked = request.config.getoption("--range")
    seeds = seeds_of(asked) if asked else CI_SEEDS
    tally = campaign(seeds, None, 1, lambda _, day: print(told(day)) if day.wrong else None)
    print(f"\n{tally.table()}\n{tally.summary()}")
    assert not tally.failed, "\n".join(told(day) for day in tally.failed)
    if len(seeds) >= len(CI_SEEDS):
        assert tally.least() >= ENOUGH
