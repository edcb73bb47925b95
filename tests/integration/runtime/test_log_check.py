"""The check of the whole log in the background: what it finds, and that it ends with its lab."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from labos.errors import StoreUnavailable
from labos.runtime.log_check import LogCheck
from labos.store import Damage

Tell = Callable[[int, int], None]


def test_what_it_finds_is_told_once_in_the_loop() -> None:
    async def main() -> tuple[list[tuple[int, str]], LogCheck]:
        told: list[tuple[int, str]] = []

        def check(tell: Tell) -> Damage:
            tell(50, 100)
            return Damage(70, "the payload is not the one that was recorded")

        found = LogCheck(check, lambda position, reason: told.append((position, reason)))
        found.start()
        await found.wait()
        await found.close()
        return told, found

    told, found = asyncio.run(main())
    assert told == [(70, "the payload is not the one that was recorded")]
    assert found.make_view()["damage"].startswith("Position 70: ")


def test_it_ends_with_its_lab_wherever_it_is() -> None:
    async def main() -> LogCheck:
        begun = threading.Event()

        def check(tell: Tell) -> None:
            for number in range(10**9):
                begun.set()
                tell(number, 10**9)

        endless = LogCheck(check, lambda position, reason: None)
        endless.start()
        await asyncio.to_thread(begun.wait)
        await endless.close()
        assert not endless._thread.is_alive()
        return endless

    assert not asyncio.run(main()).done


def test_a_database_that_is_away_is_no_damage() -> None:
    async def main() -> LogCheck:
        def check(tell: Tell) -> None:
            raise StoreUnavailable("The database is away.")

        told: list[int] = []
        away = LogCheck(check, lambda position, reason: told.append(position))
        away.start()
        await away.wait()
        assert told == []
        return away

    found = asyncio.run(main())
    assert not found.done
    assert found.damage == ""
