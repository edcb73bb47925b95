"""Which nodes are visible on the bus: their tokens and heartbeats, in limited numbers."""

from __future__ import annotations

from labos.core.ids import ModuleName

MOST_STRANGERS = 256
"""Nodes of so many modules outside all workcells are remembered: an emergency stop reaches them too."""

MOST_INSTANCES = 16
"""The largest number of remembered nodes of one module: without attacks there are at most two, for a
moment."""


class Liveness:
    """The instances of each module, and when (monotonic s) each sent its last message."""

    def __init__(self) -> None:
        self._instances: dict[ModuleName, list[str]] = {}
        self._heard: dict[tuple[ModuleName, str], float] = {}

    def remember(self, module: ModuleName, instance: str, now: float, keep: str, others: int | None) -> bool:
        """Note that an instance is alive. If there are too many, the one that was silent longest is
        forgotten, but never ``keep``. For a module outside all workcells, ``others`` is the number of modules
        in workcells: false if there are too many modules besides these, and it is not remembered."""
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
        """Note that an instance should be alive: it counts as missing if no message comes from now on."""
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
        """The instances without a message for so long, and the time since the last one."""
        heard = list(self._heard.items())
        return [(*who, now - at) for who, at in heard if now - at > silence_s]

    @property
    def modules(self) -> list[ModuleName]:
        return list(self._instances)
