"""The process that works forecasts out, and what becomes of it when the lab is closed."""

from __future__ import annotations

import asyncio

import pytest

from labos.core.state import LabState, encode_picture
from labos.errors import Refused
from labos.planning.hindsight import LookBack
from labos.planning.lab_forecast import ForecastRequest
from labos.runtime.forecasting import ForecastJob, ForecastProcess
from tests.integration.bus.contract import until


async def ask() -> ForecastJob:
    return ForecastJob(ForecastRequest(encode_picture(LabState()), 1), LookBack())


@pytest.mark.slow
def test_a_lab_that_is_closed_gives_its_forecasts_up() -> None:
    async def body() -> None:
        process = ForecastProcess()
        learned: list[LookBack] = []
        assert (await process.answer(ask, learned.append)).runs == []
        assert len(learned) == 1
        asked = asyncio.create_task(process.answer(ask, learned.append))
        before = process.working
        await until(lambda: process.working is not before, 30.0)
        process.close()
        with pytest.raises(Refused, match="being closed"):
            await asked
        assert process.working is not None
        assert process.working.returncode is not None, "nothing is left behind"
        with pytest.raises(Refused, match="being closed"):
            await process.answer(ask, learned.append)

    asyncio.run(body())
