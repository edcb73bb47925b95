"""A hundred small labs on very bad days; every crash point together with every fault. See docs/proof.md.

``--range A:B`` takes other seeds; a failing seed prints the one line that replays it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.core.state import LabState, hash_state
from labos.runtime.ledger import fold
from labos.store import read_segment
from tests.simulation.proof.__main__ import seeds_of
from tests.simulation.proof.campaign import ENOUGH, Tally, campaign, describe_failure
from tests.simulation.proof.day import Day, live
from tests.simulation.proof.mutants import CONTROL, MUTANTS, Mutant, mutate, try_mutant

CI_SEEDS = range(100)
MUTANT_SEEDS = 1000


def report(_: Tally, day: Day) -> None:
    if day.wrong:
        print(describe_failure(day), flush=True)


def test_the_same_seed_gives_the_same_day() -> None:
    for seed in (3, 11):
        assert live(seed) == live(seed)


def test_a_saved_day_is_a_log_that_can_be_stepped_through(tmp_path: Path) -> None:
    day = live(2, tmp_path / "seed-2.jsonl")
    state = LabState()
    fold(state, read_segment(tmp_path / "seed-2.jsonl"))
    assert day.hash.endswith(hash_state(state)[:16])


@pytest.mark.timeout(600)
@pytest.mark.slow
def test_nothing_is_lost_and_nothing_moves_twice(request: pytest.FixtureRequest) -> None:
    asked = request.config.getoption("--range")
    seeds = seeds_of(asked) if asked else CI_SEEDS
    tally = campaign(seeds, None, 1, report)
    print(f"\n{tally.table()}\n{tally.summary()}")
    assert not tally.failed, "\n".join(describe_failure(day) for day in tally.failed)
    if len(seeds) >= len(CI_SEEDS):
        assert tally.least() >= ENOUGH


def test_a_campaign_goes_on_where_it_was(tmp_path: Path) -> None:
    known = tmp_path / "known.jsonl"
    first = campaign(range(3), known, 1, report)
    lived: list[int] = []
    again = campaign(range(5), known, 1, lambda _, day: lived.append(day.seed))
    assert (first.seeds, again.seeds, lived) == (3, 5, [3, 4])
    assert again.hits >= first.hits


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_mutants_fit_the_source(mutant: Mutant) -> None:
    assert mutate(mutant)


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_the_control_is_clean() -> None:
    assert try_mutant(CONTROL, MUTANT_SEEDS) == (None, [], MUTANT_SEEDS)


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_mutant_is_caught(mutant: Mutant) -> None:
    seed, lines, _ = try_mutant(mutant, MUTANT_SEEDS)
    assert seed is not None
    print(f"{mutant.name} caught by seed {seed}: {lines[0]}")
