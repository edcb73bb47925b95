"""How the list of who may speak on a secure bus comes to where the authority is not: over the bus itself."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog

from labos.bus import MEMBERS, ZenohBus
from labos.errors import LabosError
from labos.pki import ReceivedList

REPEAT_S = 10.0
"""How often a list is sent again: to a bus that was away, or did not let its sender in."""

_log = structlog.get_logger(__name__)


class MembersExchange:
    """Sends the list that is known here, if the authority has signed it, and keeps newer ones that are sent
    by others in the folder of ``received``; where there is none, the authority itself is here. ``read`` is
    the list as it is sent, empty if there is nothing to send."""

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
        """Send what is new, and from time to time what is not. Raises LabosError."""
        now = asyncio.get_running_loop().time()
        data = await asyncio.to_thread(self._read)
        if data and (data != self._sent or now - self._at >= REPEAT_S):
            await self._bus.publish(MEMBERS, data)
            self._sent, self._at = data, now

    def _on_list(self, _: str, data: bytes) -> None:
        if data != self._sent:
            self._task = asyncio.get_running_loop().create_task(self._take(self._task, data))

    async def _take(self, before: asyncio.Task[None] | None, data: bytes) -> None:
        """One after the other."""
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
