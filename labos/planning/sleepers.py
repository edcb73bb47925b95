"""Steps and bundles of runs that wait, and what may end their waits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from labos.core.ids import RunId
from labos.core.waits import Wait
from labos.planning.alarms import Alarms

Name = tuple[str, int]
"""A run and a step of it, or a bundle of runs that wait to be let in and 0."""


class Sleepers:
    """The steps and bundles that wait, and what each of them waits for. One that is woken waits for nothing
    any more."""

    def __init__(self) -> None:
        self._waits: dict[str, dict[int, list[Wait]]] = {}
        self._by_key: dict[str, dict[Name, bool]] = {}
        self._alarms: Alarms[Name] = Alarms()
        self._asked_at = 0

    def list_among(self, names: Mapping[RunId, bool]) -> list[str]:
        """Those of these runs that have a waiting step, sorted. The time it takes follows the smaller of the
        two numbers: these runs, or waiting ones."""
        return sorted(self._waits.keys() & names.keys())

    def sleep(self, name: Name, wait: Wait) -> None:
        """Let somebody wait, beside what it waits for already."""
        who, step = name
        waits = self._waits.setdefault(who, {}).setdefault(step, [])
        waits.append(wait)
        for key in wait.on:
            self._by_key.setdefault(key, {})[name] = True
        if wait.until is not None:
            self._alarms.set(name, min(w.until for w in waits if w.until is not None))

    def wake(self, name: Name) -> None:
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
        """A run has ended, or a bundle is empty."""
        for step in list(self._waits.get(who, ())):
            self.wake((who, step))

    def find_waiting(self, key: str) -> dict[Name, bool]:
        """Who waits for a key. Not to be changed, nor kept."""
        return self._by_key.get(key, {})

    def list_due(self, now: int) -> list[Name]:
        """Who waits for a time that has come (UTC ns). If the clock was set back since this was asked last,
        all who wait for a time: it may have been counted from a time that is far away now."""
        before, self._asked_at = self._asked_at, now
        return self._alarms.list_due(now) if before <= now else self._alarms.list_all()

    def find_first(self) -> int | None:
        """The earliest time that somebody waits for (UTC ns)."""
        return self._alarms.find_first()

    def find_waits(self, who: str) -> dict[int, list[Wait]]:
        """What each step of a run waits for."""
        return self._waits.get(who, {})

    def list_all(self) -> Iterator[tuple[str, Wait]]:
        """Who waits, and for what: one wait for each step, the one that was found last."""
        for who, steps in self._waits.items():
            for waits in steps.values():
                yield who, waits[-1]
