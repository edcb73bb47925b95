"""An answer for everybody who asks at the same time, worked out once."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

LOAD = 0.2
"""The part of the kernel's time that working out an answer may take, however many ask."""
LONGEST_PAUSE_S = 2.0


class Shared:
    """Those who ask wait together for the next answer. It is never older than their question; and the more
    work it is, the longer is the pause before the one after it."""

    def __init__(
        self, work: Callable[[], bytes], written: Callable[[], Awaitable[None]], load: float = LOAD
    ) -> None:
        self._work, self._written, self._load = work, written, load
        self._next: asyncio.Task[bytes] | None = None
        self._rest_until = 0.0

    async def get(self) -> bytes:
        """The answer, when what it tells is on disk."""
        if self._next is None:
            self._next = asyncio.get_running_loop().create_task(self._answer_next())
        return await asyncio.shield(self._next)

    async def _answer_next(self) -> bytes:
        try:
            pause = self._rest_until - time.monotonic()
            if pause > 0:
                await asyncio.sleep(pause)
        finally:
            self._next = None  # from here on, who asks would get an answer older than the question
        begun = time.monotonic()
        answer = self._work()
        took = time.monotonic() - begun
        self._rest_until = begun + took + min(took / self._load, LONGEST_PAUSE_S)
        await self._written()
        return answer
