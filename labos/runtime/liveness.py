"""Which nodes show themselves on the bus: what was seen and heard of them, within limits."""

from __future__ import annotations

from labos.core.ids import ModuleName

MOST_STRANGERS = 256
"""Modules that no workcell has and whose nodes are remembered: an emergency stop reaches them too."""

MOST_INSTANCES = 16
"""Nodes of one module that are remembered: of honest ones there are two at the most, for a moment."""


class Liveness:
    """The instances of each module, and when (monotonic s) each was heard last."""

    def __init__(self) -> None:
        self._instances: dict[ModuleName, list[str]] = {}
        self._heard: dict[tuple[ModuleName, str], float] = {}

    def hear(self, module: ModuleName, instance: str, now: float, keep: str, others: int | None) -> bool:
        """It lives. Of too many instances the one is forgotten that was silent longest, but never ``keep``.
        For a module that no workcell has, ``others`` is how many there are in workcells: false if there are
        too many besides, and it is not remembered."""
        instances = self._instances.get(module)
        if instances is None:
            if others is not None and len(self._instances) >= others + MOST_STRANGERS:
                return False
            instances = self._instances[module] = []
        if instance not in instances:
            if len(instances) >= MOST_INSTANCES:
                spare = [other for other in instances if other != keep]
                self.forget(module, min(spare, key=lambda other: self._heard[module, other]))
            instances.append(instance)
        self._heard[module, instance] = now
        return True

    def expect(self, module: ModuleName, instance: str, now: float) -> None:
        """It should live: from now on it is missed if nothing is heard."""
        self._heard.setdefault((module, instance), now)

    def forget(self, module: ModuleName, instance: str) -> None:
        instances = self._instances.get(module, [])
        if instance in instances:
            instances.remove(instance)
        if not instances:
            self._instances.pop(module, None)
        self._heard.pop((module, instance), None)

    def list_instances(self, module: ModuleName) -> list[str]:
        return self._instances.get(module, [])

    def list_silent(self, now: float, silence_s: float) -> list[tuple[ModuleName, str, float]]:
        """Who has not been heard for so long, and for how long."""
        heard = list(self._heard.items())
        return [(*who, now - at) for who, at in heard if now - at > silence_s]

    @property
    def modules(self) -> list[ModuleName]:
        return list(self._instances)
