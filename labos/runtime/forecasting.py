"""Forecasts are worked out in a process of their own, so that the kernel loses no time with them.

The state goes there as a picture (``labos.core.state.picture``), the answer comes back; nothing is shared.
One is worked out at a time, with a low priority, and given up after a while.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Callable

import msgspec

from labos.clock import SystemClock
from labos.errors import Refused
from labos.planning.lab_forecast import ForecastRequest, LabForecast, forecast_lab

ENOUGH_S = 15.0
"""After so many seconds what was worked out has to do."""

GIVE_UP_S = 90.0
"""After so many seconds a forecast is given up."""

MOST_ASKED = 8
"""So many may be asked for at a time."""

NICE = 10

_encode = msgspec.msgpack.Encoder().encode


class ForecastProcess:
    """Works out forecasts, one at a time."""

    def __init__(self) -> None:
        self._turn = asyncio.Semaphore(1)
        self._asked = 0

    async def forecast_lab(self, ask: Callable[[], ForecastRequest]) -> LabForecast:
        """What is to be expected; the request is asked when its turn comes. Raises Refused."""
        if self._asked >= MOST_ASKED:
            raise Refused(
                f"{self._asked} forecasts are asked for already.",
                remedy="Ask again when they have been answered.",
            )
        self._asked += 1
        try:
            async with self._turn:
                return await self._work_out(ask())
        finally:
            self._asked -= 1

    async def _work_out(self, request: ForecastRequest) -> LabForecast:
        data = await asyncio.to_thread(_encode, request)
        process = await asyncio.create_subprocess_exec(
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
        if process.returncode:
            last = said.decode(errors="replace").strip().splitlines()[-1:]
            raise Refused(
                f"The forecast failed: {' '.join(last) or f'exit code {process.returncode}'}.",
                remedy="The lab goes on without it; please report this.",
            )
        return await asyncio.to_thread(msgspec.msgpack.decode, told, type=LabForecast)


def main() -> None:
    """Read a request, write the answer."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    clock = SystemClock()
    began = clock.monotonic()
    request = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=ForecastRequest)
    found = forecast_lab(request, lambda: clock.monotonic() - began > ENOUGH_S)
    sys.stdout.buffer.write(_encode(found))


if __name__ == "__main__":
    main()
