"""``LABOS_ORDER``: whether a lab looks for an order of all waiting runs."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from labos.bootstrap import open_lab
from labos.errors import BadInput
from labos.settings import Settings


def uses_order(home: Path) -> bool:
    async def ask() -> bool:
        async with open_lab(Settings.make(home)) as lab:
            return lab.kernel.scheduler.adviser.own.is_used

    return asyncio.run(ask())


@pytest.mark.parametrize(("said", "expected"), [("", True), ("age", False), ("search", True)])
def test_a_lab_looks_for_an_order_if_it_is_told_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str, expected: bool
) -> None:
    monkeypatch.setenv("LABOS_ORDER", said)
    assert uses_order(tmp_path / "lab") is expected


def test_another_word_is_refused_and_nothing_is_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LABOS_ORDER", "fifo")
    with pytest.raises(BadInput, match=r"'fifo' is no order of waiting runs\. Write age or search"):
        uses_order(tmp_path / "lab")
    assert not (tmp_path / "lab").exists()
