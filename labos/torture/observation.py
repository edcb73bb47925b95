"""Checks whether the driver's observation settles an unknown outcome, and whether the observation is true."""

from __future__ import annotations

from typing import Any

from labos.core.effects import Carrying, Sets
from labos.torture.session import Attempt, Failed, Session, key_of


async def observe_bench(on: Session, done: Attempt) -> None:
    """Record whether ``observe`` settles the outcome of an attempt. Raises Failed if the observation is
    false."""
    reply = await on.kernel.admin("observe")
    seen: dict[str, Any] = reply.result if reply.done and isinstance(reply.result, dict) else {}
    # A sensor that cannot tell says None.
    sights = {
        on.bench.place(str(place)): None if what is None else bool(what)
        for place, what in (seen.get("labware") or {}).items()
    }
    for place, there in sights.items():
        if there is not None and there != bool(on.bench.world.at(place)):
            raise Failed(
                f"observe reports that {place} holds {'something' if there else 'nothing'}, but it holds "
                f"{', '.join(on.bench.world.at(place)) or 'nothing'}"
            )
    settled = [
        answer
        for effect in on.bench.effects(done.case, on.spec(done.case))
        if (
            answer := _is_labware_settled(on, effect, sights)
            if isinstance(effect, Carrying)
            else _is_variable_settled(on, done, effect, seen)
        )
        is not None
    ]
    if settled:
        on.sights.append((done.case.action, all(settled)))


def _is_labware_settled(on: Session, effect: Carrying, sights: dict[str, bool | None]) -> bool:
    """Whether only one place is possible for the labware. The lab uses the same rule."""
    if effect.lid:
        return False  # no sensor tells a plate with a lid from one without
    places = {on.bench.place(str(place)) for place in (effect.source, effect.target, "gripper")}
    left = {place for place in places if sights.get(place) is not False}
    found = {place for place in places if sights.get(place)}
    return len(left) == 1 or len(found) == 1


def _is_variable_settled(on: Session, done: Attempt, effect: Any, seen: dict[str, Any]) -> bool | None:
    """Whether the observed variable of the module is correct; None if the effect is of another kind."""
    if not isinstance(effect, Sets) or effect.of != "module":
        return None
    if effect.variable not in seen:
        return False
    deeds = on.list_deeds(done)
    if not deeds or deeds != on.reference.get(key_of(done.case)):
        return True  # the bench does not say how far a door is that stopped on its way
    if seen[effect.variable] != effect.value:
        raise Failed(f"observe reports {effect.variable} = {seen[effect.variable]!r}; it is {effect.value!r}")
    return True
