"""What every bus must do. A subclass says how to get two that are connected."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import AbstractAsyncContextManager
from typing import Any

import pytest

from labos.errors import BusError, NoAnswer
from labos.ports import Bus

KEY = "labos/lab/cell/arm/action"


async def until(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    """Wait until something holds, and fail the test if it does not in time."""

    async def poll() -> None:
        while not condition():  # noqa: ASYNC110 - any condition, not an event
            await asyncio.sleep(0.002)

    await asyncio.wait_for(poll(), timeout_s)


class BusContract:
    """Inherit, and implement ``pair``."""

    def pair(self) -> AbstractAsyncContextManager[tuple[Bus, Bus]]:
        """Two connected buses, closed at the end."""
        raise NotImplementedError

    def run(self, coroutine: Coroutine[Any, Any, None]) -> None:
        asyncio.run(coroutine)

    def check(self, scenario: Callable[[Bus, Bus], Awaitable[None]]) -> None:
        async def main() -> None:
            async with self.pair() as (one, other):
                await scenario(one, other)

        self.run(main())

    # -- queries -----------------------------------------------------------------------------

    def test_a_query_is_answered_by_whoever_serves_the_key(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            await one.serve(KEY, echo)
            assert await other.query(KEY, b"hello", 2.0) == b"hello!"
            assert await one.query(KEY, b"", 2.0) == b"!"

        self.check(scenario)

    def test_served_means_that_others_can_ask_at_once(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            for n in range(30):
                await one.serve(f"labos/lab/cell/m{n}/about", echo)
                assert await other.query(f"labos/lab/cell/m{n}/about", b"x", 2.0) == b"x!"

        self.check(scenario)

    def test_nobody_serves_the_key(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            with pytest.raises(NoAnswer):
                await one.query(KEY, b"", 0.5)

        self.check(scenario)

    def test_a_handler_that_is_too_slow(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            finished = asyncio.Event()

            async def slow(payload: bytes) -> bytes:
                await asyncio.sleep(0.5)
                finished.set()
                return b"late"

            await one.serve(KEY, slow)
            with pytest.raises(NoAnswer):
                await other.query(KEY, b"", 0.1)
            # No answer says nothing about whether it was done.
            await asyncio.wait_for(finished.wait(), 2.0)

        self.check(scenario)

    def test_a_handler_that_raises_gives_no_answer_and_serves_on(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            async def moody(payload: bytes) -> bytes:
                if payload == b"bad":
                    raise RuntimeError("the moon is full")
                return payload

            await one.serve(KEY, moody)
            with pytest.raises(NoAnswer):
                await other.query(KEY, b"bad", 2.0)
            assert await other.query(KEY, b"good", 2.0) == b"good"

        self.check(scenario)

    def test_queries_are_served_beside_each_other(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            all_here = asyncio.Event()
            here: list[bytes] = []

            async def wait_for_all(payload: bytes) -> bytes:
                here.append(payload)
                if len(here) == 20:
                    all_here.set()
                await all_here.wait()
                return payload

            await one.serve(KEY, wait_for_all)
            asked = [str(n).encode() for n in range(20)]
            assert await asyncio.gather(*(other.query(KEY, q, 5.0) for q in asked)) == asked

        self.check(scenario)

    def test_only_one_of_two_servers_of_a_key_is_asked(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            asked: list[str] = []

            def server(name: str) -> Callable[[bytes], Awaitable[bytes]]:
                async def handle(payload: bytes) -> bytes:
                    asked.append(name)
                    return payload

                return handle

            await one.serve(KEY, server("one"))
            await other.serve(KEY, server("other"))
            for _ in range(10):
                await one.query(KEY, b"x", 2.0)
                await other.query(KEY, b"x", 2.0)
            assert len(asked) == 20

        self.check(scenario)

    def test_large_payloads_arrive_whole(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            await one.serve(KEY, echo)
            payload = bytes(range(256)) * 4096
            assert await other.query(KEY, payload, 5.0) == payload + b"!"

        self.check(scenario)

    def test_what_was_closed_is_not_served(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            handle = await one.serve(KEY, echo)
            await other.query(KEY, b"", 2.0)
            handle.close()
            handle.close()
            with pytest.raises(NoAnswer):
                await other.query(KEY, b"", 0.3)

        self.check(scenario)

    # -- publications ------------------------------------------------------------------------

    def test_publications_reach_subscribers_in_order(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            heard: list[tuple[str, bytes]] = []
            await other.subscribe("labos/lab/*/*/state", lambda key, payload: heard.append((key, payload)))
            sent = [("labos/lab/cell/arm/state", str(n).encode()) for n in range(500)]
            for key, payload in sent:
                await one.publish(key, payload)
            await one.publish("labos/lab/cell/arm/result/7", b"not subscribed")
            await until(lambda: len(heard) >= 500)
            assert heard == sent

        self.check(scenario)

    def test_a_publisher_hears_itself(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            heard: list[bytes] = []
            await one.subscribe("labos/lab/**", lambda key, payload: heard.append(payload))
            await one.publish("labos/lab/cell/arm/state", b"x")
            await until(lambda: heard == [b"x"])

        self.check(scenario)

    def test_a_listener_that_raises_hears_the_next(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            heard: list[bytes] = []

            def listener(key: str, payload: bytes) -> None:
                heard.append(payload)
                if payload == b"bad":
                    raise RuntimeError("the moon is full")

            await other.subscribe(KEY, listener)
            await one.publish(KEY, b"bad")
            await one.publish(KEY, b"good")
            await until(lambda: heard == [b"bad", b"good"])

        self.check(scenario)

    def test_a_closed_subscription_hears_nothing(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            first: list[bytes] = []
            second: list[bytes] = []
            handle = await other.subscribe(KEY, lambda key, payload: first.append(payload))
            await other.subscribe(KEY, lambda key, payload: second.append(payload))
            handle.close()
            await one.publish(KEY, b"x")
            await until(lambda: second == [b"x"])
            assert first == []

        self.check(scenario)

    # -- liveliness --------------------------------------------------------------------------

    def test_the_living_are_told_when_the_watch_begins(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            await one.declare_alive("labos/lab/@alive/cell/arm/1")
            seen: list[tuple[str, bool]] = []
            await other.watch_alive("labos/lab/@alive/*/*/*", lambda key, living: seen.append((key, living)))
            await until(lambda: seen == [("labos/lab/@alive/cell/arm/1", True)])

        self.check(scenario)

    def test_coming_and_going_is_told_once(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            seen: list[tuple[str, bool]] = []
            await other.watch_alive(
                "labos/lab/@alive/cell/arm/*", lambda key, living: seen.append((key, living))
            )
            await one.declare_alive("labos/lab/@alive/cell/other/1")
            handle = await one.declare_alive("labos/lab/@alive/cell/arm/1")
            await until(lambda: len(seen) == 1)
            handle.close()
            await until(lambda: len(seen) == 2)
            assert seen == [("labos/lab/@alive/cell/arm/1", True), ("labos/lab/@alive/cell/arm/1", False)]

        self.check(scenario)

    def test_a_bus_that_closes_takes_its_tokens_and_keys_along(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            seen: list[bool] = []
            await other.watch_alive("labos/lab/@alive/**", lambda key, living: seen.append(living))
            await one.declare_alive("labos/lab/@alive/cell/arm/1")
            await one.serve(KEY, echo)
            await until(lambda: seen == [True])
            await one.close()
            await until(lambda: seen == [True, False])
            with pytest.raises(NoAnswer):
                await other.query(KEY, b"", 0.3)

        self.check(scenario)

    # -- the end -----------------------------------------------------------------------------

    def test_closing_twice_is_no_error_and_a_closed_bus_refuses(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            await one.close()
            await one.close()
            with pytest.raises(BusError):
                await one.query(KEY, b"", 0.1)
            with pytest.raises(BusError):
                await one.publish(KEY, b"")

        self.check(scenario)

    def test_keys_and_wildcards_that_mean_nothing_are_refused(self) -> None:
        async def scenario(one: Bus, other: Bus) -> None:
            with pytest.raises(BusError):
                await one.query("labos//x", b"", 0.1)
            with pytest.raises(BusError):
                await one.serve("labos//x", echo)

        self.check(scenario)


async def echo(payload: bytes) -> bytes:
    return payload + b"!"
