"""A lab whose log was damaged does not start anything because of it, wherever the damage stands."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from labos.bootstrap import descriptions, open_lab
from labos.core.lab import WHOLE_LAB
from labos.errors import LogDamaged
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.store import find_first_damage, open_store
from tests.integration.store.records import flip, raw


def settings(home: Path) -> Settings:
    return Settings.make(home, f"sqlite:///{home / 'labos.db'}", speed=1000.0, simulate=True)


async def live(home: Path) -> None:
    """A lab is set up and closed in order: it keeps a snapshot."""
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    async with open_lab(settings(home), workcells=[cell]) as lab:
        assert lab.log_check is not None
        await lab.log_check.wait()
        assert lab.log_check.make_view() == {
            "checked": lab.log_check.total,
            "of": lab.log_check.total,
            "done": True,
            "damage": "",
        }


@pytest.mark.parametrize("position", [3, 12])
def test_damage_below_the_snapshot_is_found_in_the_background_and_stops_starts(
    tmp_path: Path, position: int
) -> None:
    asyncio.run(live(tmp_path))
    with raw(settings(tmp_path).database) as database:
        database.disarm()
        flip("payload", position, 5)(database)

    async def again() -> tuple[str, str]:
        async with open_lab(settings(tmp_path)) as lab:
            assert lab.log_check is not None
            await lab.log_check.wait()
            return lab.kernel.state.lab.paused[WHOLE_LAB].why, lab.log_check.damage

    why, found = asyncio.run(again())
    assert f"damaged at position {position}: the payload" in why
    assert found.startswith(f"Position {position}: ")


def test_damage_behind_the_snapshot_keeps_the_lab_from_opening(tmp_path: Path) -> None:
    asyncio.run(live(tmp_path))
    url = settings(tmp_path).database
    with raw(url) as database:
        database.disarm()
        database.run("UPDATE snapshot SET digest = 'another'")
        flip("payload", 5, 5)(database)
    store = open_store(url)
    before = store.head()
    store.close()

    async def again() -> None:
        async with open_lab(settings(tmp_path)):
            pass

    with pytest.raises(LogDamaged, match="position 5 "):
        asyncio.run(again())
    store = open_store(url)
    assert store.head().position == before.position, "nothing was written"
    assert find_first_damage(store) is not None
    store.close()
