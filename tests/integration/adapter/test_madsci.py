"""The adapter of MADSci's REST nodes, with real nodes of ``madsci-node-module`` 0.8.1."""

from __future__ import annotations

from tests.integration.adapter.bench import Bench
from tests.integration.adapter.contract import Contract


class TestMadsci(Contract):
    kind = "madsci"
    startup_words = b"/start"
    version = "0.0.1"  # of the node definition, which the class does not change

    async def see_lost(self, here: Bench, action: str) -> None:
        """The node knows the action by its id: it is asked, and nothing is guessed."""
        outcome = await here.outcome(action)
        assert (outcome.succeeded, outcome.effects) == (True, "all")
