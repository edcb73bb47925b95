"""How the tests of the adapters begin."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from labos.core.model import ActionSpec, Arg, Description
from tests.integration.adapter.bench import Bench, bench
from tests.integration.ports import free_endpoint

SPEED = Arg(name="speed", type="int")
TIME = Arg(name="time_s", type="float", required=False, default=0.2)
LABEL = Arg(name="label", type="str", required=False, default="")


def shaker(driver: str) -> Description:
    """A device whose values are reached by name: it shakes, also by an id of ours, and travels."""
    return Description(
        driver=driver,
        version="",
        description="",
        actions=(
            ActionSpec(name="shake", args=(SPEED, TIME, LABEL)),
            ActionSpec(name="shake_by_id", args=(SPEED, TIME, LABEL)),
            ActionSpec(name="travel", args=(Arg(name="target", type="float"),)),
        ),
    )


def play(folder: Path, scenario: Callable[[Bench], Awaitable[None]], *, limit_s: float) -> None:
    """A scenario on a bench of its own."""

    async def main() -> None:
        async with bench(folder, free_endpoint()) as here:
            await asyncio.wait_for(scenario(here), limit_s)

    asyncio.run(main())
