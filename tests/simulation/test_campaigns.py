"""Campaigns on a bad day: each row becomes exactly one run, whoever is killed when."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence

import pytest

from labos.core.campaigns import Campaign, CampaignCompleted, CampaignSubmitted
from labos.core.decide.campaigns import RefuseRow, SubmitCampaign, SubmitRow
from labos.core.envelope import Record
from labos.core.fold import evolve
from labos.core.registry import decode
from labos.core.runs import RunSubmitted
from labos.core.state import LabState
from labos.core.viewer import Viewer
from labos.http.restricted import RestrictedCampaigns
from labos.runtime.feeder import Feeder
from labos.runtime.kernel import Kernel
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.mixes import PLANS, stand

ROWS = 4
BAD_ROW = 2
A_WEEK_S = 7 * 24 * 3600.0


class Table:
    """A table of which one row fits no workflow; looking at a row takes a while."""

    async def propose(self, campaign: Campaign, row: int) -> SubmitRow | RefuseRow:
        await asyncio.sleep(1.0)
        if row == BAD_ROW:
            return RefuseRow(campaign.id, row, "there is no such well")
        return SubmitRow(campaign.id, row, PLANS["pcr"].plan, {"seal": {"time": float(row)}})


class Facility(SimulatedLab):
    """A lab whose kernels feed campaigns; its user submits one and waits for its end."""

    async def _serve(self, kernel: Kernel) -> None:
        await Feeder(kernel, Table().propose).start()

    async def _act_as_user(self, job: Job) -> None:
        submit = SubmitCampaign(
            *("screen", job.user, "pcr", "rpl", ROWS, "d", "d"),
            request=job.name,
            visibility="private" if job.name == "one" else "lab",
        )
        await self._insist(submit, lambda state: job.name in state.campaigns.requests)
        name = self.fold_log().campaigns.requests[job.name]
        await self._await(lambda state: name not in state.campaigns.open)
        self.done_jobs.add(job.name)


def fold_what_others_see(records: Sequence[Record]) -> tuple[LabState, int]:
    """The state as somebody has it to whom the events of private campaigns are not told, and how many
    these are."""
    restricted = RestrictedCampaigns(None)  # type: ignore[arg-type]  # it is told of all records
    restricted.learn(records)
    viewer, state, hidden = Viewer("eve"), LabState(), 0
    for record in records:
        head = record.head
        if not restricted.shows(viewer, head.type, head.stream, head.correlation):
            hidden += 1
            continue
        evolve(state, decode(head.type, head.schema, record.payload), head.position, head.recorded_at)
    return state, hidden


@pytest.mark.parametrize(
    ("rates", "seeds"),
    [
        pytest.param(STORMY, range(1), id="storm"),
        pytest.param(QUIET, range(2), id="quiet", marks=pytest.mark.full),
        *(
            pytest.param(STORMY, range(first, first + 2), id=f"storms {first}", marks=pytest.mark.full)
            for first in range(1, 21, 2)
        ),
    ],
)
def test_each_row_is_one_run_or_refused_once(rates: FaultRates, seeds: range) -> None:
    kernels = 0
    for seed in seeds:
        lab = Facility(stand(), seed, rates)
        lab.refills = True
        try:
            jobs = [Job("one", "ada", ()), *([Job("two", "bo", ())] if len(seeds) > 1 else [])]
            state = lab.run(jobs, limit_s=A_WEEK_S)
            assert lab.differences(state) == [], f"seed {seed}"
            events = [decode(r.head.type, r.head.schema, r.payload) for r in lab.store.records]
            campaigns = [e.campaign for e in events if isinstance(e, CampaignSubmitted)]
            rows = Counter((e.campaign, e.row) for e in events if isinstance(e, RunSubmitted) and e.campaign)
            wanted = [(name, row) for name in campaigns for row in range(ROWS) if row != BAD_ROW]
            assert rows == Counter(wanted), f"seed {seed}"
            others, hidden = fold_what_others_see(lab.store.records)
            assert hidden > ROWS * 10
            assert others.bench.labware == state.bench.labware, f"seed {seed}"
            levels = {key: level.level for key, level in state.resources.levels.items()}
            assert {key: level.level for key, level in others.resources.levels.items()} == levels
            assert not [c for c in others.campaigns.ended if c in others.campaigns.restricted]
            ends = [e for e in events if isinstance(e, CampaignCompleted)]
            assert [end.refused for end in ends] == [1] * len(jobs)
            assert [end.completed + end.failed + end.cancelled for end in ends] == [ROWS - 1] * len(jobs)
            assert state.campaigns.open == state.campaigns.members == state.campaigns.clocks == {}
            kernels += lab.kernels
        finally:
            lab.close()
    assert kernels > len(seeds) or rates is QUIET
