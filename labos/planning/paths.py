"""A plan seen as motions only: what safety reasons about.

Steps that carry nothing always end and give back what they used, so only the steps that change
where labware stands can trap anybody.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType

import msgspec

from labos.core.effects import Move, Take
from labos.core.ids import ModuleName, StationName
from labos.core.model import Plan


class Motion(msgspec.Struct, frozen=True):
    """One change of the bench: labware from ``source`` (a stack, if ``new``) to ``target``; or,
    with ``uses``, a step on a module on which the run has no labware: it changes nothing, but
    nobody else's labware may hold the module then."""

    step: int
    source: StationName
    target: StationName
    via: StationName = StationName("")
    new: bool = False
    uses: str = ""


class Path(msgspec.Struct, frozen=True):
    """A plan's motions in an order that its ``after`` relations allow, and the modules that it
    needs from each step on (to know whether a dead one still matters)."""

    motions: tuple[Motion, ...]
    modules: tuple[tuple[int, ModuleName], ...]


def path_of(plan: Plan, claims: Mapping[StationName, str] = MappingProxyType({})) -> Path:
    """The motions of a plan; steps in an order in which they may run one after the other.
    ``claims`` says which stations hold which claim."""
    motions: list[Motion] = []
    held: Counter[str] = Counter()
    claimable = set(claims.values())
    for index in _order(plan):
        step = plan.steps[index]
        if step.exclusive and step.module in claimable and not held[step.module]:
            nowhere = StationName("")
            motions.append(Motion(index, nowhere, nowhere, uses=step.module))
        for effect in step.effects:
            if isinstance(effect, Move):
                motions.append(Motion(index, effect.source, effect.target, effect.via))
                held[claims.get(effect.source, "")] -= 1
                held[claims.get(effect.target, "")] += 1
            elif isinstance(effect, Take):
                motions.append(Motion(index, effect.stack, effect.target, new=True))
                held[claims.get(effect.target, "")] += 1
    return Path(tuple(motions), tuple((i, step.module) for i, step in enumerate(plan.steps)))


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
