"""Turns the rows of campaigns into runs, a few at a time.

It only proposes rows. The core decides, by the present state, whether a row is the next one and whether there
is room for it. So the feeder stores nothing, and may be killed at any moment.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence

import structlog

from labos.core.campaigns import Campaign, CampaignEvent
from labos.core.decide import Rejection
from labos.core.decide.campaigns import RefuseRow, SubmitRow, SubmitRows
from labos.core.quotas import explain_full_queue
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunStarted
from labos.core.shares import SharesApplied
from labos.core.users import GroupEvent
from labos.errors import StoreError
from labos.runtime.kernel import Kernel
from labos.runtime.ledger import Entry
from labos.runtime.tasks import KernelPart

MAKES_ROOM = (
    *(CampaignEvent, SharesApplied, GroupEvent),
    *(RunStarted, RunCompleted, RunFailed, RunCancelled),
)
"""Events after which a campaign may submit a further row."""

RETRY_S = 5.0
"""How long to wait after a row could not be read, for example because the disk with the table is away."""

_log = structlog.get_logger(__name__)


Propose = Callable[[Campaign, int], Awaitable[SubmitRow | RefuseRow]]


class Feeder(KernelPart):
    """Proposes rows as long as there is room. One for each kernel. ``propose`` makes the command that submits
    a row of a campaign, or that says why this is impossible; an error that it raises counts as temporary."""

    def __init__(self, kernel: Kernel, propose: Propose) -> None:
        super().__init__(kernel)
        self._propose = propose
        self._bell = asyncio.Event()

    async def start(self) -> None:
        await super().start()
        self._bell.set()
        self._tasks.spawn(self._feed())

    def on_committed(self, entries: Sequence[Entry]) -> None:
        if any(isinstance(entry.event, MAKES_ROOM) for entry in entries):
            self._bell.set()

    def on_reopened(self) -> None:
        self._bell.set()

    async def _feed(self) -> None:
        while True:
            await self._bell.wait()
            self._bell.clear()
            try:
                while await self._propose_round():
                    pass
            except StoreError:
                continue  # called again when the log has been read again
            except Exception as error:
                _log.warning("row_not_looked_at", why=repr(error))
                asyncio.get_running_loop().call_later(RETRY_S, self._bell.set)

    async def _propose_round(self) -> bool:
        """Propose the rows of each campaign for which there is room, in one command: the lab knows all of
        them before the first one starts. Returns whether any was accepted."""
        taken = False
        for name in list(self._kernel.state.campaigns.open):
            state = self._kernel.state
            campaign = state.campaigns.open.get(name)
            if campaign is None:
                continue
            first, rows = campaign.next_row, list[SubmitRow | RefuseRow]()
            while len(rows) < campaign.room and not explain_full_queue(state, campaign.user, len(rows)):
                rows.append(await self._propose(campaign, first + len(rows)))
            answer = self._kernel.submit(SubmitRows(tuple(rows)), "labos") if rows else []
            taken = taken or (not isinstance(answer, Rejection) and bool(answer))
        return taken
