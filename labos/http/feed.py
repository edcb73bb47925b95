"""Wakes waiting requests after a commit."""

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
    """A kernel's listener on which any number of requests wait. The more requests wait, the less often they
    are checked, as each check uses time of the kernel's process."""

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
        """Wake all waiting requests."""
        self.closed = True
        for waiter in self._waiters:
            if not waiter.done.done():
                waiter.done.set_result(False)

    async def wait_until(self, holds: Callable[[], bool], timeout_s: float, each_s: float = 0.0002) -> bool:
        """Wait until ``holds`` returns true; False if it does not in time. ``each_s`` is the pause between
        two checks for each waiting request: several times the cost of an answer."""
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
