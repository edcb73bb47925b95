"""A stream ends when its follower's credential ends: at its expiry, or when it is revoked."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The process for followers starts without these imports.
    from labos.clock import Clock
    from labos.services.accounts import Credential

_SECOND = 1_000_000_000
LONGEST_S = 86400.0
"""A stream with a credential ends after a day at the latest; its follower connects again."""


class StreamEnd:
    """The end of one stream. ``when`` is called at the end."""

    def __init__(self, lasts_s: float) -> None:
        self.has_come = False
        self.when: Callable[[], None] = lambda: None
        self.timer = asyncio.get_running_loop().call_later(min(lasts_s, LONGEST_S), self.come)

    def come(self) -> None:
        self.has_come = True
        self.timer.cancel()
        self.when()


class OpenStreams:
    """The streams of a process, by the key of their credential."""

    def __init__(self) -> None:
        self._ends: dict[str, set[StreamEnd]] = {}

    def begin(self, key: str, lasts_s: float) -> StreamEnd:
        end = StreamEnd(lasts_s)
        self._ends.setdefault(key, set()).add(end)
        return end

    def forget(self, key: str, end: StreamEnd) -> None:
        """The stream has ended by itself."""
        end.timer.cancel()
        left = self._ends.get(key, set())
        left.discard(end)
        if not left:
            self._ends.pop(key, None)

    def cut(self, key: str) -> None:
        """End the streams with this credential."""
        for end in self._ends.pop(key, ()):
            end.come()


class StreamEnds(OpenStreams):
    """The streams of this process, and those that another process serves: ``cut_elsewhere`` is called with
    the keys that have ended."""

    def __init__(self, clock: Clock, cut_elsewhere: Callable[[str], None]) -> None:
        super().__init__()
        self._clock, self._cut_elsewhere = clock, cut_elsewhere
        self._known: dict[str, Credential] = {}

    @property
    def followed(self) -> frozenset[str]:
        """The keys of the credentials with which streams may be open."""
        return frozenset(self._known)

    def find_length_s(self, credential: Credential) -> float:
        """How long a stream that begins now may last; its credential is stored."""
        now = self._clock.now_ns()
        self._known = {key: known for key, known in self._known.items() if known.until > now}
        self._known[credential.key] = credential
        return max(0.0, (credential.until - now) / _SECOND)

    def cut_all(self, which: Callable[[Credential], bool]) -> None:
        """End the streams of these credentials."""
        for key, credential in list(self._known.items()):
            if which(credential):
                del self._known[key]
                self._cut_elsewhere(key)
                self.cut(key)
