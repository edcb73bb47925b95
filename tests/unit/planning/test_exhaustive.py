"""What safety answers in every state of small workcells is what is true there, or more careful."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from tests.unit.planning.exhaustive import Count, Explored, SmallCell
from tests.unit.planning.test_safety_at_once import make_crossing

KINDS = (
    ("holds",),
    ("holds", "decks"),
    ("holds", "setpoints"),
    ("forks",),
    ("forks", "holds"),
    ("forks", "decks", "holds"),
)


def count_all(seeds: Iterable[int]) -> Count:
    total = Count()
    for seed in seeds:
        kinds = KINDS[seed % len(KINDS)]
        count = Explored(SmallCell(random.Random(seed), *kinds).submit_all()).count()
        assert not count.unsafe_allowed, (seed, kinds, count)
        assert not count.dead_ends, (seed, kinds, count)
        total = total.with_(count)
    return total


@pytest.mark.slow
def test_no_start_that_safety_allows_takes_away_anybodys_way_to_the_end() -> None:
    count = count_all(range(18))
    assert count.safe_refused < 0.02 * count.asked, count


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("beside",), ("beside", "decks")], ids="-".join)
def test_a_branch_that_is_written_later_may_go_first(kinds: tuple[str, ...]) -> None:
    """Two branches of a run use the same places: whichever has taken one goes on first."""
    count = Count()
    for seed in (0, 1, 3, 4):
        count = count.with_(Explored(SmallCell(random.Random(seed), *kinds).submit_all()).count())
    assert (count.unsafe_allowed, count.dead_ends, count.safe_refused) == (0, 0, 0), count


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_no_start_of_a_branch_is_unsafe_in_any_state_of_300_small_workcells() -> None:
    count = Count()
    for seed in range(300):
        kinds = (("beside",), ("beside", "decks"))[seed % 2]
        found = Explored(SmallCell(random.Random(seed), *kinds).submit_all()).count()
        assert not found.unsafe_allowed, (seed, kinds, found)
        assert not found.dead_ends, (seed, kinds, found)
        count = count.with_(found)
    assert count.safe_refused < 0.005 * count.asked, count


@pytest.mark.parametrize("first", range(4))
def test_there_is_no_dead_end_where_two_cross_and_one_keeps_a_module(first: int) -> None:
    count = Explored(make_crossing(first, first)).count()
    assert (count.unsafe_allowed, count.dead_ends, count.safe_refused) == (0, 0, 0), count


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_no_start_is_unsafe_in_any_state_of_600_small_workcells(capsys: pytest.CaptureFixture[str]) -> None:
    count = count_all(range(600))
    with capsys.disabled():
        share = 100 * count.safe_refused / count.asked
        print(f"\n{count}: {share:.2f} % of what was asked was refused though it is safe")
    assert count.safe_refused < 0.015 * count.asked
