"""Forecasts are worked out in a process of their own, so that the kernel loses no time with them.

The state goes there as a picture (``labos.core.state.encode_picture``), and with it the records from which it
has not been learned yet how good forecasts were; the answer comes back, with what was learned. Nothing is
shared. One is worked out at a time, with a low priority, and given up after a while.
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
"""So many seconds are spent on what is to be learned; what is left is learned with the next forecast."""

GIVE_UP_S = 90.0
"""After so many seconds a forecast is given up."""

MOST_ASKED = 8
"""So many may be asked for at a time."""

NICE = 10

_encode = msgspec.msgpack.Encoder().encode


class ForecastJob(msgspec.Struct):
    """A forecast that is asked for, what is known of those of the past, and the records since then."""

    request: ForecastRequest
    known: LookBack
    rows: list[Row] = []


class ForecastResult(msgspec.Struct):
    """A forecast, and what is known now of those of the past."""

    forecast: LabForecast
    known: LookBack


class ForecastProcess:
    """Works out forecasts, one at a time; ``working`` is the process of the last one."""

    def __init__(self) -> None:
        self._turn = asyncio.Semaphore(1)
        self._asked = 0
        self.working: asyncio.subprocess.Process | None = None
        self._is_closed = False

    def close(self) -> None:
        """What is being worked out is given up, and nothing more is."""
        self._is_closed = True
        if self.working is not None and self.working.returncode is None:
            self.working.kill()

    async def answer(
        self, ask: Callable[[], Awaitable[ForecastJob]], keep: Callable[[LookBack], None]
    ) -> LabForecast:
        """What is to be expected; the question is asked when its turn comes, and what was learned is given
        to ``keep``. Raises Refused."""
        if self._asked >= MOST_ASKED:
            raise Refused(
                f"{self._asked} forecasts are asked for already.",
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
                told, said = await process.communicate(data)
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
            last = said.decode(errors="replace").strip().splitlines()[-1:]
            raise Refused(
                f"The forecast failed: {' '.join(last) or f'exit code {process.returncode}'}.",
                remedy="The lab goes on without it; please report this.",
            )
        return await asyncio.to_thread(msgspec.msgpack.decode, told, type=ForecastResult)

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
