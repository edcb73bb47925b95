"""The record of a computation that is sent to an external service, so that it is sent there only once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from labos.errors import LabosError


class PlaceUnavailable(LabosError):
    """A place does not answer, or refuses access. Nothing about it is recorded in the log: the same
    computation may be requested again."""


class SendingRecord(Protocol):
    """The log's record of one computation, by names such as ``sending`` and ``sent``. ``mark`` identifies the
    computation and stays the same when the program is started again; ``of`` is its owner, such as the
    experiment."""

    @property
    def mark(self) -> str: ...

    @property
    def of(self) -> str: ...

    def find_own(self, name: str) -> Mapping[str, Any] | None: ...

    def keep(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        """Record facts, once; returns the facts that are recorded."""

    def find_shared(self, name: str) -> Mapping[str, Any] | None:
        """The facts that all computations of the experiment share."""

    def keep_shared(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]: ...

    def list_known(self, fact: str) -> set[str]:
        """The values that this fact has in any computation of the experiment."""


class MemoryRecord:
    """A record in memory, which is lost when the process ends."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[str, Any]] = {}
        self.mark, self.of = f"forgotten {id(self)}", ""

    def find_own(self, name: str) -> Mapping[str, Any] | None:
        return self._kept.get(name)

    def keep(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        return self._kept.setdefault(name, dict(facts))

    find_shared, keep_shared = find_own, keep

    def list_known(self, fact: str) -> set[str]:
        return {str(facts[fact]) for facts in self._kept.values() if fact in facts}


class ComputesOnce(ABC):
    """An executor that checks before it sends again."""

    @abstractmethod
    def compute_once(
        self, sent: SendingRecord, function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]
    ) -> Any:
        """Returns the result of the function. Raises the function's error, PlaceUnavailable."""
