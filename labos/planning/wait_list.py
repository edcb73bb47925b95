"""The steps and bundles of runs that wait, and what may end their waits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from labos.core.ids import RunId
from labos.core.waits import Wait
from labos.planning.alarms import Alarms

Name = tuple[str, int]
"""A run and one of its steps, or a bundle of runs that wait for admission and 0."""


class WaitList:
    """The steps and bundles that wait, and what each of them waits for."""

    def __init__(self) -> None:
        self._waits: dict[str, dict[int, list[Wait]]] = {}
        self._by_key: dict[str, dict[Name, bool]] = {}
        self._alarms: Alarms[Name] = Alarms()
        self._asked_at = 0

    def list_among(self, names: Mapping[RunId, bool]) -> list[str]:
        """The runs among these that have a waiting step, sorted. The time that it takes follows the smaller
        of two numbers: of these runs, or of the waiting ones."""
        return sorted(self._waits.keys() & names.keys())

    def add(self, name: Name, wait: Wait) -> None:
        """Add a wait of a step or bundle to those that it has already."""
        who, step = name
        waits = self._waits.setdefault(who, {}).setdefault(step, [])
        waits.append(wait)
        for key in wait.on:
            self._by_key.setdefault(key, {})[name] = True
        if wait.until is not None:
            self._alarms.set(name, min(w.until for w in waits if w.until is not None))

    def remove(self, name: Name) -> None:
        """Remove all waits of a step or bundle, if it has any."""
        who, step = name
        steps = self._waits.get(who)
        waits = steps.pop(step, None) if steps is not None else None
        if steps is None or waits is None:
            return
        if not steps:
            del self._waits[who]
        for wait in waits:
            for key in wait.on:
                names = self._by_key.get(key, {})
                names.pop(name, None)
                if not names:
                    self._by_key.pop(key, None)
        self._alarms.set(name, None)

    def forget(self, who: str) -> None:
        """Forget a run that has ended or a bundle that is empty."""
        for step in list(self._waits.get(who, ())):
            self.remove((who, step))

    def find_waiting(self, key: str) -> dict[Name, bool]:
        """The steps and bundles that wait for a key. The caller must neither change nor keep the dict."""
        return self._by_key.get(key, {})

    def list_due(self, now: int) -> list[Name]:
        """The steps and bundles that wait for a time that has come (UTC ns). If the clock was set back since
        the last call, all that wait for a time: it may count from a time that is far away now."""
        before, self._asked_at = self._asked_at, now
        return self._alarms.list_due(now) if before <= now else self._alarms.list_all()

    def find_first(self) -> int | None:
        """The earliest time that a step or bundle waits for (UTC ns); None if there is none."""
        return self._alarms.find_first()

    def find_waits(self, who: str) -> dict[int, list[Wait]]:
        """The waits of each step of a run."""
        return self._waits.get(who, {})

    def list_all(self) -> Iterator[tuple[str, Wait]]:
        """The runs and bundles that wait, with one wait for each step: the one that was found last."""
        for who, steps in self._waits.items():
            for waits in steps.values():
                yield who, waits[-1]
