"""The floor of a workcell, as deadlock avoidance sees it: where actors have labware, and what they hold."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from labos.core.ids import ModuleName, Owner, StationName
from labos.planning.paths import ClosingStep, Motion, MotionStep, Orders

OTHERS = "others"
"""The holder of labware that belongs to no actor."""


class Branch(msgspec.Struct, frozen=True):
    """One of the paths that an actor may have to take from a fork to its end. On a path that ``fails``, its
    run does not reach the end of its workflow."""

    motions: tuple[Motion, ...]
    fails: bool = False


class Actor(msgspec.Struct):
    """A run or the closing workflow of an experiment, with its labware and the ``motions`` that it has left.
    ``own`` counts its labware by station. It may also use labware of the owners in ``inputs``, if no actor
    has used it before. ``stuck``: it cannot reach its end whatever the other actors do (paused, needs a
    module that is down, has uncertain labware). ``parks``: its experiment is open; only the application knows
    when it closes. ``home``: the experiment whose closing workflow waits for its end. After its motions, the
    path may fork (``forks``). ``done`` counts the motions that are done, and the forks as one. ``kept``: what
    must stay free in case its actions in flight fail. The motions are in one order. If other orders are
    possible (``orders``), it may get one of them; ``over`` are the steps that it has begun."""

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
        """The number of its motions; the forks count as one."""
        return len(self.motions) + bool(self.forks)

    def find_next_step(self) -> MotionStep | None:
        """The step of its next motion; None after its last motion."""
        return self.motions[self.done].step if self.done < len(self.motions) else None

    def begin(self, step: MotionStep) -> None:
        """Remove the motions of a step that it has begun."""
        self.motions = tuple(motion for motion in self.motions if motion.step != step)
        if isinstance(step, int):
            self.over |= {step}


Loans = tuple[tuple[StationName, Owner], ...]

Change = tuple[dict[Any, Any], str, Any]
"""A table of a floor or of an actor, the key of the changed value, and the value before (or ``ABSENT``)."""

ABSENT: Final = object()
"""Stands in a change for the value of a key that was not in the table."""


class Floor(msgspec.Struct):
    """How full stations are (``count``, of ``capacity``), and how much labware stacks hold (``stock``).
    ``claims``: which deck labware at a station claims. ``claimed``: how much labware actors have on each
    deck. ``endless``: waste stations. ``pools``: labware that several runs may use, by owner and station.
    ``held``: what actors hold besides (key → actor → value, see ``held.py``). ``behind``: the module whose
    door or deck gives access to a station. ``arms``: the module whose gripper a station is. ``piles``: the
    actors or other owners of labware on stacks, from bottom to top; only the topmost piece can be taken.
    ``lent``: what actors have on loan until their ends (place, owner). ``values``: variables of modules
    without a rest position, by their keys. ``changes``: all changes since it was laid out or copied, in
    order. With them, motions are tried and undone."""

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
        """Set a value in a table of the floor or of an actor on it, and note the change."""
        self.changes.append((table, key, table.get(key, ABSENT)))
        table[key] = value

    def add(self, counts: dict[Any, int], key: str, change: int) -> None:
        """Add ``change`` to a count, and note the change."""
        before = counts.get(key)
        self.changes.append((counts, key, ABSENT if before is None else before))
        counts[key] = (before or 0) + change

    def drop(self, table: dict[Any, Any], key: str) -> None:
        """Remove a key from a table that has it, and note the change."""
        self.changes.append((table, key, table.pop(key)))

    def take_back(self, mark: int) -> None:
        """Undo all changes except the first ``mark``."""
        changes = self.changes
        for table, key, before in reversed(changes[mark:]):
            if before is ABSENT:
                del table[key]
            else:
                table[key] = before
        del changes[mark:]


def is_closing(motion: Motion) -> bool:
    """Whether a motion belongs to the closing workflow that follows a run."""
    return type(motion.step) is ClosingStep


UNSETTLED = object()
"""The value of a variable that differs between the branches after a fork."""


def change_claim(floor: Floor, station: StationName, who: str, change: int) -> None:
    """Add ``change`` to the labware of ``who`` on a station's deck. Without a deck or ``who``, do nothing."""
    claim = floor.claims.get(station)
    if claim and who:
        floor.add(floor.claimed.setdefault(claim, {}), who, change)
