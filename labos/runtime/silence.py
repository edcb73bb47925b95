"""Notices that a peer has not answered a request for too long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

LOOK_S = 1.0
"""The longest pause between two checks; a shorter limit is checked ten times."""


class SilenceTimer:
    """Calls ``on_silence`` when ``sign()`` has not changed for ``limit_s``, and again as long as it does not;
    if it is None, there is no open request and the checks end.

    Only time in which this process itself ran is counted: if a kernel was frozen, or its machine slept, the
    peer is not the cause.
    """

    def __init__(
        self, limit_s: float, sign: Callable[[], object | None], on_silence: Callable[[], None]
    ) -> None:
        self._limit_s, self._sign, self._on_silence = limit_s, sign, on_silence
        self._look_s = min(LOOK_S, limit_s / 10)
        self._loop = asyncio.get_running_loop()
        self._alarm: asyncio.TimerHandle | None = None
        self._seen: object | None = None
        self._looked_at = self._silent_s = 0.0

    def watch(self) -> None:
        """There is an open request."""
        if self._alarm is None:
            self._seen = None
            self._look_later()

    def stop(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    def _look_later(self) -> None:
        self._looked_at = self._loop.time()
        self._alarm = self._loop.call_later(self._look_s, self._look)

    def _look(self) -> None:
        self._alarm = None
        sign = self._sign()
        if sign is None:
            return
        if sign != self._seen:
            self._seen, self._silent_s = sign, 0.0
        else:
            self._silent_s += min(self._loop.time() - self._looked_at, 2 * self._look_s)
        self._look_later()
        if self._silent_s >= self._limit_s:
            self._silent_s = 0.0
            self._on_silence()
