"""The declarations of a session, and the limits for messages that it passes on."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import structlog
import zenoh

from labos.bus._opening import reason_of

MOST_WAITING = 10_000
"""The most publications of one subscription, or queries for one key, that wait to be handled. More are
dropped: publishers send again, a caller gets no answer. So a flood cannot use up the memory."""

MOST_TOKENS = 65_536
"""The most living keys that a watcher reports."""

_log = structlog.get_logger(__name__)


class Declared:
    """A declaration on the bus."""

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
        """Declare it again in a new session."""
        if not self.closed:
            try:
                self._entity = self._declare()
            except zenoh.ZError as error:
                # The session has ended again: this is done when the next session is opened.
                _log.warning("not_declared_again", error=reason_of(error))


class KeyWatch:
    """The living keys that a watcher has reported."""

    def __init__(self, deliver: Callable[[str, bool], None]) -> None:
        self._deliver = deliver
        self._alive: set[str] = set()
        self._awaited: set[str] = set()

    def note(self, key: str, living: bool) -> None:
        self._awaited.discard(key)
        # A router that restarts reports a token again.
        if living == (key in self._alive) or (living and len(self._alive) >= MOST_TOKENS):
            return
        (self._alive.add if living else self._alive.discard)(key)
        self._deliver(key, living)

    def await_return(self) -> set[str]:
        """The session is new: return the known keys, which are expected to show themselves again."""
        self._awaited = set(self._alive)
        return self._awaited

    def miss(self, awaited: set[str]) -> None:
        """Report the keys that did not come back as gone."""
        for key in list(awaited) if awaited is self._awaited else ():
            self.note(key, False)


class Waiting:
    """Counts the messages handed to the event loop, and those that it has handled. The receiving threads
    increase the first number, the loop the second."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._given = 0
        self.taken = 0

    def take_place(self) -> bool:
        """Whether one more message may be handed over; it then counts as handed over."""
        if self._given - self.taken >= MOST_WAITING:
            return False
        self._given = next(self._numbers)
        return True


class Guarded:
    """A listener whose errors do not harm the loop, and that receives nothing after its handle is closed."""

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
