"""The times at which something is checked again without an event: the earliest time comes first."""

from __future__ import annotations

import heapq
from collections.abc import Hashable
from typing import Generic, TypeVar

Name = TypeVar("Name", bound=Hashable)


def find_earliest(*times: int | None) -> int | None:
    """The earliest of these times; None if there is none."""
    return min((time for time in times if time is not None), default=None)


class Alarms(Generic[Name]):
    """One time (UTC ns) for each name. Setting a time stays fast if many times are set."""

    def __init__(self) -> None:
        self._at: dict[Name, int] = {}
        self._heap: list[tuple[int, int, Name]] = []
        self._count = 0

    def set(self, name: Name, at: int | None) -> None:
        """Set the time of a name; None removes it."""
        if at is None:
            self._at.pop(name, None)
        elif self._at.get(name) != at:
            self._at[name] = at
            self._count += 1
            heapq.heappush(self._heap, (at, self._count, name))

    def find_first(self) -> int | None:
        """The earliest time; None if no time is set."""
        while self._heap and self._is_over(self._heap[0]):
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def list_due(self, now: int) -> list[Name]:
        """The names whose time has come, the earliest first. They keep their times until new ones are set."""
        if not self._heap or self._heap[0][0] > now:
            return []
        found: list[tuple[int, int, Name]] = []
        while self._heap and self._heap[0][0] <= now:
            entry = heapq.heappop(self._heap)
            if not self._is_over(entry):
                found.append(entry)
        for entry in found:
            heapq.heappush(self._heap, entry)
        return list(dict.fromkeys(name for _, _, name in found))

    def list_all(self) -> list[Name]:
        """The names that have a time."""
        return list(self._at)

    def clear(self) -> None:
        self._at.clear()
        self._heap.clear()

    def _is_over(self, entry: tuple[int, int, Name]) -> bool:
        at, _, name = entry
        return self._at.get(name) != at
