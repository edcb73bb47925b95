"""An emergency stop with only the address of a bus, if no kernel answers."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

from labos.clock import SystemClock
from labos.core.ids import ModuleName
from labos.node.protocol import Keys
from labos.pki import Credentials
from labos.runtime.stop import StopReport, resolve_target, stop_modules

LOOK_S = 0.5
"""How long to look for living nodes."""


async def stop_over_bus(
    connect: Sequence[str], target: str, by: str, lab: str = "*", certificate: Path | None = None
) -> StopReport:
    """Stop a module, a workcell or all modules (``*``) that live on a bus. On a secure bus this needs the
    ``certificate`` of the kernel, or of a party that may stop modules. Raises BusError, BadInput,
    NotFound."""
    from labos.bus import Security, open_bus

    security = None
    if certificate is not None:
        credentials = Credentials(certificate)
        credentials.check(SystemClock().now_ns())
        identity = credentials.identity()
        lab = identity.lab if identity is not None else lab
        security = Security(credentials)
    bus = await open_bus(mode="client", connect=connect, security=security)
    try:
        living: dict[str, set[ModuleName]] = {}

        def note(key: str, alive: bool) -> None:
            if alive:
                living.setdefault(Keys.lab_of(key), set()).add(ModuleName(Keys.module_of(key)))

        await bus.watch_alive(Keys(lab).all_alive, note)
        await asyncio.sleep(LOOK_S)
        stopping = [
            stop_modules(bus, name, resolve_target(target, sorted(modules)), by)
            for name, modules in living.items()
        ]
        reports = await asyncio.gather(*stopping)
    finally:
        await bus.close()
    return StopReport(
        {module: at for report in reports for module, at in report.stopped.items()},
        {module: why for report in reports for module, why in report.silent.items()},
    )
