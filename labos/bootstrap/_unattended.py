"""Measures the time without human intervention of a running lab: first from past events, then from new
ones."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence

import structlog

from labos.clock import Clock
from labos.core.envelope import Record
from labos.errors import LabosError
from labos.runtime.ledger import Entry
from labos.services.log import Log, decode_event
from labos.services.twh import HEARD, Meter

PAGE = 500
"""The number of past events that are read at once."""

SHARE = 0.2
"""The largest part of the time for reading the past, because the kernel works in the same process."""

RECENT = 20_000
"""New events that are kept during the reading, to continue from the last past event without a gap."""

KEEP = 1000
"""Ended runs and experiments that are remembered for later reports of people about them."""

_log = structlog.get_logger(__name__)


class UnattendedMeter:
    """A kernel's listener. ``meter`` is None until the log was read from its beginning."""

    def __init__(self, log: Log, clock: Clock, durable: Callable[[], int]) -> None:
        self._log, self._clock, self._durable = log, clock, durable
        self.meter: Meter | None = None
        self._recent: deque[Entry] = deque(maxlen=RECENT)
        self._task: asyncio.Task[None] | None = None
        self._page: asyncio.Future[int] | None = None

    def start(self) -> None:
        """Read the past events in the background."""
        self._break_off()
        self.meter = None
        self._recent.clear()
        self._task = asyncio.get_running_loop().create_task(self._catch_up())

    async def close(self) -> None:
        """Stop reading at any point; the present page is read to its end."""
        self._break_off()
        if self._page is not None:
            await asyncio.wait({self._page})

    def _break_off(self) -> None:
        if self._task is not None:
            self._task.cancel()

    def on_committed(self, entries: Sequence[Entry]) -> None:
        if self.meter is None:
            self._recent.extend(entries)
        else:
            for entry in entries:
                _add(self.meter, entry.record)

    def on_reopened(self) -> None:
        """There may be events that no listener has received: read everything again."""
        self.start()

    async def _catch_up(self) -> None:
        meter, after = Meter(KEEP), 0
        try:
            while not self._is_complete_after(after):
                began = self._clock.monotonic()
                loop = asyncio.get_running_loop()
                self._page = loop.run_in_executor(None, self._read_page, meter, after)
                after = await asyncio.shield(self._page)
                await asyncio.sleep((self._clock.monotonic() - began) * (1 / SHARE - 1))
        except LabosError as error:  # the kernel reads the log again too, and reports the error
            _log.warning("past_not_measured", after=after, why=str(error))
            return
        for entry in self._recent:
            if entry.position > after:
                _add(meter, entry.record)
        self._recent.clear()
        self.meter = meter

    def _is_complete_after(self, after: int) -> bool:
        """Whether no event is missing between the past events and the received ones."""
        first = self._recent[0].position if self._recent else self._durable() + 1
        return after + 1 >= first

    def _read_page(self, meter: Meter, after: int) -> int:
        for record in self._log.read(after, after + PAGE):
            after = record.head.position
            _add(meter, record)
        return after


def _add(meter: Meter, record: Record) -> None:
    if record.head.type in HEARD:
        meter.add(decode_event(record), record.head)
    else:
        meter.pass_time(record.head.recorded_at)
