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
from labos.runtime.ledger import Entry
from labos.runtime.tasks import KernelPart

LONGEST_BACKLOG = 10_000
"""The number of events that may wait for a slow bus; beyond that the oldest are not published (they are in
the log)."""

_log = structlog.get_logger(__name__)


class Announcer(KernelPart):
    """Publishes ``{"envelope": …, "payload": …}`` on ``labos/<lab>/@events/<family>``, in order."""

    def __init__(self, kernel: Kernel, bus: Bus) -> None:
        super().__init__(kernel)
        self._bus = bus
        self._keys = Keys(kernel.lab)
        self._backlog: asyncio.Queue[Entry] = asyncio.Queue(LONGEST_BACKLOG)
        self.left_out = 0

    async def start(self) -> None:
        await super().start()
        self._tasks.spawn(self._announce())

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
