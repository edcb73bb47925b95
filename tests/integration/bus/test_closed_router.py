"""A client whose router was closed, and that is still connected to it: it finds the bus again."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from labos.bus import Security, ZenohBus, open_bus
from labos.bus._connection import MISSED, MOST_MISSED, ConnectionCheck, keep_connected
from labos.bus._opening import config_of
from labos.errors import NoAnswer
from labos.node.protocol import ANY_KERNEL, Keys
from labos.pki import Authority, PartyIdentity
from labos.settings import free_port
from tests.integration.bus.contract import KEY, echo, until
from tests.support.cable import Cable


def test_it_connects_again_after_three_checks_and_then_less_and_less_often() -> None:
    check, waits = ConnectionCheck(), []
    for _ in range(7):
        missed = 1
        while not check.note_missed():
            missed += 1
        waits.append(missed)
    assert waits == [MISSED, 6, 12, 24, MOST_MISSED, MOST_MISSED, MOST_MISSED]
    check.note_seen()
    assert [check.note_missed() for _ in range(MISSED)] == [False, False, True]


def test_checks_count_only_in_turn() -> None:
    check = ConnectionCheck()
    for note in (check.note_seen, check.note_uncertain):
        assert not any(check.note_missed() for _ in range(MISSED - 1))
        note()
    assert not any(check.note_missed() for _ in range(MISSED - 1))


def test_the_checks_go_on_after_an_unexpected_error() -> None:
    found: list[bool | Exception] = [RuntimeError("a fault"), *[False] * MISSED]
    reopened = asyncio.Event()

    async def is_router_open() -> bool:
        now = found.pop(0) if found else True
        if isinstance(now, Exception):
            raise now
        return now

    async def reopen() -> None:
        reopened.set()

    async def main() -> None:
        checking = asyncio.create_task(keep_connected(is_router_open, reopen, 0.001))
        await asyncio.wait_for(reopened.wait(), 10)
        checking.cancel()

    asyncio.run(main())


def test_a_client_leaves_a_router_that_was_closed() -> None:
    """The second router is what such a session does: it answers, and shows nothing."""

    async def main() -> None:
        open_port, closed_port = free_port(), free_port()
        closed = open_bare_router(closed_port)
        router = await open_bus(mode="router", listen=[f"tcp/127.0.0.1:{open_port}"])
        kernel = await open_bus(connect=[f"tcp/127.0.0.1:{open_port}"])
        await kernel.serve(KEY, echo)
        seen: list[tuple[str, bool]] = []
        await kernel.watch_alive("labos/lab/@alive/**", lambda key, living: seen.append((key, living)))
        cable = Cable(open_port)
        node = await open_bus(connect=[f"tcp/127.0.0.1:{cable.port}"])
        check_often(node)
        await node.declare_alive("labos/lab/@alive/cell/arm/1")
        assert await node.query(KEY, b"x", 2.0) == b"x!"

        cable.cut()
        cable.target = closed_port
        cable.mend()
        await until(lambda: find_router(node) == str(closed.zid()))
        with pytest.raises(NoAnswer):
            await node.query(KEY, b"x", 2.0)
        cable.target = open_port  # for new connections
        await until(lambda: find_router(node) not in ("", str(closed.zid())), 20.0)
        await until_answered(node, KEY)
        await until(lambda: bool(seen) and seen[-1] == ("labos/lab/@alive/cell/arm/1", True))
        for bus in (node, kernel, router):
            await bus.close()
        closed.close()

    asyncio.run(main())


def test_a_client_stays_with_a_router_of_another_kind() -> None:
    """Zenoh's own router shows no key. It is left only by a client that has not received anything."""

    async def main() -> None:
        port = free_port()
        other = open_bare_router(port)
        async with a_client(port) as kernel, a_client(port) as node:
            assert await node._is_router_open() is False
            await kernel.serve(KEY, echo)
            assert await node.query(KEY, b"x", 2.0) == b"x!"
            assert await node._is_router_open() is None
            other.close()
            await until(lambda: not find_router(kernel))
            assert await kernel._is_router_open() is None

    asyncio.run(main())


def test_the_connection_of_a_client_is_in_order() -> None:
    async def main() -> None:
        port = free_port()
        router = await open_bus(mode="router", listen=[f"tcp/127.0.0.1:{port}"])
        async with a_client(port) as node:
            assert await node._is_router_open() is True
            await router.reopen(None)
            await until(lambda: find_router(node) == str(router._session.zid()))
            # The connection is new: for some milliseconds the client answers itself, without the key.
            async with asyncio.timeout(5.0):
                while not await node._is_router_open():
                    pass
            assert [await node._is_router_open() for _ in range(50)] == [True] * 50
        await router.close()

    asyncio.run(main())


@pytest.mark.slow
@pytest.mark.full
@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", range(6))
def test_a_secure_bus_that_is_opened_again_many_times(seed: int, tmp_path: Path) -> None:
    """At instants when clients are about to connect. Kernel and node find each other after each burst."""
    lab, module = "lab-1", "cell/arm"
    keys, rng = Keys(lab), random.Random(seed)
    who = [PartyIdentity("bus"), PartyIdentity("kernel", lab=lab), PartyIdentity("node", module, lab)]

    async def main() -> None:
        authority = Authority(tmp_path / "pki")
        authority.init("test")
        authority.issue(who[0], addresses=["127.0.0.1"])
        for party in who[1:]:
            authority.issue(party)
        endpoint = f"tls/127.0.0.1:{free_port()}"
        rights = Security(authority.credentials(who[0]), authority.read_members().admitted)
        router = await open_bus(mode="router", listen=[endpoint], security=rights)
        kernel, node = [
            await open_bus(connect=[endpoint], security=Security(authority.credentials(party)))
            for party in who[1:]
        ]
        await kernel.serve_all(keys.all_setups, answer)
        await kernel.declare_alive(keys.kernel)
        living: dict[str, bool] = {}
        await node.watch_alive(ANY_KERNEL, living.__setitem__)
        for _ in range(80):
            for _ in range(rng.choice([1, 2, 2, 3, 4])):
                await router.reopen(rights)
                # A client that was cut off connects again after 0.2 s.
                first, more = rng.choice([(0.0, 0.05), (0.15, 0.15), (0.2, 0.02), (0.4, 0.4)])
                await asyncio.sleep(first + more * rng.random())
            await until_answered(node, keys.setup_of(module))
            await until(lambda: living == {keys.kernel: True}, 40.0)
        for bus in (node, kernel, router):
            await bus.close()

    asyncio.run(main())


async def answer(key: str, _: bytes) -> bytes:
    return key.encode()


async def until_answered(bus: ZenohBus, key: str) -> None:
    """A query just after a connection may have no answer yet."""
    async with asyncio.timeout(40.0):
        while True:
            try:
                await bus.query(key, b"", 1.0)
                return
            except NoAnswer:
                await asyncio.sleep(0.05)


def open_bare_router(port: int) -> Any:
    return zenoh.open(config_of("router", [f"tcp/127.0.0.1:{port}"], (), None))


def find_router(bus: ZenohBus) -> str:
    """The router to which a client is connected; empty while it is not."""
    try:
        return next(iter(map(str, bus._session.info.routers_zid())), "")
    except zenoh.ZError:  # the session is being opened again
        return ""


def check_often(bus: ZenohBus) -> None:
    assert bus._keeping is not None
    bus._keeping.cancel()
    bus.keep_connected(0.05)


@asynccontextmanager
async def a_client(port: int) -> AsyncIterator[ZenohBus]:
    bus = await open_bus(connect=[f"tcp/127.0.0.1:{port}"])
    try:
        yield bus
    finally:
        await bus.close()
