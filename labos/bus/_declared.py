"""What a session has declared, and how much of what it hears is let through."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import structlog
import zenoh

from labos.bus._opening import reason_of

MOST_WAITING = 10_000
"""Publications of one subscription, or queries for one key, that wait to be handled. More are dropped:
publishers send again, a caller that asked gets no answer, and a flood must not take all memory."""

MOST_TOKENS = 65_536
"""Living keys that a watcher is told of."""

_log = structlog.get_logger(__name__)


class Declared:
    """Something declared on the bus."""

    def __init__(self, declare: Callable[[], Any], siblings: dict[Declared, None]) -> None:
        self._declare = declare
        self._entity = declare()
        self._siblings = siblings
        self.closed = False
        siblings[self] = None

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        self._siblings.pop(self, None)
        self.undeclare()

    def undeclare(self) -> None:
        try:
            self._entity.undeclare()
        except zenoh.ZError as error:
            _log.debug("undeclare_failed", error=str(error))

    def declare_again(self) -> None:
        """In a new session."""
        if not self.closed:
            try:
                self._entity = self._declare()
            except (
                zenoh.ZError
            ) as error:  # the session has ended again: it is done when the session is opened the next time
                _log.warning("not_declared_again", error=reason_of(error))


class KeyWatch:
    """The living keys that a watcher was told of."""

    def __init__(self, deliver: Callable[[str, bool], None]) -> None:
        self._deliver = deliver
        self._alive: set[str] = set()
        self._awaited: set[str] = set()

    def note(self, key: str, living: bool) -> None:
        self._awaited.discard(key)
        # A router that restarts tells a token again.
        if living == (key in self._alive) or (living and len(self._alive) >= MOST_TOKENS):
            return
        (self._alive.add if living else self._alive.discard)(key)
        self._deliver(key, living)

    def await_return(self) -> set[str]:
        """The session is new: those who live are expected to show themselves again."""
        self._awaited = set(self._alive)
        return self._awaited

    def miss(self, awaited: set[str]) -> None:
        """Those who did not come back are gone."""
        for key in list(awaited) if awaited is self._awaited else ():
            self.note(key, False)


class Waiting:
    """How much was handed over to the event loop, and how much of it is done. The receiving threads count
    the one, the loop the other."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._given = 0
        self.taken = 0

    def take_place(self) -> bool:
        """Whether one more may be handed over; it counts as handed over then."""
        if self._given - self.taken >= MOST_WAITING:
            return False
        self._given = next(self._numbers)
        return True


class Guarded:
    """A listener that cannot hurt the loop, and that hears nothing after its handle is closed."""

    def __init__(self, listener: Callable[[str, Any], None]) -> None:
        self._listener = listener
        self.handle: Declared | None = None

    def __call__(self, key: str, value: Any) -> None:
        if self.handle is not None and self.handle.closed:
            return
        try:
            self._listener(key, value)
        except Exception:
            _log.exception("listener_failed", key=key)
