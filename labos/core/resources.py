"""Consumables: the amount left in each module, in the resource's own unit, by lots."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.effects import AnyEffect, Consumes, Replaces
from labos.core.ids import ModuleName, RunId, level_key
from labos.core.model import MAIN, Plan, PlanStep
from labos.core.modules import ModuleEvent
from labos.core.registry import event


@event("resource.level_set")
class LevelSet(ModuleEvent, frozen=True):
    """A person counted a resource. This amount is left, all of it from one lot."""

    resource: str
    level: float
    capacity: float
    lot: str = ""


@event("resource.replenished")
class ResourceReplenished(ModuleEvent, frozen=True):
    """A person refilled a resource. ``expires`` is a date (``2027-05-31``), empty if none was given.
    ``awaited`` lists the runs that waited for it. ``instead``: the rest of the old packs was taken out
    first."""

    resource: str
    amount: float
    lot: str = ""
    expires: str = ""
    awaited: tuple[RunId, ...] = ()
    instead: bool = False


@event("resource.consumed")
class ResourceConsumed(ModuleEvent, frozen=True):
    """An action used up some of a resource. ``lot`` is the lot of the pack from which it came."""

    resource: str
    amount: float
    run: str
    action: str
    lot: str = ""

    def stream(self) -> str:
        return self.run or self.module


class Lot(msgspec.Struct):
    """The rest of one pack."""

    name: str
    left: float
    expires: str = ""


class Level(msgspec.Struct):
    """``lots`` are in order from the oldest to the newest; their sum is the ``level``."""

    level: float
    capacity: float
    lots: list[Lot] = []


class Resources(msgspec.Struct):
    """Levels by ``module:resource``. A resource without a declared level is not limited."""

    levels: dict[str, Level] = {}

    def find(self, module: ModuleName, resource: str) -> Level | None:
        """The level of a resource; None if it was never declared."""
        return self.levels.get(level_key(module, resource))

    def find_left(self, module: ModuleName, resource: str) -> float | None:
        """The amount left; None if it was never declared."""
        level = self.find(module, resource)
        return None if level is None else level.level


def sum_needed(effects: Iterable[AnyEffect], resource: str) -> float:
    """The amount of a resource that all effects together use up."""
    return sum(float(e.amount) for e in effects if isinstance(e, Consumes) and e.resource == resource)


def list_used_up(steps: Iterable[PlanStep]) -> tuple[tuple[int, ModuleName, str, float], ...]:
    """The consumption of a plan's steps: step, module, resource, amount. Amounts that an earlier step of the
    plan puts in are not included."""
    used: list[tuple[int, ModuleName, str, float]] = []
    fresh: set[tuple[str, str]] = set()
    for index, step in enumerate(steps):
        amounts: dict[str, float] = {}
        put_in: list[tuple[str, str]] = []
        for effect in step.effects:
            if type(effect) is Consumes:
                amounts[effect.resource] = amounts.get(effect.resource, 0.0) + float(effect.amount)
            elif type(effect) is Replaces:
                put_in.append((effect.module, effect.resource))
        for resource, amount in amounts.items():
            if (step.module, resource) not in fresh:
                used.append((index, step.module, resource, amount))
        fresh.update(put_in)
    return tuple(used)


def sum_consumption(plan: Plan) -> dict[str, float]:
    """The consumption of a plan without failures, by kind."""
    found: dict[str, float] = {}
    for index, _, resource, amount in list_used_up(plan.steps):
        if plan.steps[index].part == MAIN:
            found[resource] = found.get(resource, 0.0) + amount
    return found


def sum_by_supply(
    uses_up: Iterable[tuple[int, ModuleName, str, float]],
) -> dict[tuple[ModuleName, str], float]:
    """How much of each resource of a module a plan's steps use up together."""
    total: dict[tuple[ModuleName, str], float] = {}
    for _, module, resource, amount in uses_up:
        total[module, resource] = total.get((module, resource), 0.0) + amount
    return total


def list_charges(
    resources: Resources, module: ModuleName, resource: str, amount: float
) -> list[tuple[str, float]]:
    """The lots from which an amount is taken, the oldest first. An amount beyond all lots is charged to the
    newest."""
    level = resources.find(module, resource)
    lots = level.lots if level is not None else []
    parts: list[tuple[str, float]] = []
    for lot in lots:
        part = min(amount, lot.left)
        if part > 0:
            parts.append((lot.name, part))
            amount -= part
    if amount > 0 or not parts:
        last = parts.pop() if parts else (lots[-1].name if lots else "", 0.0)
        parts.append((last[0], last[1] + amount))
    return parts


def fold_level_set(resources: Resources, event: LevelSet, at: int) -> None:
    lots = [Lot(event.lot, event.level)] if event.level else []
    resources.levels[level_key(event.module, event.resource)] = Level(event.level, event.capacity, lots)


def fold_resource_replenished(resources: Resources, event: ResourceReplenished, at: int) -> None:
    level = resources.levels[level_key(event.module, event.resource)]
    if event.instead:
        level.level = 0.0
        level.lots.clear()
    level.level += event.amount
    level.lots.append(Lot(event.lot, event.amount, event.expires))


def fold_resource_consumed(resources: Resources, event: ResourceConsumed, at: int) -> None:
    level = resources.find(event.module, event.resource)
    if level is None:
        return
    level.level -= event.amount
    amount = event.amount
    while amount > 0 and level.lots:
        lot = next((lot for lot in level.lots if lot.name == event.lot), level.lots[0])
        part = min(amount, lot.left)
        lot.left -= part
        amount -= part
        if lot.left <= 0:
            level.lots.remove(lot)
