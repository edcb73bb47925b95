"""Drives a SWING through a gateway to the software of its manufacturer."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from labos_drivers.gateway.driver import GatedDriver

PROGRAM = re.compile(r"[\w .\-]{1,100}")


class ChemspeedDriver(GatedDriver):
    """The hood is open when its sensor reports it. A program has ended when its last task reports it."""

    instrument = "chemspeed"

    async def run_program(
        self,
        program: str,
        wells: Sequence[str] = (),
        volumes: Mapping[str, Sequence[float]] | None = None,
        lengths: Sequence[float] = (),
    ) -> None:
        if not PROGRAM.fullmatch(program):
            raise self.make_refusal(
                f"{program[:40]!r} is no name of a program", "Name it as AutoSuite does, without a folder."
            )
        recipe: dict[str, Any] = {}
        if wells:
            recipe = {"wells": list(wells), "volumes": dict(volumes or {}), "lengths": list(lengths)}
        await self.call("run_program", program=program, **recipe)
