"""What the calls of a client are made with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from labos.clock import Uuid7Ids


class Calls(ABC):
    """Base of the groups of calls that make up ``LabClient``."""

    _ids: Uuid7Ids
    approval: str

    @abstractmethod
    def _get(self, path: str, **params: Any) -> dict[str, Any]:
        """Ask. Raises LabosError as the lab did, LabUnreachable."""

    @abstractmethod
    def _post(
        self,
        path: str,
        body: Any,
        *,
        request: str = "",
        user: str = "",
        repeat: bool = False,
        timeout_s: float | None = None,
    ) -> dict[str, Any]:
        """Send ``body`` as JSON. With a ``request`` key it is done once, however often it is sent; ``repeat``
        is for what may be done twice. Raises as ``_get``."""
