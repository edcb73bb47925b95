"""Consumables: how much of what is left in which module, in the resource's own unit."""

from __future__ import annotations

import msgspec

from labos.core.ids import ModuleName
from labos.core.modules import ModuleEvent
from labos.core.registry import event


@event("resource.level_set")
class LevelSet(ModuleEvent, frozen=True):
    """Somebody counted, or a new pack was put in (``lot``)."""

    resource: str
    level: float
    capacity: float
    lot: str = ""


@event("resource.consumed")
class ResourceConsumed(ModuleEvent, frozen=True):
    """An action used it up."""

    resource: str
    amount: float
    run: str
    action: str

    def stream(self) -> str:
        return self.run or self.module


class Level(msgspec.Struct):
    level: float
    capacity: float
    lot: str = ""


class Resources(msgspec.Struct):
    """Levels by ``module:resource``; what was never declared is not limited."""

    levels: dict[str, Level] = {}

    def left(self, module: ModuleName, resource: str) -> float | None:
        """What is left, or None if nobody ever said."""
        level = self.levels.get(f"{module}:{resource}")
        return None if level is None else level.level


def level_set(resources: Resources, event: LevelSet, at: int) -> None:
    resources.levels[f"{event.module}:{event.resource}"] = Level(event.level, event.capacity, event.lot)


def consumed(resources: Resources, event: ResourceConsumed, at: int) -> None:
    level = resources.levels.get(f"{event.module}:{event.resource}")
    if level is not None:
        level.level -= event.amount


HANDLERS = {LevelSet: level_set, ResourceConsumed: consumed}
