"""A timetable of runs whose steps follow one another, with windows: for looking ahead often.

Time is cut into slots, and of each module, zone and place one number says in which slots it is taken: bit by
bit. So it takes some operations on whole numbers to find the earliest end of a run between all others, with
every wait that its windows allow. Where labware waits, it keeps its place.

Steps take their usual times, rounded up to slots. Places with room for more than one are left out, doors and
setpoints too. Nothing that must hold rests on this timetable.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec


class Leg(msgspec.Struct, frozen=True, gc=False):
    """A step of a chain: what it takes while it lasts, what the run holds before and meanwhile (numbers of
    resources), how long it takes, and how long the run waits before it, at least and at most (slots; None: no
    limit)."""

    takes: tuple[int, ...]
    holds: tuple[int, ...]
    length: int
    least: int = 0
    most: int | None = None


class Chain(msgspec.Struct, frozen=True, gc=False):
    """The steps of a run that are left. ``begins``: the slot in which what is under way ends, of a run that
    has started (else None); ``takes``: what that takes until then. ``keeps``: what is held after the end."""

    legs: tuple[Leg, ...]
    begins: int | None = None
    takes: tuple[int, ...] = ()
    keeps: tuple[int, ...] = ()


class Fit(msgspec.Struct, frozen=True, gc=False):
    """Where a chain fits in: the slot in which each leg starts, its end, and what is taken from when to when:
    (resource, from, to)."""

    starts: tuple[int, ...]
    end: int
    marks: tuple[tuple[int, int, int], ...]


class SlotTable:
    """In which of ``slots`` each resource is taken."""

    def __init__(self, resources: int, slots: int) -> None:
        self.slots = slots
        self.full = (1 << slots) - 1
        self.taken = [0] * resources

    def copy(self) -> SlotTable:
        other = SlotTable.__new__(SlotTable)
        other.slots, other.full, other.taken = self.slots, self.full, list(self.taken)
        return other

    def mark(self, marks: Iterable[tuple[int, int, int]]) -> None:
        for resource, begin, end in marks:
            self.taken[resource] |= (1 << end) - (1 << begin)

    def fit(self, chain: Chain) -> Fit | None:
        """The earliest end of a chain, with waits as short as that allows; None if it does not fit in."""
        taken, full = self.taken, self.full
        if chain.begins is None:
            ends = full
        else:
            if self._is_taken((*chain.takes, *(chain.legs[0].holds if chain.legs else chain.keeps)), chain):
                return None
            ends = 1 << chain.begins
        layers: list[tuple[int, int]] = []
        for leg in chain.legs:
            held = 0
            for resource in leg.holds:
                held |= taken[resource]
            used = held
            for resource in leg.takes:
                used |= taken[resource]
            starts = _wait(ends, ~held & full, leg.least, leg.most) & _runs(~used & full, leg.length)
            layers.append((ends, starts))
            ends = (starts << leg.length) & full
            if not ends:
                return None
        if chain.keeps:
            kept = 0
            for resource in chain.keeps:
                kept |= taken[resource]
            ends &= ~((1 << kept.bit_length()) - 1)
            if not ends:
                return None
        return self._go_back(chain, layers, (ends & -ends).bit_length() - 1)

    def _is_taken(self, resources: Sequence[int], chain: Chain) -> bool:
        span = (1 << (chain.begins or 0)) - 1
        return any(self.taken[resource] & span for resource in resources)

    def _go_back(self, chain: Chain, layers: list[tuple[int, int]], end: int) -> Fit:
        marks: list[tuple[int, int, int]] = []
        starts: list[int] = []
        at = end
        for leg, (ends, _) in zip(reversed(chain.legs), reversed(layers), strict=True):
            start = at - leg.length
            before = ends & ((1 << (start - leg.least + 1)) - 1)
            before = before.bit_length() - 1
            starts.append(start)
            marks += [(resource, start, at) for resource in leg.takes]
            marks += [(resource, before, at) for resource in leg.holds]
            at = before
        if chain.begins:
            first = chain.legs[0].holds if chain.legs else chain.keeps
            marks += [(resource, 0, chain.begins) for resource in (*chain.takes, *first)]
        marks += [(resource, end, self.slots) for resource in chain.keeps if end < self.slots]
        return Fit(tuple(reversed(starts)), end, tuple(marks))


def _runs(free: int, length: int) -> int:
    """The slots from which on so many are free."""
    have = 1
    while have < length:
        more = min(have, length - have)
        free &= free >> more
        have += more
    return free


def _wait(ends: int, free: int, least: int, most: int | None) -> int:
    """The slots up to which one can wait from one of these, as long as it is free."""
    if least:
        ends = (ends & _runs(free, least)) << least
    if most is None:
        # A carry runs through all free slots that follow.
        return ((free + (ends & free)) ^ free) | ends
    covered, left = 0, most - least
    while covered < left:
        more = min(covered + 1, left - covered)
        ends |= (ends & _runs(free, more)) << more
        covered += more
    return ends
