"""Two nodes of one name, from two machines, at the same instant: one answers, the other says why not."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator

import pytest

from labos.clock import SystemClock, Uuid7Ids
from labos.errors import NameTaken
from labos.node import Setup
from labos.node.journal import Journal
from labos.node.server import NodeServer
from tests.integration.node.bench import LAB, Arm, Bench
from tests.integration.node.test_node_server import Check, check
from tests.unit.node.memory import MemoryFile

__all__ = ["check"]


class Named:
    """Ids given from outside: the order in which two machines' clocks put them is not to be relied on."""

    def __init__(self, names: Iterator[str]) -> None:
        self._names = names

    def new(self) -> str:
        return next(self._names)


async def server(here: Bench, instance: str, settle_s: float, grace_s: float = 0.3) -> NodeServer:
    """A node with a session, a journal and a device of its own; it waits ``grace_s`` seconds for nodes that
    are going away."""
    journal = await Journal.open(MemoryFile(), Uuid7Ids())
    return NodeServer(
        Arm(Setup("arm", "cell", world=here.world)),
        await here.bus(),
        LAB,
        journal,
        SystemClock(),
        Named(iter([instance])),
        settle_s=settle_s,
        grace_s=grace_s,
    )


@pytest.mark.parametrize("seed", range(4))
def test_of_nodes_that_start_together_one_answers(check: Check, seed: int) -> None:
    async def scenario(here: Bench) -> None:
        rng = random.Random(seed)
        settle_s = 0.1
        names = [f"instance-{n}" for n in range(3)]
        rng.shuffle(names)
        servers = [await server(here, name, settle_s) for name in names]

        async def start(one: NodeServer, after_s: float) -> NodeServer | None:
            await asyncio.sleep(after_s)
            try:
                await one.start()
            except NameTaken:
                return None
            return one

        # Together, and as far apart as it takes to look around.
        apart = rng.choice([0.0, 0.0, settle_s / 2, settle_s, 1.5 * settle_s])
        started = await asyncio.gather(*(start(one, n * apart) for n, one in enumerate(servers)))
        there = [one for one in started if one is not None]
        assert len(there) == 1
        assert (await here.kernel.about()).instance == there[0].instance
        for one in servers:
            await one.close()
        # On a busy machine it takes a while until the router no longer shows those that went.
        last = await server(here, "instance-9", settle_s, grace_s=10)
        await last.start()
        assert (await here.kernel.about()).instance == "instance-9"
        await last.close()

    check(scenario)
