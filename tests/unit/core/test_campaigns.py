"""Campaigns: row after row, each once, as long as their terms allow."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.campaigns import ROWS_QUEUED, Budget, Campaign, CampaignCancelled, Terms
from labos.core.conditions import make_condition
from labos.core.decide import Rejection
from labos.core.decide.campaigns import (
    AmendCampaign,
    ArchiveCampaign,
    CancelCampaign,
    PauseCampaign,
    RefuseRow,
    ResumeCampaign,
    SubmitCampaign,
    SubmitRow,
    SubmitRows,
)
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.lab import StartKernel
from labos.core.expressions import parse_expression
from labos.core.ids import CampaignId, RunId
from labos.core.model import Condition, Plan
from labos.core.state import encode_picture
from tests.support.bench import consumes, plan, small, step

READ = plan(step("dev", key="read", duration_s=600.0), name="read")
C1 = CampaignId("C1")


def until(text: str) -> Condition:
    return make_condition(text, parse_expression(text))


class Lab:
    """A lab with one campaign."""

    def __init__(self, rows: int = 10, what: Plan = READ, **terms: Any) -> None:
        self.lab = small()
        self.lab.level("dev", "tips", 1000.0, 1000.0)
        self.what = what
        command = SubmitCampaign("screen", "ada", "read", "cell", rows, "t", "d", Terms(**terms), "key")
        self.lab.do(command)
        assert self.lab.do(command) == []

    @property
    def campaign(self) -> Campaign:
        return self.lab.state.campaigns.open[C1]

    def row(self, number: int) -> SubmitRow:
        return SubmitRow(C1, number, self.what, {"row": number})

    def feed(self) -> list[str]:
        """Submit rows as long as there is room."""
        first = self.lab.state.runs.named
        while C1 in self.lab.state.campaigns.open and self.campaign.room:
            answer = self.lab.ask(self.row(self.campaign.next_row))
            if isinstance(answer, Rejection):
                assert answer.code == "no_room"
                break
        return [f"R{number + 1}" for number in range(first, self.lab.state.runs.named)]

    def work(self, result: Any = None) -> None:
        """The oldest run is carried out."""
        run = next(iter(self.campaign.runs))
        action = self.lab.start(run)
        self.lab.wait(600.0)
        self.lab.finish(action, result)

    def to_the_end(self) -> None:
        while C1 in self.lab.state.campaigns.open:
            self.feed()
            if C1 in self.lab.state.campaigns.open:
                self.work()


def test_all_rows_become_runs_and_only_a_few_wait() -> None:
    lab = Lab(rows=10)
    assert lab.feed() == ["R1", "R2", "R3", "R4"]
    assert lab.lab.reject(lab.row(4)).code == "no_room"
    assert len(lab.lab.state.runs.queued) == ROWS_QUEUED
    lab.work()
    assert lab.feed() == ["R5"]
    lab.to_the_end()
    end = lab.lab.log[-1].event
    assert (end.TYPE, end.completed, end.left) == ("campaign.completed", 10, 0)  # type: ignore[attr-defined]
    assert lab.lab.types().count("run.submitted") == 10


@pytest.mark.parametrize("row", [1, 2, -1, 10])
def test_only_the_next_row_is_taken(row: int) -> None:
    lab = Lab()
    assert lab.lab.reject(lab.row(row)).code == "not_next"
    lab.lab.do(lab.row(0))
    assert lab.lab.reject(lab.row(0)).code == "not_next"
    assert lab.lab.reject(RefuseRow(C1, 0, "no")).code == "not_next"


def test_a_row_that_fits_no_lab_is_refused_and_the_next_one_is_taken() -> None:
    lab = Lab(rows=2)
    nowhere = SubmitRow(C1, 0, plan(step("nothing", key="read")))
    (event,) = lab.lab.do(nowhere)
    assert event.TYPE == "campaign.row_refused"
    assert "nothing" in event.why  # type: ignore[attr-defined]
    lab.to_the_end()
    assert lab.lab.log[-1].event.refused == 1  # type: ignore[attr-defined]


def test_a_paused_campaign_starts_nothing_and_goes_on_where_it_was() -> None:
    lab = Lab()
    lab.feed()
    lab.lab.start("R1")
    lab.lab.do(PauseCampaign(C1, "tea"))
    assert lab.lab.do(PauseCampaign(C1)) == []
    assert [lab.lab.code(run) for run in ("R2", "R3", "R4")] == ["paused"] * 3
    assert lab.lab.reject(lab.row(4)).code == "not_open"
    lab.lab.do(ResumeCampaign(C1))
    assert not any(run.paused for run in lab.lab.state.runs.queued.values())
    assert lab.feed() == ["R5"]


def test_its_stop_rule_ends_it_by_the_results_of_a_run() -> None:
    lab = Lab(until=until("steps.read.od > 0.5"))
    lab.feed()
    lab.work({"od": 0.4})
    lab.work(None)  # it cannot be decided, and is not met
    assert lab.campaign.status == "open"
    lab.work({"od": 0.6})
    event = lab.lab.log[-1].event
    assert (event.TYPE, event.completed, event.cancelled, event.left) == ("campaign.completed", 3, 1, 6)  # type: ignore[attr-defined]
    assert "Its stop rule holds for R3: steps.read.od > 0.5." in event.why  # type: ignore[attr-defined]


@pytest.mark.parametrize(("stop_after", "done"), [(0, 5), (1, 1), (3, 3)])
def test_so_many_runs_may_fail(stop_after: int, done: int) -> None:
    lab = Lab(rows=5, stop_after=stop_after)
    while C1 in lab.lab.state.campaigns.open:
        lab.feed()
        lab.lab.fail(lab.lab.start(next(iter(lab.campaign.runs))), "none")
    assert lab.lab.log[-1].event.failed == done  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("budget", "runs"),
    [
        (Budget(runs=3), 3),
        (Budget(lab_time_s=1800.0), 3),
        (Budget(lab_time_s=1799.0), 2),
        (Budget(consumables={"tips": 20.0}), 2),
        (Budget(consumables={"lids": 1.0}), 10),
        (Budget(runs=100, lab_time_s=1e9), 10),
    ],
)
def test_it_ends_where_another_run_would_be_beyond_its_budget(budget: Budget, runs: int) -> None:
    what = plan(step("dev", consumes("tips", 8.0), key="read", duration_s=600.0), name="read")
    lab = Lab(what=what, budget=budget)
    lab.to_the_end()
    assert lab.lab.log[-1].event.completed == runs  # type: ignore[attr-defined]


def test_runs_that_take_less_than_planned_leave_room_for_others() -> None:
    lab = Lab(what=plan(step("dev", key="read", duration_s=1200.0)), budget=Budget(lab_time_s=2400.0))
    lab.to_the_end()  # each takes 600 s
    assert lab.lab.log[-1].event.completed == 3  # type: ignore[attr-defined]


def test_a_cancelled_one_cancels_its_runs_and_nobody_elses() -> None:
    lab = Lab()
    other = lab.lab.submit(READ, "bo")
    lab.feed()
    lab.lab.do(CancelCampaign(C1, why="wrong plate"))
    assert lab.lab.log[-1].event.TYPE == "campaign.completed"
    assert lab.lab.state.runs.get(other) is not None
    assert lab.lab.state.campaigns.members == {}
    assert lab.lab.reject(CancelCampaign(C1)).code == "no_campaign"


def test_other_terms_hold_from_now_on() -> None:
    lab = Lab(until=until("steps.read.od > 5"))
    lab.feed()
    assert (
        lab.lab.reject(AmendCampaign(C1, Terms(until=until("steps.weigh.g > 5")))).code == "until_reads_more"
    )
    lab.lab.do(AmendCampaign(C1, Terms(priority=3, until=until("steps.read.od > 0.5"))))
    lab.work({"od": 0.6})
    assert lab.lab.log[-1].event.TYPE == "campaign.completed"
    assert lab.lab.reject(AmendCampaign(C1, Terms())).code == "no_campaign"


def test_one_that_has_ended_is_archived_and_brought_back() -> None:
    lab = Lab(rows=1)
    early = lab.lab.ask(ArchiveCampaign(C1))
    assert isinstance(early, Rejection)
    assert early.code == "not_ended"
    lab.to_the_end()
    for undo, kind in ((False, "campaign.archived"), (True, "campaign.unarchived")):
        assert [event.TYPE for event in lab.lab.do(ArchiveCampaign(C1, undo))] == [kind]
        assert lab.lab.do(ArchiveCampaign(C1, undo)) == []
        assert lab.lab.state.campaigns.ended[C1].archived is not undo
    unknown = lab.lab.ask(ArchiveCampaign(CampaignId("C9")))
    assert isinstance(unknown, Rejection)
    assert unknown.code == "no_campaign"


def test_cancelling_a_run_is_no_failure() -> None:
    lab = Lab(rows=2, stop_after=1)
    lab.feed()
    lab.lab.do(CancelRun(RunId("R1")))
    lab.work()
    event = lab.lab.log[-1].event
    assert (event.completed, event.cancelled, event.failed) == (1, 1, 0)  # type: ignore[attr-defined]


def test_room_in_the_state_does_not_grow_with_the_rows() -> None:
    def size(rows: int) -> int:
        lab = Lab(rows=rows)
        lab.feed()
        return len(encode_picture(lab.lab.state))

    assert size(100_000) - size(10) < 16


def test_one_that_an_earlier_version_left_undecided_is_completed_when_a_kernel_starts() -> None:
    lab = Lab(rows=2)
    lab.lab.write(CampaignCancelled(C1, "the wrong table"))
    assert C1 in lab.lab.state.campaigns.open
    events = lab.lab.do(StartKernel(2, "0"))
    assert [event.TYPE for event in events] == ["kernel.started", "campaign.completed"]


def test_rows_that_are_proposed_together_are_as_if_one_by_one() -> None:
    together, apart = Lab(), Lab()
    rows = tuple(map(together.row, range(ROWS_QUEUED + 1)))
    together.lab.do(SubmitRows(rows))
    assert apart.feed() == list(together.campaign.runs) == ["R1", "R2", "R3", "R4"]
    assert [entry.event for entry in together.lab.log] == [entry.event for entry in apart.lab.log]
    assert together.lab.reject(SubmitRows(rows)).code == "not_next"
    together.lab.check_log()


def test_rows_are_taken_up_to_the_first_that_has_to_wait() -> None:
    lab = Lab(budget=Budget(runs=3))
    lab.lab.do(SubmitRows((lab.row(0), RefuseRow(C1, 1, "not a well"), lab.row(3), lab.row(2))))
    assert (lab.campaign.next_row, lab.campaign.refused, list(lab.campaign.runs)) == (2, 1, ["R1"])
    lab.lab.do(SubmitRows((lab.row(2), RefuseRow(C1, 3, "not a well"), lab.row(4), lab.row(5))))
    assert lab.campaign.next_row == 5
    lab.to_the_end()
    assert lab.lab.types().count("run.submitted") == 3
    lab.lab.check_log()
