"""What is remembered of a computation that a service elsewhere carries out, so that it is sent there once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from labos.errors import LabosError


class PlaceUnavailable(LabosError):
    """A place does not answer, or lets nobody in. Nothing is said of it in the log: the same may be asked
    again."""


class SendingRecord(Protocol):
    """What the log has of one computation, by names such as ``sending`` and ``sent``. ``mark`` is its own,
    and the same when the program is started again; ``of`` is whose it is, such as the experiment."""

    @property
    def mark(self) -> str: ...

    @property
    def of(self) -> str: ...

    def find_own(self, name: str) -> Mapping[str, Any] | None: ...

    def keep(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        """Write it down, once; returns what is written down."""

    def find_shared(self, name: str) -> Mapping[str, Any] | None:
        """The same for all computations of the experiment."""

    def keep_shared(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]: ...

    def all_known(self, fact: str) -> set[str]:
        """What is written down as a fact of any computation of the experiment."""


class MemoryRecord:
    """Remembers nothing beyond the process."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[str, Any]] = {}
        self.mark, self.of = f"forgotten {id(self)}", ""

    def find_own(self, name: str) -> Mapping[str, Any] | None:
        return self._kept.get(name)

    def keep(self, name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        return self._kept.setdefault(name, dict(facts))

    find_shared, keep_shared = find_own, keep

    def all_known(self, fact: str) -> set[str]:
        return {str(facts[fact]) for facts in self._kept.values() if fact in facts}


class ComputesOnce(ABC):
    """An executor that asks before it sends again."""

    @abstractmethod
    def compute_once(
        self, sent: SendingRecord, function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]
    ) -> Any:
        """What a function returns. Raises its error, PlaceUnavailable."""
