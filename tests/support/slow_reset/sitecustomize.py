"""Makes the reset of simulated devices last: Python loads this at start when its folder is on
PYTHONPATH. What runs is the real thing; only the device takes its time."""

from __future__ import annotations

import asyncio
import sys
from typing import Any

if "node" in sys.argv:
    from labos_drivers._simulation import Instrument

    reset = Instrument.reset

    async def slow_reset(self: Any) -> None:
        await reset(self)
        if "pf400" in sys.argv:  # asked now: nodes are forks of a process that is none of them
            await asyncio.Event().wait()

    Instrument.reset = slow_reset  # type: ignore[method-assign]
