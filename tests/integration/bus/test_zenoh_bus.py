"""The Zenoh bus, as clients of one router, and as router and client."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, AbstractContextManager, asynccontextmanager
from pathlib import Path

import pytest

from labos.bus import ZenohBus, open_bus
from labos.errors import BusError, NoAnswer
from labos.ports import Bus
from tests.integration.bus.contract import KEY, BusContract, echo, until
from tests.integration.ports import free_endpoint
from tests.support.processes import run_process


class TestTwoClients(BusContract):
    @asynccontextmanager
    async def pair(self) -> AsyncIterator[tuple[Bus, Bus]]:
        endpoint = free_endpoint()
        async with router(endpoint), client(endpoint) as one, client(endpoint) as other:
            yield one, other


class TestClientAndRouter(BusContract):
    @asynccontextmanager
    async def pair(self) -> AsyncIterator[tuple[Bus, Bus]]:
        endpoint = free_endpoint()
        async with router(endpoint) as hub, client(endpoint) as one:
            yield one, hub


def router(endpoint: str) -> AbstractAsyncContextManager[ZenohBus]:
    return open_at("router", endpoint)


def client(endpoint: str) -> AbstractAsyncContextManager[ZenohBus]:
    return open_at("client", endpoint)


@asynccontextmanager
async def open_at(mode: str, endpoint: str) -> AsyncIterator[ZenohBus]:
    if mode == "router":
        bus = await open_bus(mode="router", listen=[endpoint])
    else:
        bus = await open_bus(connect=[endpoint])
    try:
        yield bus
    finally:
        await bus.close()


# -- opening -----------------------------------------------------------------------------------


def test_an_address_in_use_is_named_with_a_remedy() -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        async with router(endpoint):
            with pytest.raises(BusError, match=rf"{endpoint}.* already in use\. Stop the other process"):
                await open_bus(mode="router", listen=[endpoint])

    asyncio.run(main())


def test_a_client_without_a_router_is_told_at_once() -> None:
    endpoint = free_endpoint()
    began = time.monotonic()
    with pytest.raises(BusError, match=rf"Nobody answers at {endpoint}\. Start the lab"):
        asyncio.run(open_bus(connect=[endpoint]))
    assert time.monotonic() - began < 2.0


@pytest.mark.parametrize("endpoint", ["nonsense", "pigeon/roof"])
def test_an_endpoint_that_is_none(endpoint: str) -> None:
    with pytest.raises(BusError) as caught:
        asyncio.run(open_bus(mode="router", listen=[endpoint]))
    assert endpoint in str(caught.value)
    assert ".cargo" not in str(caught.value)


def test_a_peer_waits_for_the_other_to_come() -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        peer = await open_bus(mode="peer", connect=[endpoint])
        try:
            await peer.serve(KEY, echo)
            async with router(endpoint) as hub:
                await await_answer(hub)
        finally:
            await peer.close()

    asyncio.run(main())


def test_a_router_that_restarts_is_found_again() -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        hub = await open_bus(mode="router", listen=[endpoint])
        async with client(endpoint) as node:
            await node.serve(KEY, echo)
            await node.declare_alive("labos/lab/@alive/cell/arm/1")
            assert await hub.query(KEY, b"", 2.0) == b"!"
            await hub.close()
            async with router(endpoint) as hub:
                await await_answer(hub)
                seen: list[bool] = []
                await hub.watch_alive("labos/lab/@alive/**", lambda key, living: seen.append(living))
                await until(lambda: seen == [True])

    asyncio.run(main())


async def await_answer(bus: Bus, timeout_s: float = 10.0) -> None:
    """Wait until somebody answers."""

    async def ask() -> None:
        while True:
            try:
                await bus.query(KEY, b"", 0.5)
                return
            except NoAnswer:
                await asyncio.sleep(0.02)

    await asyncio.wait_for(ask(), timeout_s)


def test_only_one_of_two_nodes_of_one_name_is_asked() -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        asked: list[bytes] = []

        async def handle(payload: bytes) -> bytes:
            asked.append(payload)
            return payload

        async with (
            router(endpoint) as hub,
            client(endpoint) as one,
            client(endpoint) as other,
            client(endpoint) as asker,
        ):
            await one.serve(KEY, handle)
            await other.serve(KEY, handle)
            for _ in range(20):
                await hub.query(KEY, b"x", 2.0)
                await asker.query(KEY, b"x", 2.0)
            # Whatever went to a second one was sent before the first one's answer.
            await asyncio.gather(one.query("labos/nobody", b"", 0.1), return_exceptions=True)
            assert len(asked) == 40

    asyncio.run(main())


# -- other processes ---------------------------------------------------------------------------

LIVING = """
import asyncio, sys
from labos.bus import open_bus
async def main():
    bus = await open_bus(connect=[sys.argv[1]])
    token = await bus.declare_alive("labos/lab/@alive/cell/arm/1")
    await asyncio.sleep(60)
asyncio.run(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGSTOP")
@pytest.mark.parametrize(("how", "within_s"), [("SIGKILL", 1.0), ("SIGSTOP", 4.0)])
def test_a_process_that_dies_or_freezes_is_noticed(how: str, within_s: float) -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        seen: list[bool] = []
        async with router(endpoint) as hub:
            await hub.watch_alive("labos/lab/@alive/**", lambda key, living: seen.append(living))
            with python(LIVING, endpoint) as process:
                await until(lambda: seen == [True], 10.0)
                os.kill(process.pid, getattr(signal, how))
                await until(lambda: seen == [True, False], within_s)

    asyncio.run(main())


FORGETFUL = """
import asyncio, sys
from labos.bus import open_bus
async def echo(payload): return payload
async def main():
    global kept
    kept = bus = await open_bus(mode="router", listen=[sys.argv[1]])
    await bus.serve("labos/a", echo)
    await bus.watch_alive("labos/**", lambda key, living: None)
    await bus.query("labos/a", b"", 1.0)
asyncio.run(main())
sys.exit(7)
"""


def test_a_bus_that_nobody_closed_does_not_keep_the_process() -> None:
    with python(FORGETFUL, free_endpoint()) as process:
        assert process.wait(10.0) == 7


def python(code: str, *args: str) -> AbstractContextManager[subprocess.Popen[bytes]]:
    here = Path(__file__).parents[3]
    return run_process([sys.executable, "-c", code, *args], cwd=here)
