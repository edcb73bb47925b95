"""A journal's file in memory, that can be made to fail."""

from __future__ import annotations

import asyncio
import itertools


class MemoryFile:
    """Keeps what was synced. ``fail`` makes the next writes fail; ``gate`` holds them up."""

    def __init__(self, data: bytes = b"") -> None:
        self.data = data
        self.fail = False
        self.gate: asyncio.Event | None = None
        self.writes = 0
        self.replaced = 0

    async def read(self) -> bytes:
        return self.data

    async def append(self, data: bytes) -> None:
        await self._turn()
        self.data += data

    async def replace(self, data: bytes) -> None:
        await self._turn()
        self.replaced += 1
        self.data = data

    async def close(self) -> None: ...

    async def _turn(self) -> None:
        self.writes += 1
        if self.gate is not None:
            await self.gate.wait()
        if self.fail:
            raise OSError(28, "No space left on device")


class Counter:
    """Ids that a test can foresee."""

    def __init__(self, prefix: str = "id") -> None:
        self._numbers = itertools.count(1)
        self._prefix = prefix

    def new(self) -> str:
        return f"{self._prefix}{next(self._numbers)}"
