"""Tells waiting requests that something has been committed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence

from labos.errors import StoreUnavailable
from labos.runtime.ledger import Entry

LONGEST_PAUSE_S = 2.0


class _Waiter:
    def __init__(self, holds: Callable[[], bool], each_s: float) -> None:
        self.holds, self.each_s = holds, each_s
        self.done: asyncio.Future[bool] = asyncio.get_running_loop().create_future()


class Feed:
    """A kernel's listener on which any number of requests wait. The more of them, the more seldom they are
    looked at: each costs the kernel's process time."""

    def __init__(self) -> None:
        self.closed = False
        self._waiters: set[_Waiter] = set()
        self._look_at: asyncio.TimerHandle | None = None
        self._looked = 0.0

    def on_committed(self, entries: Sequence[Entry]) -> None:
        if entries:
            self._wake_up()

    def on_reopened(self) -> None:
        self._wake_up()

    def close(self) -> None:
        """Let everybody go who waits."""
        self.closed = True
        for waiter in self._waiters:
            if not waiter.done.done():
                waiter.done.set_result(False)

    async def wait_until(self, holds: Callable[[], bool], timeout_s: float, each_s: float = 0.0002) -> bool:
        """Wait until something holds; False if it does not in time. ``each_s`` is the pause between two
        looks, for each who waits: what it costs to answer, some times over."""
        if _is_so(holds):
            return True
        if self.closed or timeout_s <= 0:
            return False
        waiter = _Waiter(holds, each_s)
        self._waiters.add(waiter)
        try:
            with contextlib.suppress(TimeoutError):
                return await asyncio.wait_for(waiter.done, timeout_s)
            return _is_so(holds)
        finally:
            self._waiters.discard(waiter)

    def _wake_up(self) -> None:
        if self._waiters and self._look_at is None:
            loop = asyncio.get_running_loop()
            pause = min(sum(waiter.each_s for waiter in self._waiters), LONGEST_PAUSE_S)
            self._look_at = loop.call_at(max(self._looked + pause, loop.time()), self._look)

    def _look(self) -> None:
        self._look_at, self._looked = None, asyncio.get_running_loop().time()
        for waiter in list(self._waiters):
            if not waiter.done.done() and _is_so(waiter.holds):
                waiter.done.set_result(True)


def _is_so(holds: Callable[[], bool]) -> bool:
    try:
        return holds()
    except StoreUnavailable:
        return False  # the log is being reopened
