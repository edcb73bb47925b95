"""Forecasts are computed in a separate process, so that the kernel loses no time with them.

The process receives the state as a picture (``labos.core.state.encode_picture``), and the records from which
the errors of forecasts have not been learned yet. It returns the forecast and what it has learned. Nothing is
shared. Forecasts are computed one at a time, with a low priority and a limited duration.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Awaitable, Callable

import msgspec

from labos.clock import SystemClock
from labos.errors import Refused
from labos.planning.hindsight import LookBack, Row, look_back
from labos.planning.lab_forecast import ForecastRequest, LabForecast, forecast_lab

LOOKS_BACK_S = 15.0
"""So many seconds are spent on learning; the remaining records are used with the next forecast."""

GIVE_UP_S = 90.0
"""A forecast fails after so many seconds."""

MOST_ASKED = 8
"""At most so many forecasts may wait at the same time."""

NICE = 10

_encode = msgspec.msgpack.Encoder().encode


class ForecastJob(msgspec.Struct):
    """A requested forecast, the errors learned from past forecasts, and the records since then."""

    request: ForecastRequest
    known: LookBack
    rows: list[Row] = []


class ForecastResult(msgspec.Struct):
    """A forecast, and the errors learned from past forecasts up to now."""

    forecast: LabForecast
    known: LookBack


class ForecastProcess:
    """Computes forecasts, one at a time; ``working`` is the process of the last one."""

    def __init__(self) -> None:
        self._turn = asyncio.Semaphore(1)
        self._asked = 0
        self.working: asyncio.subprocess.Process | None = None
        self._is_closed = False

    def close(self) -> None:
        """The present forecast is stopped, and no other is begun."""
        self._is_closed = True
        if self.working is not None and self.working.returncode is None:
            self.working.kill()

    async def answer(
        self, ask: Callable[[], Awaitable[ForecastJob]], keep: Callable[[LookBack], None]
    ) -> LabForecast:
        """The forecast. ``ask`` is called when its turn comes, and ``keep`` receives what was learned. Raises
        Refused."""
        if self._asked >= MOST_ASKED:
            raise Refused(
                f"{self._asked} forecasts are already waiting.",
                remedy="Ask again when they have been answered.",
            )
        self._asked += 1
        try:
            async with self._turn:
                found = await self._work_out(await ask())
                keep(found.known)
                return found.forecast
        finally:
            self._asked -= 1

    async def _work_out(self, question: ForecastJob) -> ForecastResult:
        data = await asyncio.to_thread(_encode, question)
        self._expect_open()
        process = self.working = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            __spec__.name,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        try:
            async with asyncio.timeout(GIVE_UP_S):
                output, errors = await process.communicate(data)
        except TimeoutError:
            raise Refused(
                f"The forecast took longer than {GIVE_UP_S:g} s and was given up.",
                remedy="Ask again when the lab has less to do.",
            ) from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        self._expect_open()
        if process.returncode:
            last = errors.decode(errors="replace").strip().splitlines()[-1:]
            raise Refused(
                f"The forecast failed: {' '.join(last) or f'exit code {process.returncode}'}.",
                remedy="The lab continues without it; please report this.",
            )
        return await asyncio.to_thread(msgspec.msgpack.decode, output, type=ForecastResult)

    def _expect_open(self) -> None:
        if self._is_closed:
            raise Refused("The lab is being closed.", remedy="Ask again when it has been started.")


def main() -> None:
    """Read a question, write the answer."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    clock = SystemClock()
    began = clock.monotonic()
    asked = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=ForecastJob)
    searches = asked.request.orders is not None
    known = look_back(
        asked.known, asked.rows, lambda: clock.monotonic() - began > LOOKS_BACK_S, searches=searches
    )
    asked.request.hindsight = known.hindsight
    sys.stdout.buffer.write(_encode(ForecastResult(forecast_lab(asked.request), known)))


if __name__ == "__main__":
    main()
