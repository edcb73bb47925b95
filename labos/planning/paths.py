"""A plan seen as motions only: what safety reasons about.

Steps that carry nothing end and give back what they used, so only those can trap anybody that
change where labware stands, or that leave a door or lid in others' way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

import msgspec

from labos.core.branches import Way, ways
from labos.core.effects import (
    NOWHERE,
    Carrying,
    Claims,
    Lid,
    Releases,
    Sets,
    arrivals,
    carried,
    hand_of,
)
from labos.core.ids import ModuleName, StationName
from labos.core.model import Plan, PlanStep

END = -1
"""The step number of a run's end, at which it lets go of all that it holds."""

Values = Mapping[str, Any]


class Motion(msgspec.Struct, frozen=True):
    """One change of the bench: labware from ``source`` (a stack, if ``new``) to ``target``. Or one
    that moves nothing: what the run holds from then on (``grabs``: key and value, None if it can
    be shared with nobody), and what it does not hold any more (``frees``). ``uses`` is the module
    that nobody else may hold then. ``back``: it is known how something in
    flight ended. It failed, and its labware is at ``target`` (as before on a stack, if ``new``) instead of
    at ``source``; or without a ``target``, ``source`` need not be kept free for it any more.

    What it needs and does beside is as its effect says (see ``effects.Carrying``). All needs of a step are
    asked before any of it is done, so they stand with its first motion: where it needs labware or room
    twice, twice. ``hand`` has to be empty."""

    step: int
    source: StationName = NOWHERE
    target: StationName = NOWHERE
    via: StationName = NOWHERE
    new: bool = False
    uses: ModuleName = ModuleName("")
    grabs: tuple[tuple[str, Any], ...] = ()
    frees: tuple[str, ...] = ()
    lid: Lid = ""
    back: bool = False
    stock: StationName = NOWHERE
    emptied: StationName = NOWHERE
    filled: StationName = NOWHERE
    plate_at: StationName = NOWHERE
    stands: tuple[StationName, ...] = ()
    entered: tuple[StationName, ...] = ()
    room: tuple[StationName, ...] = ()
    hand: StationName = NOWHERE

    @property
    def changes_anything(self) -> bool:
        """Whether labware stands elsewhere after it, or somebody holds something else."""
        return bool(self.target or self.grabs or self.frees)


def carrying(
    step: int,
    *effects: Carrying,
    uses: ModuleName,
    hand: StationName,
    guarded: Collection[StationName],
) -> list[Motion]:
    """The motions of a step that carries something, by a module with this ``hand``. Only at ``guarded``
    places, hands among them, anybody could be kept from reaching in."""
    motions: list[Motion] = []
    for what in effects:
        motion = Motion(
            step,
            what.source,
            what.target,
            what.via,
            new=bool(what.stock),
            uses=uses,
            lid=what.lid,
            stock=what.stock,
            emptied=what.emptied,
            filled=what.filled,
            plate_at=what.plate_at,
        )
        if not motions:
            motion = msgspec.structs.replace(
                motion,
                stands=_stands(effects),
                entered=tuple(dict.fromkeys(p for each in effects for p in each.entered if p in guarded)),
                room=tuple(arrivals(effects)),
                hand=hand if hand in guarded and any(e.source != hand for e in effects) else NOWHERE,
            )
        motions.append(motion)
    return motions


def _stands(effects: Sequence[Carrying]) -> tuple[StationName, ...]:
    """Where labware has to stand before a step, once for each piece. What one effect carries away the next
    ones find there no more; a plate whose lid is carried stays."""
    needed: Counter[StationName] = Counter()
    away: Counter[StationName] = Counter()
    for what in effects:
        for place in what.stands:
            needed[place] = max(needed[place], away[place] + 1)
        if what.stands:
            away[what.emptied] += 1
    return tuple(needed.elements())


class Path(msgspec.Struct, frozen=True):
    """A plan's motions in an order that its ``after`` relations allow, if nothing of it fails; the modules
    that it needs from each step on (to know whether a dead one still matters); the steps of the motions that
    change anything; and, if it may go more ways than one, the motions on each of them."""

    motions: tuple[Motion, ...]
    modules: tuple[tuple[int, ModuleName], ...]
    changing: frozenset[int] = frozenset()
    ways: tuple[tuple[Way, tuple[Motion, ...]], ...] = ()


def path_of(
    plan: Plan,
    claims: Mapping[StationName, str] = MappingProxyType({}),
    rests: Mapping[ModuleName, Values] = MappingProxyType({}),
) -> Path:
    """The motions of a plan; steps in an order in which they may run one after the other. ``claims`` says
    which stations hold which claim (empty: none, but they are hands or behind a door), ``rests`` how the
    modules' doors and lids stand at rest."""
    found = [(way, motions_of_steps(plan, way.steps, claims, rests)) for way in ways(plan)]
    modules = tuple((i, step.module) for i, step in enumerate(plan.steps))
    changing = frozenset(motion.step for motion in found[0][1] if motion.changes_anything)
    return Path(found[0][1], modules, changing, tuple(found) if len(found) > 1 else ())


class Stand(msgspec.Struct):
    """How a run stands on the bench before its next motion: how much of its labware holds each claim,
    how the doors and lids are that it has left, and what it holds by them or by setpoints."""

    claims: Counter[str] = msgspec.field(default_factory=Counter)
    doors: dict[ModuleName, dict[str, Any]] = {}
    held: dict[str, bool] = {}


def motions_of_steps(
    plan: Plan,
    order: Sequence[int],
    claims: Mapping[StationName, str],
    rests: Mapping[ModuleName, Values],
    before: Stand | None = None,
) -> tuple[Motion, ...]:
    """What steps do to the bench, carried out in this order. Changes how the run stands."""
    motions: list[Motion] = []
    before = Stand() if before is None else before
    standing, values, held = before.claims, before.doors, before.held
    ever = dict(held)
    for index in order:
        step = plan.steps[index]
        rest = rests.get(step.module, {})
        doors = values.setdefault(step.module, {})
        doors.update(_doors(step, rest))
        grabs, frees = _holds(plan, index, away=_away(doors, rest), held=held)
        held.update(dict.fromkeys((key for key, _ in grabs), True))
        ever.update(held)
        moving = carried(step.effects)
        mine = standing[step.module] or (door_key(step.module) in held and not grabs)
        # Nobody who holds a module in error can go on before it is well: a recovery asks nobody.
        user = ModuleName("") if step.recovers else step.module
        needs = step.exclusive and not moving
        if grabs or (needs and user and not mine):
            motions.append(Motion(index, uses=user if needs else ModuleName(""), grabs=grabs))
        motions += carrying(index, *moving, uses=user, hand=hand_of(step.module), guarded=claims)
        for what in moving:
            standing[claims.get(what.emptied, "")] -= 1
            standing[claims.get(what.filled, "")] += 1
        if frees:
            motions.append(Motion(index, frees=frees))
            for key in frees:
                held.pop(key, None)
    if ever:  # also of what it has let go of before: steps beside each other may end in another order
        motions.append(Motion(END, frees=tuple(ever)))
    return tuple(motions)


@cache
def door_key(module: ModuleName) -> str:
    """What a run holds that left a door or lid of a module away from rest."""
    return f"door:{module}"


@cache
def hold_key(module: ModuleName) -> str:
    """What a run holds that keeps a module by its plan's word."""
    return f"hold:{module}"


@cache
def guards(module: ModuleName) -> tuple[str, str]:
    """What a run holds that keeps others from reaching into a module: by its door, or by its plan's word."""
    return door_key(module), hold_key(module)


def kept_by(key: str) -> ModuleName:
    """The module that a run keeps by its plan's word if it holds this; empty if it is something else."""
    return ModuleName(key.removeprefix("hold:") if key.startswith("hold:") else "")


def setpoint_key(module: ModuleName, setpoint: str) -> str:
    return f"setpoint:{module}.{setpoint}"


def _holds(
    plan: Plan, index: int, *, away: bool, held: Mapping[str, bool]
) -> tuple[tuple[tuple[str, Any], ...], tuple[str, ...]]:
    """What a run comes to hold with a step, and what it lets go of with it."""
    step = plan.steps[index]
    door = door_key(step.module)
    grabs: list[tuple[str, Any]] = []
    frees: list[str] = []
    if step.exclusive and away and door not in held:
        grabs.append((door, None))
    elif step.exclusive and not away and door in held:
        frees.append(door)
    for effect in step.effects:
        if isinstance(effect, Claims):
            grabs.append((setpoint_key(step.module, effect.setpoint), effect.value))
        elif isinstance(effect, Releases):
            frees.append(setpoint_key(step.module, effect.setpoint))
    for hold in plan.holds:
        if hold.first == index:
            grabs.append((hold_key(hold.module), None))
        if hold.last == index:
            frees.append(hold_key(hold.module))
    return tuple(grabs), tuple(frees)


def _doors(step: PlanStep, rest: Values) -> dict[str, Any]:
    """How a step leaves the doors and lids of its module."""
    return {
        effect.variable: effect.value
        for effect in step.effects
        if isinstance(effect, Sets) and effect.of == "module" and effect.variable in rest
    }


def _away(values: Values, rest: Values) -> bool:
    return any(rest[name] != value for name, value in values.items())
