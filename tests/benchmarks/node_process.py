"""A process of nodes whose devices do nothing: ``python -m … ENDPOINT LAB FOLDER FIRST COUNT``.

Beside each node that speaks the protocol stands a *bare* one with a journal of the same kind. It
writes an attempt down, answers, writes the result down and publishes it; it checks nothing.
"""

from __future__ import annotations

import asyncio
import logging
import sys
from pathlib import Path

import msgspec
import structlog

from labos.bus import ZenohBus, open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.node import Node, Setup, action
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Outcome, ResultPublished, Start
from labos.node.server import NodeServer

CELL = "bench"
_encode = msgspec.json.Encoder().encode
_start = msgspec.json.Decoder(Start)


def local_name(number: int) -> str:
    return f"m{number:02}"


class Idle(Node):
    """A device that is done at once."""

    driver = "idle"

    @action(duration_s=0.0)
    async def act(self) -> None:
        """Do nothing."""


class BareNode:
    """Journal, answer, publish; nothing else."""

    def __init__(self, bus: ZenohBus, name: str, journal: Journal) -> None:
        self._bus, self._name, self._journal = bus, name, journal
        self._tasks: set[asyncio.Task[None]] = set()

    async def serve(self) -> None:
        await self._bus.serve(f"bare/{self._name}/action", self._on_action)

    async def _on_action(self, payload: bytes) -> bytes:
        start = _start.decode(payload)
        self._journal.prune(start.position - 1)
        self._journal.accept(start.action, start.attempt, start.position, start.name)
        await self._journal.sync()
        task = asyncio.get_running_loop().create_task(self._end(start))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return b"{}"

    async def _end(self, start: Start) -> None:
        outcome = Outcome(True, "all")
        self._journal.end(start.action, start.attempt, outcome)
        told = ResultPublished(start.action, start.attempt, self._journal.memory.id, outcome)
        await self._bus.publish(f"bare/{self._name}/result", _encode(told))
        await self._journal.sync()


async def main(endpoint: str, lab: str, folder: Path, first: int, count: int) -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    bus = await open_bus(connect=[endpoint])
    servers = []
    for number in range(first, first + count):
        name = local_name(number)
        bare = await Journal.open(FileJournalFile(folder / f"bare-{name}.journal"), Uuid7Ids())
        await BareNode(bus, name, bare).serve()
        journal = await Journal.open(FileJournalFile(folder / f"{name}.journal"), Uuid7Ids())
        node = Idle(Setup(name, CELL))
        servers.append(
            NodeServer(node, bus, lab, journal, SystemClock(), Uuid7Ids(), settle_s=0.0, simulated=True)
        )
    await asyncio.gather(*(server.start() for server in servers))
    # Ends with its parent.
    await asyncio.to_thread(sys.stdin.buffer.read)
    for server in servers:
        await server.close()
    await bus.close()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), int(sys.argv[4]), int(sys.argv[5])))
