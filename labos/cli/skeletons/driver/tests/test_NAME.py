"""NAME under torture: about a minute."""

from __future__ import annotations

import asyncio

from labos.torture import RANKS, torture


def test_survives() -> None:
    report = asyncio.run(torture("NAME", motion_s=0.6))
    assert RANKS.index(report.badge) >= RANKS.index("silver"), report.limits
