"""Hides events of restricted campaigns from users who may not see these campaigns.

The restricted campaigns are learned from the log itself, so that every process that sends events knows them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import msgspec

from labos.core.envelope import Record
from labos.core.viewer import RestrictedCampaign, Viewer
from labos.ports import LogQuery

if TYPE_CHECKING:
    # The process for followers starts without this import.
    from labos.services.log import Log

SUBMITTED = "campaign.submitted"

SHOWN = ("labware.", "liquid.", "resource.", "intervention.")
"""The first parts of event types that are never hidden: labware, stock and questions about them concern
everybody who works at the bench."""


class _Submitted(msgspec.Struct, frozen=True):
    """The part of ``CampaignSubmitted`` that determines who sees it."""

    campaign: str
    user: str
    workcell: str
    visibility: Any = "lab"


_decode = msgspec.json.Decoder(_Submitted).decode


class RestrictedCampaigns:
    """The restricted campaigns of a log."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._restricted: dict[str, RestrictedCampaign] = {}
        self._is_read = False
        self._turn = asyncio.Lock()

    def learn(self, records: Iterable[Record]) -> None:
        """Take in the newest records."""
        for record in records:
            if record.head.type == SUBMITTED:
                found = _decode(record.payload)
                if found.visibility != "lab":
                    self._restricted[found.campaign] = RestrictedCampaign(
                        found.user, found.workcell, found.visibility
                    )

    def forget(self) -> None:
        """The log may contain events that this listener did not receive."""
        self._is_read = False

    async def read(self) -> None:
        """Read all campaigns that were ever submitted, once. Raises StoreUnavailable."""
        async with self._turn:
            if not self._is_read:
                self.learn(await asyncio.to_thread(self._read_submitted))
                self._is_read = True

    def _read_submitted(self) -> list[Record]:
        return list(self._log.select(LogQuery(types=(SUBMITTED,))))

    def shows(self, viewer: Viewer | None, type_: str, stream: str, correlation: str) -> bool:
        """Whether an event is shown to a viewer (None: one who sees everything)."""
        if viewer is None or not self._restricted:
            return True
        of = self._restricted.get(correlation) or self._restricted.get(stream)
        return of is None or viewer.sees(of) or type_.startswith(SHOWN)
