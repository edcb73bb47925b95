"""Chains of steps find the same earliest end in a timetable of bits as by trying every start."""

from __future__ import annotations

import random

from msgspec.structs import replace

from labos.planning.chains import Chain, Fit, Leg, SlotTable

SLOTS = 30
RESOURCES = 4


def is_free(table: SlotTable, resources: tuple[int, ...], begin: int, end: int) -> bool:
    return end <= SLOTS and not any(
        table.taken[r] >> slot & 1 for r in resources for slot in range(begin, end)
    )


def find_ends(table: SlotTable, chain: Chain) -> set[int]:
    """All ends that a chain can have, by trying every start of every step."""
    if chain.begins is None:
        ends = set(range(SLOTS))
    else:
        first = chain.legs[0].holds if chain.legs else chain.keeps
        ends = {chain.begins} if is_free(table, (*chain.takes, *first), 0, chain.begins) else set()
    for leg in chain.legs:
        most = SLOTS if leg.most is None else leg.most
        ends = {
            start + leg.length
            for end in ends
            for start in range(end + leg.least, min(end + most, SLOTS) + 1)
            if is_free(table, leg.holds, end, start + leg.length)
            and is_free(table, leg.takes, start, start + leg.length)
        }
    return {end for end in ends if end < SLOTS and is_free(table, chain.keeps, end, SLOTS)}


def occupy(table: SlotTable, resource: int, begin: int, end: int) -> None:
    table.mark(Chain(()), Fit((), 0, ((resource, begin, end),)))


def draw(rng: random.Random) -> tuple[SlotTable, Chain]:
    table = SlotTable(RESOURCES, SLOTS)
    for _ in range(rng.randrange(6)):
        begin = rng.randrange(SLOTS)
        occupy(table, rng.randrange(RESOURCES), begin, min(SLOTS, begin + rng.randrange(1, 6)))
    legs: list[Leg] = []
    held: tuple[int, ...] = ()
    for _ in range(rng.randrange(1, 5)):
        takes = tuple(r for r in rng.sample(range(RESOURCES), rng.randrange(3)) if r not in held)
        least = rng.choice([0, 0, 0, 1, 2])
        most = rng.choice([None, least, least + rng.randrange(6)])
        legs.append(Leg(takes, held, rng.randrange(1, 5), least, most))
        held = tuple(r for r in (*held, *takes) if rng.random() < 0.5)
    begins = rng.choice([None, 0, rng.randrange(6)])
    keeps = held if rng.random() < 0.2 else ()
    return table, Chain(tuple(legs), begins, (), keeps)


def assert_fits(table: SlotTable, chain: Chain, fit: Fit) -> None:
    """What is marked was free, and the starts are within their waits."""
    assert all(is_free(table, (resource,), begin, end) for resource, begin, end in fit.marks)
    end = chain.begins
    for leg, start in zip(chain.legs, fit.starts, strict=True):
        if end is not None:
            assert start - end >= leg.least
            assert leg.most is None or start - end <= leg.most
        end = start + leg.length
    assert end == fit.end


def test_the_end_is_the_earliest_one() -> None:
    rng = random.Random("chains")
    found = 0
    for _ in range(1_500):
        table, chain = draw(rng)
        fit, ends = table.fit(chain), find_ends(table, chain)
        assert (fit.end if fit is not None else None) == min(ends, default=None)
        if fit is not None:
            found += 1
            assert_fits(table, chain, fit)
    assert 300 < found < 1_500


def test_a_place_is_kept_while_labware_waits_there() -> None:
    table = SlotTable(3, SLOTS)
    occupy(table, 0, 4, 9)
    arm, nest, other = 0, 1, 2
    chain = Chain((Leg((arm, nest), (), 1), Leg((), (nest,), 3), Leg((arm, other), (nest,), 1)))
    fit = table.fit(chain)
    assert fit is not None
    assert fit.end == 10
    assert fit.starts == (3, 6, 9)
    assert {slot for r, begin, end in fit.marks for slot in range(begin, end) if r == nest} == {*range(3, 10)}


def test_what_is_never_free_has_no_fit() -> None:
    table = SlotTable(1, SLOTS)
    table.taken[0] = table.full
    assert table.fit(Chain((Leg((0,), (), 1),))) is None


def list_wanted(chain: Chain, fit: Fit) -> list[set[tuple[int, int]]]:
    """For each step that may end early, the resources and slots in which the next one may want them."""
    ends = [(chain.early, chain.begins or 0, 0)]
    ends += [(leg.early, fit.starts[i] + leg.length, i + 1) for i, leg in enumerate(chain.legs)]
    return [
        {(r, slot) for r in chain.legs[after].takes for slot in range(max(0, end - early), end)}
        for early, end, after in ends
        if early
    ]


def add_early(rng: random.Random, chain: Chain) -> Chain:
    """The same chain, but steps may end early, except for the last one."""
    legs = [replace(leg, early=rng.choice([0, 1, 3])) for leg in chain.legs]
    legs[-1] = replace(legs[-1], early=0)
    return replace(chain, legs=tuple(legs), early=rng.choice([0, 2]) if chain.begins else 0)


def test_conflicts_are_counted_from_both_sides() -> None:
    rng = random.Random("conflicts")
    found = 0
    for _ in range(1_000):
        table, chain = draw(rng)
        first = add_early(rng, chain)
        other = add_early(rng, draw(rng)[1])
        place = table.fit(first)
        if place is None:
            continue
        table.mark(first, place)
        fit = table.fit(other)
        if fit is None:
            continue
        taken = {(r, slot) for r in range(RESOURCES) for slot in range(SLOTS) if table.taken[r] >> slot & 1}
        wanted = set().union(*list_wanted(first, place))
        expected = sum(bool(each & taken) for each in list_wanted(other, fit))
        expected += sum(any((r, slot) in wanted for slot in range(b, e)) for r, b, e in fit.marks)
        assert table.count_conflicts(other, fit) == expected
        found += expected
    assert found > 100


def test_without_early_ends_there_are_no_conflicts() -> None:
    rng = random.Random("exact")
    for _ in range(200):
        table, chain = draw(rng)
        fit = table.fit(chain)
        if fit is not None:
            assert table.count_conflicts(chain, fit) == 0
            table.mark(chain, fit)
            assert not any(table.wanted)
