"""The adapter of WEI's REST nodes, with real nodes of ``ad_sdl.wei`` 0.7.4."""

from __future__ import annotations

from tests.integration.adapter.bench import Bench
from tests.integration.adapter.contract import Contract


class TestWei(Contract):
    kind = "wei"
    version = "1.2"
    startup_words = b"/action"

    async def see_lost(self, here: Bench, action: str) -> None:
        """WEI has no ids and no history: it runs, and then nobody can say how it ended."""
        told = await here.status(action, "interrupted")
        assert "WEI keeps no record" in told.why
