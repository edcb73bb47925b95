"""A node as a process of its own: ``python -m … <endpoint> <folder> [--slow-reset]``."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from labos.bus import open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.node import Setup, World
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.server import NodeServer
from tests.integration.node.bench import LAB, Arm


async def main(endpoint: str, folder: Path, *, slow_reset: bool) -> None:
    bus = await open_bus(connect=[endpoint])
    arm = Arm(Setup("arm", "cell", world=World(str(folder / "world.sqlite"))))
    if slow_reset:
        arm.go_reset.clear()
    journal = await Journal.open(FileJournalFile(folder / "arm.journal"), Uuid7Ids())
    server = NodeServer(arm, bus, LAB, journal, SystemClock(), Uuid7Ids(), heartbeat_s=0.1)
    await server.start()
    await server.stopping.wait()
    await server.close()
    await bus.close()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], Path(sys.argv[2]), slow_reset="--slow-reset" in sys.argv))
