"""An answer that is computed once for all requests at the same time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

LOAD = 0.2
"""The part of the kernel's time that computing an answer may take, for any number of requests."""
LONGEST_PAUSE_S = 2.0


class Shared:
    """Requests wait together for the next answer. The answer is never older than a request. The longer an
    answer takes to compute, the longer is the pause before the next one."""

    def __init__(self, work: Callable[[], bytes], written: Callable[[], Awaitable[None]]) -> None:
        self._work, self._written = work, written
        self._next: asyncio.Task[bytes] | None = None
        self._rest_until = 0.0

    async def get(self) -> bytes:
        """The answer, when everything that it reports is on disk."""
        if self._next is None:
            self._next = asyncio.get_running_loop().create_task(self._answer_next())
        return await asyncio.shield(self._next)

    async def _answer_next(self) -> bytes:
        try:
            pause = self._rest_until - time.monotonic()
            if pause > 0:
                await asyncio.sleep(pause)
        finally:
            self._next = None  # from here on, this answer would be older than a new request
        begun = time.monotonic()
        answer = self._work()
        took = time.monotonic() - begun
        self._rest_until = begun + took + min(took / LOAD, LONGEST_PAUSE_S)
        await self._written()
        return answer
