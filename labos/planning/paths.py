"""A plan seen as motions only: what safety reasons about.

Steps that carry nothing end and give back what they used, so only those can trap anybody that
change where labware stands, or that leave a door or lid in others' way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import msgspec

from labos.core.effects import Move, Sets, Take
from labos.core.ids import ModuleName, StationName
from labos.core.model import Plan, PlanStep


class Motion(msgspec.Struct, frozen=True):
    """One change of the bench: labware from ``source`` (a stack, if ``new``) to ``target``; or,
    with ``uses``, a step on a module that somebody else may hold: it moves nothing, but nobody
    else's labware, door or lid may hold the module then. ``holds``: from then on the run holds
    it by its door or lid, or does no longer."""

    step: int
    source: StationName
    target: StationName
    via: StationName = StationName("")
    new: bool = False
    uses: str = ""
    holds: bool | None = None


class Path(msgspec.Struct, frozen=True):
    """A plan's motions in an order that its ``after`` relations allow, and the modules that it
    needs from each step on (to know whether a dead one still matters)."""

    motions: tuple[Motion, ...]
    modules: tuple[tuple[int, ModuleName], ...]


NOWHERE = StationName("")

Values = Mapping[str, Any]


def path_of(
    plan: Plan,
    claims: Mapping[StationName, str] = MappingProxyType({}),
    rests: Mapping[ModuleName, Values] = MappingProxyType({}),
) -> Path:
    """The motions of a plan; steps in an order in which they may run one after the other.
    ``claims`` says which stations hold which claim, ``rests`` how the modules' doors and lids
    stand at rest."""
    motions: list[Motion] = []
    held: Counter[str] = Counter()
    values: dict[ModuleName, dict[str, Any]] = {}
    claimable = set(claims.values()).union(rests)
    order = _order(plan)
    for index in order:
        step = plan.steps[index]
        rest = rests.get(step.module, {})
        before = values.get(step.module, {})
        after = values[step.module] = {**before, **_doors(step, rest)}
        held_by_door, holds = _away(before, rest), _away(after, rest)
        if step.exclusive and holds != held_by_door:
            motions.append(Motion(index, NOWHERE, NOWHERE, uses=step.module, holds=holds))
        elif step.exclusive and step.module in claimable and not held[step.module] and not holds:
            motions.append(Motion(index, NOWHERE, NOWHERE, uses=step.module))
        for effect in step.effects:
            if isinstance(effect, Move):
                motions.append(Motion(index, effect.source, effect.target, effect.via))
                held[claims.get(effect.source, "")] -= 1
                held[claims.get(effect.target, "")] += 1
            elif isinstance(effect, Take):
                motions.append(Motion(index, effect.stack, effect.target, new=True))
                held[claims.get(effect.target, "")] += 1
    for module, last in values.items():
        if _away(last, rests.get(module, {})):  # its end lets go of it
            motions.append(Motion(order[-1], NOWHERE, NOWHERE, uses=module, holds=False))
    return Path(tuple(motions), tuple((i, step.module) for i, step in enumerate(plan.steps)))


def _doors(step: PlanStep, rest: Values) -> dict[str, Any]:
    """How a step leaves the doors and lids of its module."""
    return {
        effect.variable: effect.value
        for effect in step.effects
        if isinstance(effect, Sets) and effect.of == "module" and effect.variable in rest
    }


def _away(values: Values, rest: Values) -> bool:
    return any(rest[name] != value for name, value in values.items())


def _order(plan: Plan) -> list[int]:
    done: set[int] = set()
    order: list[int] = []
    left = list(range(len(plan.steps)))
    while left:
        for index in left:
            if all(before in done for before in plan.steps[index].after):
                break
        else:
            raise ValueError(f"the steps of {plan.workflow!r} wait for each other")
        left.remove(index)
        done.add(index)
        order.append(index)
    return order
