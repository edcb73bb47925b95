"""A timetable of runs with windows whose steps follow one another, for frequent look-aheads.

Time is divided into slots. For each module, zone and place, one integer says in which slots it is taken, with
one bit for each slot. So a few operations on integers find the earliest end of a run between all others, with
all waits that its windows allow. While labware waits, it keeps its place.

Steps take their usual times, rounded up to slots. Places with room for more than one piece are left out, and
so are doors and setpoints. No rule of safety depends on this timetable.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec


class Leg(msgspec.Struct, frozen=True, gc=False):
    """A step of a chain. ``takes`` are the numbers of the resources that it takes while it lasts; ``holds``
    are those that the run holds during the step and during the wait before it. ``length`` is its duration;
    ``least`` and ``most`` limit the wait before it (slots; None: no limit). ``early``: by how many
    slots the step may end too early. Then its window does not let the next leg wait for its planned start."""

    takes: tuple[int, ...]
    holds: tuple[int, ...]
    length: int
    least: int = 0
    most: int | None = None
    early: int = 0


class Chain(msgspec.Struct, frozen=True, gc=False):
    """The remaining steps of a run. ``begins`` is the slot in which the step under way ends, if the run has
    started (else None). ``takes`` are the resources that this step takes until then, and ``early`` is as for
    a leg. ``keeps`` are the resources that the run holds after its end."""

    legs: tuple[Leg, ...]
    begins: int | None = None
    takes: tuple[int, ...] = ()
    keeps: tuple[int, ...] = ()
    early: int = 0


class Fit(msgspec.Struct, frozen=True, gc=False):
    """The place of a chain in the timetable: the slot in which each leg starts, the slot of its end, and
    which slots it takes: (resource, from, to)."""

    starts: tuple[int, ...]
    end: int
    marks: tuple[tuple[int, int, int], ...]


class SlotTable:
    """In which of the ``slots`` each resource is ``taken``, and in which it may be ``wanted`` because a step
    ends early."""

    def __init__(self, resources: int, slots: int) -> None:
        self.slots = slots
        self.full = (1 << slots) - 1
        self.taken = [0] * resources
        self.wanted = [0] * resources

    def copy(self) -> SlotTable:
        other = SlotTable.__new__(SlotTable)
        other.slots, other.full = self.slots, self.full
        other.taken, other.wanted = list(self.taken), list(self.wanted)
        return other

    def mark(self, chain: Chain, fit: Fit) -> None:
        """Take the slots of a chain."""
        for resource, begin, end in fit.marks:
            self.taken[resource] |= (1 << end) - (1 << begin)
        for resources, span in _list_early(chain, fit):
            for resource in resources:
                self.wanted[resource] |= span

    def count_conflicts(self, chain: Chain, fit: Fit) -> int:
        """How often one of the chains may find a resource taken if a step ends early, once this chain has
        its place."""
        taken, wanted = self.taken, self.wanted
        found = sum(
            any(taken[resource] & span for resource in resources)
            for resources, span in _list_early(chain, fit)
        )
        for resource, begin, end in fit.marks:
            if wanted[resource] and wanted[resource] & ((1 << end) - (1 << begin)):
                found += 1
        return found

    def fit(self, chain: Chain) -> Fit | None:
        """The place of a chain with its earliest end, and with waits as short as this end allows; None if the
        chain does not fit."""
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
            starts = _wait(ends, ~held & full, leg.least, leg.most) & _find_stretches(
                ~used & full, leg.length
            )
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


def _list_early(chain: Chain, fit: Fit) -> Iterator[tuple[tuple[int, ...], int]]:
    """The resources that a leg takes, with the slots in which it may want them before its planned start."""
    legs = chain.legs
    if chain.early and chain.begins:
        end = chain.begins
        yield legs[0].takes, (1 << end) - (1 << max(0, end - chain.early))
    for number, leg in enumerate(legs):
        if leg.early:
            end = fit.starts[number] + leg.length
            yield legs[number + 1].takes, (1 << end) - (1 << max(0, end - leg.early))


def _find_stretches(free: int, length: int) -> int:
    """The slots from which ``length`` slots in a row are free."""
    have = 1
    while have < length:
        more = min(have, length - have)
        free &= free >> more
        have += more
    return free


def _wait(ends: int, free: int, least: int, most: int | None) -> int:
    """The slots until which a run can wait from one of ``ends``, while the slots are ``free``: at least
    ``least`` and at most ``most`` slots (None: no limit)."""
    if least:
        ends = (ends & _find_stretches(free, least)) << least
    if most is None:
        # The carry of the addition runs through all free slots that follow.
        return ((free + (ends & free)) ^ free) | ends
    covered, left = 0, most - least
    while covered < left:
        more = min(covered + 1, left - covered)
        ends |= (ends & _find_stretches(free, more)) << more
        covered += more
    return ends
