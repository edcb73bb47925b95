"""Names from outside as labels: a limited number, then ``other``."""

from __future__ import annotations

from labos.telemetry.series import OTHER


class BoundedNames:
    """The first ``most`` names keep their labels as long as the process runs; all later ones share one."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: dict[str, bool] = {}

    def __call__(self, name: str) -> str:
        if name not in self._known:
            if len(self._known) >= self._most:
                return OTHER
            self._known[name] = True
        return name
