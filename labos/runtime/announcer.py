"""Publishes committed events on the bus, for dashboards and other listeners; the bus is never the record
itself."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import structlog

from labos.errors import BusError
from labos.node.protocol import Keys
from labos.ports import Bus
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import Listener
from labos.runtime.ledger import Entry

LONGEST_BACKLOG = 10_000
"""The number of events that may wait for a slow bus; beyond that the oldest are not published (they are in
the log)."""

_log = structlog.get_logger(__name__)


class Announcer(Listener):
    """Publishes ``{"envelope": …, "payload": …}`` on ``labos/<lab>/@events/<family>``, in order."""

    def __init__(self, kernel: Kernel, bus: Bus) -> None:
        self._kernel, self._bus = kernel, bus
        self._keys = Keys(kernel.lab)
        self._backlog: asyncio.Queue[Entry] = asyncio.Queue(LONGEST_BACKLOG)
        self._task: asyncio.Task[None] | None = None
        self.left_out = 0

    async def start(self) -> None:
        self._kernel.listeners.append(self)
        self._task = asyncio.get_running_loop().create_task(self._announce())

    async def close(self) -> None:
        if self in self._kernel.listeners:
            self._kernel.listeners.remove(self)
        if self._task is not None:
            self._task.cancel()

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            if self._backlog.full():
                self._backlog.get_nowait()
                self.left_out += 1
            self._backlog.put_nowait(entry)

    async def _announce(self) -> None:
        while True:
            record = (await self._backlog.get()).record
            message = b'{"envelope":' + record.envelope + b',"payload":' + record.payload + b"}"
            try:
                await self._bus.publish(self._keys.events(record.head.type.partition(".")[0]), message)
            except BusError as error:
                _log.warning("event_not_announced", position=record.head.position, why=str(error))
