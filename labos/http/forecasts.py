"""Forecasts of the present lab: of its queue, and of submissions that are only planned."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from labos.core.decide.campaigns import SubmitCampaign, SubmitRow
from labos.core.decide.composites import SubmitWithLabware
from labos.core.decide.runs import SubmitRun
from labos.core.ids import CampaignId
from labos.core.model import Plan
from labos.core.state import encode_picture, fold_fingerprint
from labos.http.campaign_rows import CampaignRows
from labos.planning.hindsight import Hindsight, LookBack, Row
from labos.planning.lab_forecast import ForecastRequest, LabForecast
from labos.runtime.forecasting import ForecastJob, ForecastProcess

if TYPE_CHECKING:
    from labos.http.service import LabService

LOOKED_BACK = 200_000
"""For a longer log, the errors of forecasts are measured only on events after its snapshot."""

ROWS_READ = 100_000
"""At most so many records are read for one forecast; the others are read with the next one."""

ROWS_PLANNED = 3
"""The number of planned rows of a known campaign; their plans stand for all of its rows."""

FRESH_S = 10.0
"""So long a forecast of the queue is used for all requests, if there are no new events."""


class Forecasts:
    """Makes forecasts. Reads the part of the log that it has not learned from yet."""

    def __init__(self, service: LabService) -> None:
        self._service = service
        self._process = ForecastProcess()
        self._known: LookBack | None = None
        self._rows = CampaignRows(service)
        self._queue: LabForecast | None = None
        self._queue_at: tuple[int, float] = (-1, 0.0)
        self._turn = asyncio.Lock()

    def close(self) -> None:
        """Forecasts that are being computed are stopped."""
        self._process.close()

    async def queue(self) -> LabForecast:
        """The forecast of everything that is submitted. Raises Refused."""
        async with self._turn:
            position, clock = self._service.kernel.state.position, self._service.parts.clock
            now_s = clock.monotonic()
            known_at, since_s = self._queue_at
            if self._queue is None or known_at != position or now_s - since_s > FRESH_S:
                self._queue = await self.forecast()
                self._queue_at = (position, clock.monotonic())
            return self._queue

    async def forecast(
        self,
        new: SubmitRun | SubmitWithLabware | SubmitCampaign | None = None,
        actor: str = "",
        new_rows: list[tuple[Plan, ...]] | None = None,
        approved: str = "",
    ) -> LabForecast:
        """The forecast of the lab with a new run, or with a new campaign whose rows choose between the plans
        ``new_rows``, or with the approval of the proposal ``approved``. Raises Refused."""
        rows = await self._plan_rows()
        kernel = self._service.kernel

        async def ask() -> ForecastJob:
            known, records = await asyncio.to_thread(self._read, kernel.durable)
            own = kernel.scheduler.adviser.own
            request = ForecastRequest(
                picture=encode_picture(kernel.state),
                now=kernel.clock.now_ns(),
                rows=rows,
                new=new,
                actor=actor,
                new_rows=new_rows or [],
                approved=approved,
                orders=own.known if own.is_used else None,
            )
            return ForecastJob(request, known, records)

        def keep(known: LookBack) -> None:
            self._known = known

        return await self._process.answer(ask, keep)

    def _read(self, upto: int) -> tuple[LookBack, list[Row]]:
        """The errors of past forecasts, and the records that have not been used for them yet."""
        log = self._service.parts.store
        known = self._known
        if known is None:
            known = LookBack()
            found = log.load_snapshot(fold_fingerprint()) if upto > LOOKED_BACK else None
            if found is not None:
                known = LookBack(Hindsight(position=found[0]), found[2])
        after = known.hindsight.position
        return known, list(log.replay(after, min(upto, after + ROWS_READ)))

    async def _plan_rows(self) -> dict[CampaignId, list[tuple[Plan, ...]]]:
        """Plans of the next rows of the campaigns in progress."""
        found: dict[CampaignId, list[tuple[Plan, ...]]] = {}
        for campaign in list(self._service.kernel.state.campaigns.open.values()):
            for row in range(campaign.next_row, min(campaign.rows, campaign.next_row + ROWS_PLANNED)):
                command = await self._rows.propose(campaign, row)
                if isinstance(command, SubmitRow):
                    found.setdefault(campaign.id, []).append((command.plan, *command.others))
        return found
