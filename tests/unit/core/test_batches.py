"""Runs that are submitted together: all of them or none, each as if it had been submitted by itself."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.composites import MOST_RUNS, SubmitRuns
from labos.core.decide.runs import SubmitRun
from labos.core.decide.shares import ApplyShares
from labos.core.decide.stock import LoadStation
from labos.core.decide.submissions import ApplyPolicy
from labos.core.decide.users import GrantRole
from labos.core.ids import RunId, StationName
from labos.core.labware import LabwarePlaced
from labos.core.policy import Policy
from labos.core.runs import RunSubmitted
from labos.core.shares import Group, Member, Quota
from labos.core.state import encode_picture
from labos.core.users import on_behalf
from tests.support.bench import full, move, plan, small, step
from tests.unit.core.test_rights import make_peopled

LONG = "x" * 70_000


def run_of(number: int, user: str = "ada", **more: object) -> SubmitRun:
    """A run with a key and a plan of its own."""
    run = SubmitRun(plan(step("dev", action=f"work{number}")), user, {"n": number}, request=f"night-{number}")
    return msgspec.structs.replace(run, **more)


def batch_of(count: int, user: str = "ada", first: int = 0) -> SubmitRuns:
    return SubmitRuns(tuple(run_of(n, user) for n in range(first, first + count)), (), first)


def submitted(events: list[object]) -> list[RunSubmitted]:
    return [event for event in events if isinstance(event, RunSubmitted)]


def test_the_log_is_as_after_one_submission_each() -> None:
    together, apart = small(), small()
    events = together.do(batch_of(4))
    for number in range(4):
        apart.do(run_of(number))
    assert [event.run for event in submitted(events)] == ["R1", "R2", "R3", "R4"]
    assert [entry.event for entry in together.log] == [entry.event for entry in apart.log]
    together.check_log()


def test_all_are_queued_before_the_first_starts() -> None:
    lab = small()
    lab.do(batch_of(3))
    assert (list(lab.state.runs.queued), list(lab.state.runs.active)) == (["R1", "R2", "R3"], [])
    assert lab.pump() == ["R1#0"]


def test_the_same_keys_are_the_same_runs() -> None:
    lab = small()
    first = submitted(lab.do(batch_of(2)))
    assert lab.do(batch_of(2)) == []
    more = submitted(lab.do(batch_of(4)))
    assert [event.run for event in (*first, *more)] == ["R1", "R2", "R3", "R4"]
    assert [lab.state.runs.requests[f"night-{number}"] for number in range(4)] == ["R1", "R2", "R3", "R4"]
    lab.check_log()


REFUSED: dict[str, tuple[Callable[[], SubmitRun], str]] = {
    "a plan": (lambda: run_of(2, plan=plan(step("nobody"))), "no_module"),
    "a payload that is too large": (lambda: run_of(2, payload={"text": LONG}), "unfit"),
    "an experiment": (lambda: run_of(2, experiment="E9"), "no_experiment"),
    "a key": (lambda: run_of(1), "twice"),
}


@pytest.mark.parametrize("part", REFUSED)
def test_one_that_is_refused_leaves_nothing_of_the_others(part: str) -> None:
    make, code = REFUSED[part]
    lab = small()
    before = encode_picture(lab.state)
    refusal = lab.reject(SubmitRuns((run_of(0), run_of(1), make(), run_of(3)), (), 50))
    assert (refusal.code, refusal.message.partition(":")[0]) == (code, "payloads[52]")
    assert refusal.message.endswith("None of the runs was submitted.")
    assert encode_picture(lab.state) == before


def test_no_more_than_one_turn_of_the_kernel_takes() -> None:
    lab = small()
    assert lab.reject(batch_of(MOST_RUNS + 1)).code == "too_many"
    assert len(submitted(lab.do(batch_of(MOST_RUNS)))) == MOST_RUNS


def test_a_quota_counts_each_of_them() -> None:
    lab = small()
    lab.do(ApplyShares("s", (Group("g", 1.0, {"ada": Member(quota=Quota(queued=3))}),)))
    refusal = lab.reject(batch_of(4))
    assert refusal.code == "quota"
    assert refusal.message.startswith("payloads[3]: 3 runs of ada already wait; at most 3 may wait.")
    lab.do(batch_of(3))
    assert lab.reject(batch_of(1, first=9)).message.startswith("payloads[9]: 3 runs of ada already wait")
    lab.do(CancelRun(RunId("R2")))
    lab.do(batch_of(1, first=9))


def test_each_of_them_waits_for_an_approval_by_itself() -> None:
    lab = make_peopled()
    lab.do(ApplyPolicy("p", Policy()), "root-1")
    lab.do(batch_of(2), on_behalf("robot", "ada"))
    assert list(lab.state.approvals.open) == ["R1", "R2"]
    assert len({proposal.digest for proposal in lab.state.approvals.open.values()}) == 2
    assert lab.pump() == []
    assert lab.do(batch_of(2), on_behalf("robot", "ada")) == []
    lab.check_log()


def test_a_priority_that_may_not_be_is_refused_for_all() -> None:
    lab = make_peopled()
    lab.do(ApplyPolicy("p", Policy(priority=5)), "root-1")
    runs = tuple(run_of(number, priority=9 if number else 0) for number in range(3))
    refusal = lab.reject(SubmitRuns(runs), "ada")
    assert (refusal.code, refusal.message.partition(":")[0]) == ("priority", "payloads[1]")
    assert not lab.state.runs.queued


def test_whoever_asks_must_be_allowed_each_of_them() -> None:
    lab = make_peopled()
    assert lab.reject(SubmitRuns((run_of(0), run_of(1, "bo"))), "ada").code == "not_you"
    load = LoadStation(StationName(full("a")), "plate", 1)
    assert lab.reject(SubmitRuns((run_of(0),), (load,)), "ada").code == "no_right"
    lab.do(GrantRole("user:ada", "operator"), "root-1")
    lab.do(SubmitRuns((run_of(0),), (load,)), "ada")


def test_labware_that_was_put_there_for_them_is_recorded_once() -> None:
    lab = small(stock=0)
    runs = tuple(
        SubmitRun(plan(step("arm", move(source, "c"))), "ada", request=f"plates-{source}") for source in "ab"
    )
    loads = tuple(LoadStation(StationName(full(name)), "plate", 1) for name in "ab")
    events = lab.do(SubmitRuns(runs, loads))
    assert [event.labware for event in events if isinstance(event, LabwarePlaced)] == ["P1", "P2"]
    assert lab.do(SubmitRuns(runs, loads)) == []
    twice = SubmitRuns(runs[:1], (loads[0], loads[0]))
    assert lab.do(twice) == [], "its runs are known"
    lab.check_log()
