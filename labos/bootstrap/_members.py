"""Distributes the list of parties with access to a secure bus to computers without the authority, over the
bus itself."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog

from labos.bus import MEMBERS, ZenohBus
from labos.errors import LabosError
from labos.pki import ReceivedList

REPEAT_S = 10.0
"""How often a list is sent again: the bus may have been away, or may have refused its sender (seconds)."""

_log = structlog.get_logger(__name__)


class MembersExchange:
    """Sends the local list, if the authority has signed it. Newer lists of others are stored in the folder of
    ``received``; if that is None, the authority itself is here. ``read`` returns the list to send; empty if
    there is none."""

    def __init__(self, bus: ZenohBus, read: Callable[[], bytes], received: ReceivedList | None) -> None:
        self._bus, self._read, self._received = bus, read, received
        self._task: asyncio.Task[None] | None = None
        self._sent = b""
        self._at = float("-inf")
        self._refused = ""

    async def start(self) -> None:
        if self._received is not None:
            await self._bus.subscribe(MEMBERS, self._on_list)

    async def send(self) -> None:
        """Send a new list at once, and an unchanged one from time to time. Raises LabosError."""
        now = asyncio.get_running_loop().time()
        data = await asyncio.to_thread(self._read)
        if data and (data != self._sent or now - self._at >= REPEAT_S):
            await self._bus.publish(MEMBERS, data)
            self._sent, self._at = data, now

    def _on_list(self, _: str, data: bytes) -> None:
        if data != self._sent:
            self._task = asyncio.get_running_loop().create_task(self._take(self._task, data))

    async def _take(self, before: asyncio.Task[None] | None, data: bytes) -> None:
        """Process one list after the other."""
        if before is not None:
            await asyncio.wait({before})
        assert self._received is not None
        try:
            if await asyncio.to_thread(self._received.offer, data):
                _log.warning("members_received", folder=str(self._received.folder))
            self._refused = ""
        except LabosError as error:
            if error.message != self._refused:  # the sender sends it again
                self._refused = error.message
                _log.warning("members_refused", why=error.message)
