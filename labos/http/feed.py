"""Tells waiting requests that something has been committed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence

from labos.errors import StoreUnavailable
from labos.runtime.ledger import Entry


class Feed:
    """A kernel's listener on which any number of requests wait."""

    def __init__(self) -> None:
        self.position = 0
        self.closed = False
        self._changed = asyncio.Event()

    def committed(self, entries: Sequence[Entry]) -> None:
        if entries:
            self.position = entries[-1].position
            self._ring()

    def reopened(self) -> None:
        self._ring()

    def close(self) -> None:
        """Let everybody go who waits."""
        self.closed = True
        self._ring()

    async def change(self, timeout_s: float) -> None:
        """Wait for the next commit, or for the time to pass."""
        changed = self._changed
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), timeout_s)

    async def until(self, holds: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until something holds; False if it does not in time."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while True:
            try:
                if holds():
                    return True
            except StoreUnavailable:
                pass  # the log is being reopened
            left = deadline - loop.time()
            if left <= 0 or self.closed:
                return False
            await self.change(left)

    def _ring(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()
