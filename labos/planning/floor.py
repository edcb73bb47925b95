"""The floor of a workcell as safety sees it: who has how much labware where, and who holds what."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from labos.core.ids import ModuleName, Owner, StationName
from labos.planning.paths import ClosingStep, Motion, MotionStep, Orders

OTHERS = "others"
"""Holder of what belongs to no actor."""


class Branch(msgspec.Struct, frozen=True):
    """One way that an actor may have to go from a fork to its end; on one that ``fails`` its run does not
    come to the end of its workflow."""

    motions: tuple[Motion, ...]
    fails: bool = False


class Actor(msgspec.Struct):
    """Somebody with labware and a way to go. ``own`` counts its labware by station; of what the
    owners of its ``inputs`` have it may use what nobody has used before. ``stuck``: it cannot
    reach its end whatever the others do (paused, needs a dead module, has uncertain labware).
    ``parks``: its experiment is open; only its application knows when it closes. ``home``: the experiment
    whose closing workflow waits for its end. Behind its ``motions``
    the way may fork (``forks``); ``done`` counts the motions, and the forks as one. ``kept``: what must stay
    free for what it has in flight, as that may fail. Its motions stand in one order; if there are others
    (``orders``), it may be given one of them. ``over`` are then the steps that it has begun."""

    name: str
    owners: tuple[Owner, ...]
    motions: tuple[Motion, ...]
    own: dict[StationName, int]
    inputs: tuple[Owner, ...] = ()
    stuck: bool = False
    done: int = 0
    parks: bool = False
    forks: tuple[Branch, ...] = ()
    kept: tuple[Motion, ...] = ()
    orders: Orders | None = None
    over: frozenset[int] = frozenset()
    home: Owner = Owner("")

    @property
    def length(self) -> int:
        """What it has to do before it is at its end."""
        return len(self.motions) + bool(self.forks)

    def find_next_step(self) -> MotionStep | None:
        """The step of its next motion; None behind its motions."""
        return self.motions[self.done].step if self.done < len(self.motions) else None

    def begin(self, step: MotionStep) -> None:
        """It has begun a step: what is left is the rest."""
        self.motions = tuple(motion for motion in self.motions if motion.step != step)
        if isinstance(step, int):
            self.over |= {step}


Loans = tuple[tuple[StationName, Owner], ...]

Change = tuple[dict[Any, Any], str, Any]
"""A table of a floor or of an actor, the key whose value was changed, and the value before."""

ABSENT: Final = object()
"""In place of a value: there was none."""


class Floor(msgspec.Struct):
    """How full the stations are, how much the stacks hold, who claims which deck, what users and
    everybody have where (``pools``), who holds what beside (``held``: key → actor → value, see
    ``held.py``), whose doors and decks stations are behind (``behind``), whose hands they are (``arms``),
    what lies on stacks (``piles``, bottom to top: actors, or owners who are none): of them only the
    topmost can be had; what is lent to actors until their ends (``lent``: where it stands, whose it
    is); and how the variables of modules stand that have no rest (``values``, by their keys).
    ``changes`` were made one after the other since it was laid out or copied: motions are tried out and
    taken back."""

    count: dict[StationName, int] = {}
    capacity: dict[StationName, int] = {}
    stock: dict[StationName, int] = {}
    claims: dict[StationName, str] = {}
    claimed: dict[str, dict[str, int]] = {}
    endless: set[StationName] = set()
    pools: dict[Owner, dict[StationName, int]] = {}
    held: dict[str, dict[str, Any]] = {}
    behind: dict[StationName, ModuleName] = {}
    arms: dict[StationName, ModuleName] = {}
    piles: dict[StationName, tuple[str, ...]] = {}
    lent: dict[str, Loans] = {}
    values: dict[str, Any] = {}
    changes: list[Change] = []

    def put(self, table: dict[Any, Any], key: str, value: Any) -> None:
        """Let a table of the floor, or of an actor on it, have a value."""
        self.changes.append((table, key, table.get(key, ABSENT)))
        table[key] = value

    def add(self, counts: dict[Any, int], key: str, change: int) -> None:
        """Let a count be so much greater."""
        self.put(counts, key, counts.get(key, 0) + change)

    def drop(self, table: dict[Any, Any], key: str) -> None:
        """Let a table have no value any more for a key that it has."""
        self.changes.append((table, key, table.pop(key)))

    def take_back(self, mark: int) -> None:
        """Undo all changes but the first ``mark``."""
        while len(self.changes) > mark:
            table, key, before = self.changes.pop()
            if before is ABSENT:
                del table[key]
            else:
                table[key] = before


def is_closing(motion: Motion) -> bool:
    """Whether a motion belongs to the closing workflow behind a run."""
    return isinstance(motion.step, ClosingStep)


UNSETTLED = object()
"""The value of a variable that may be one or the other."""


def change_claim(floor: Floor, station: StationName, who: str, change: int) -> None:
    """So much more labware of somebody stands where it claims a deck."""
    claim = floor.claims.get(station)
    if claim and who:
        floor.add(floor.claimed.setdefault(claim, {}), who, change)
