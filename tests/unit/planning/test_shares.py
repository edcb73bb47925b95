"""Shares, quotas and deadlines: who is let in, and who waits for what."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.core.campaigns import Terms
from labos.core.decide.campaigns import SubmitCampaign, SubmitRow
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.runs import SubmitRun
from labos.core.decide.shares import ApplyShares
from labos.core.ids import CampaignId, RunId
from labos.core.model import Plan
from labos.core.shares import DAY_NS, Group, Member, Quota
from labos.services.shares import make_ledger
from tests.support.bench import SECOND, Driver, consumes, module, plan, small, step, workcell

READ = plan(step("dev", key="read", duration_s=600.0), name="read")
LOOK = plan(step("cam", key="look", duration_s=600.0), name="look")


def apply(lab: Driver, *groups: Group, **users: Member) -> None:
    lab.do(ApplyShares(f"d{lab.state.position}", groups, users))


def readers() -> Driver:
    """Ten devices that are all free."""
    return Driver(workcell([module(f"r{n}") for n in range(10)], []))


def long(n: int) -> Plan:
    """Two hours on one of them."""
    return plan(step(f"r{n}", key="read", duration_s=7200.0), name=f"long{n}")


def open_of(lab: Driver, run: str) -> str:
    """The action of a run that is under way."""
    return next(action.id for action in lab.state.actions.open.values() if action.run == run)


def order(lab: Driver) -> list[str]:
    """The users whose runs are let in, one after the other, each run taking ten minutes."""
    users: list[str] = []
    while lab.state.runs.queued or lab.state.actions.open:
        for name in lab.pump():
            users.append(lab.run(name.partition("#")[0]).user)
        lab.wait(600.0)
        for action in list(lab.state.actions.open):
            lab.finish(action)
    return users


def test_groups_take_turns_by_weight_however_many_members_they_have() -> None:
    lab = small()
    apply(lab, Group("many", 1.0, {"a": Member(), "b": Member()}), Group("one", 2.0, {"c": Member()}))
    for _ in range(6):
        for user in "abc":
            lab.submit(READ, user)
    first = Counter(order(lab)[:9])
    assert first["c"] == 6
    assert {first["a"], first["b"]} == {1, 2}


def test_what_a_group_has_had_is_what_its_members_have_had() -> None:
    lab = small()
    for user in "ab":
        lab.submit(READ, user)
    order(lab)
    apply(lab, Group("g", 1.0, {"a": Member(), "b": Member()}))
    accounts = {account.user: account for account in make_ledger(lab.state, lab.now)}
    assert accounts["a"].group == "g"
    assert accounts["a"].wanted == accounts["b"].wanted == 0.5
    assert accounts["a"].lab_hours == pytest.approx(600 / 3600)
    level = lab.state.shares.group_usage["g"].compute_level(lab.now)
    assert level == pytest.approx(
        sum(usage.compute_level(lab.now) for usage in lab.state.shares.usage.values())
    )


def test_one_run_at_a_time_and_nobody_waits_with_it() -> None:
    lab = small()
    apply(lab, a=Member(quota=Quota(running=1)))
    first, second = lab.submit(READ, "a"), lab.submit(LOOK, "a")
    other = lab.submit(LOOK, "b")
    assert lab.pump() == [f"{first}#0", f"{other}#0"]
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(second), lab.now)
    assert (wait.code, wait.names) == ("quota", ("a", "1 runs at a time"))
    lab.finish("A2")
    assert lab.pump() == []
    lab.finish("A1")
    assert lab.pump() == [f"{second}#0"]


def test_a_groups_quota_counts_all_of_its_members() -> None:
    lab = small()
    apply(lab, Group("g", 1.0, {"a": Member(), "b": Member()}, Quota(running=1)))
    lab.submit(READ, "a")
    late = lab.submit(LOOK, "b")
    assert lab.pump() == ["R1#0"]
    assert lab.code(late) == "quota"


def test_a_quota_that_is_lifted_lets_runs_in() -> None:
    lab = small()
    apply(lab, a=Member(quota=Quota(running=1)))
    lab.submit(READ, "a")
    second = lab.submit(LOOK, "a")
    assert lab.pump() == ["R1#0"]
    apply(lab)
    assert lab.pump() == [f"{second}#0"]


def test_lab_hours_of_seven_days() -> None:
    lab = small()
    apply(lab, a=Member(quota=Quota(lab_hours=0.25)))
    action = lab.start(lab.submit(READ, "a"))
    lab.wait(1800.0)
    lab.finish(action)
    second = lab.submit(READ, "a")
    assert lab.pump() == []
    assert lab.code(second) == "quota"
    lab.now = (lab.now // DAY_NS + 7) * DAY_NS
    assert lab.pump() == [f"{second}#0"]


def test_days_before_the_week_are_deleted() -> None:
    lab = small()
    apply(lab, Group("g", members={"a": Member()}))
    lab.level("dev", "tips", 1000.0)
    tips = plan(step("dev", consumes("tips", 6.0)), name="tips")
    first = lab.now // DAY_NS
    for day in (0, 1, 6, 8, 8, 20):
        lab.now = (first + day) * DAY_NS
        lab.step(lab.submit(tips, "a"))
        for had in (lab.state.shares.had["a"], lab.state.shares.group_had["g"]):
            days = [first + other for other in (0, 1, 6, 8, 20) if day - 7 < other <= day]
            assert [*had.week.spent_ns] == [*had.week.consumed] == days
    assert lab.state.shares.had["a"].week.count_used("tips", lab.now) == 6.0


def test_consumables_of_seven_days() -> None:
    lab = small()
    lab.level("dev", "tips", 100.0)
    tips = plan(step("dev", consumes("tips", 6.0)), name="tips")
    apply(lab, a=Member(quota=Quota(consumables={"tips": 10.0})))
    lab.step(lab.submit(tips, "a"))
    assert lab.code(lab.submit(tips, "a")) == "quota"
    assert lab.code(lab.submit(READ, "a")) == ""


@pytest.mark.parametrize("whose", ["user", "group"])
def test_runs_under_way_count_by_their_planned_hours(whose: str) -> None:
    lab = readers()
    quota = Quota(lab_hours=5.0)
    if whose == "user":
        apply(lab, a=Member(quota=quota))
    else:
        apply(lab, Group("g", 1.0, {"a": Member(), "b": Member()}, quota))
    for n in range(10):
        lab.submit(long(n), "ab"[n % 2] if whose == "group" else "a")
    assert lab.pump() == ["R1#0", "R2#0", "R3#0"], "the third is let in below the limit, no other one is"
    assert lab.code("R4") == "quota"
    lab.wait(600.0)
    for action in list(lab.state.actions.open):
        lab.finish(action)  # each took ten minutes in place of two hours
    assert len(lab.pump()) == 3


def test_a_step_that_takes_longer_than_planned_counts_as_long_as_it_takes() -> None:
    lab = readers()
    apply(lab, a=Member(quota=Quota(lab_hours=5.0)))
    lab.submit(long(0), "a")
    lab.pump()
    lab.wait(6 * 3600.0)
    late = lab.submit(long(1), "a")
    assert lab.pump() == []
    assert lab.code(late) == "quota"


def test_steps_that_are_done_or_left_out_do_not_count_twice() -> None:
    lab = readers()
    apply(lab, a=Member(quota=Quota(lab_hours=5.0)))
    both = plan(step("r0", duration_s=7200.0), step("r0", duration_s=7200.0), name="both")
    run = lab.submit(both, "a")
    lab.pump()
    lab.wait(7200.0)
    lab.finish(open_of(lab, run))
    other = lab.submit(long(1), "a")
    assert f"{other}#0" in lab.pump(), "two hours had and two under way"
    late = lab.submit(long(2), "a")
    assert lab.pump() == []
    lab.do(CancelRun(RunId(run)))
    assert lab.code(late) == "quota", "the step under way goes on"


def test_what_runs_under_way_will_use_up_counts() -> None:
    lab = readers()
    for n in range(4):
        lab.level(f"r{n}", "tips", 100.0)
    apply(lab, a=Member(quota=Quota(consumables={"tips": 10.0})))
    for n in range(4):
        lab.submit(plan(step(f"r{n}"), step(f"r{n}", consumes("tips", 4.0)), name=f"tips{n}"), "a")
    assert lab.pump() == ["R1#0", "R2#0"], "eight of ten tips are spoken for, though none is used yet"
    assert lab.code("R3") == "quota"
    lab.do(CancelRun(RunId("R1")))
    lab.finish(open_of(lab, "R1"))
    assert lab.pump() == ["R3#0"], "a run that was cancelled uses none"


def test_too_many_waiting_runs_are_refused_and_rows_wait() -> None:
    lab = small()
    apply(lab, a=Member(quota=Quota(queued=2)))
    lab.do(SubmitCampaign("s", "a", "read", "cell", 5, "t", "d"))
    for row in range(2):
        lab.do(SubmitRow(CampaignId("C1"), row, READ))
    assert lab.reject(SubmitRow(CampaignId("C1"), 2, READ)).code == "no_room"
    assert lab.reject(SubmitRun(READ, "a")).code == "quota"
    lab.submit(READ, "b")
    assert lab.pump() == ["R1#0"]
    lab.do(SubmitRow(CampaignId("C1"), 2, READ))


def test_who_stands_in_two_groups_or_has_no_weight_is_refused() -> None:
    lab = small()
    twice = (Group("g", 1.0, {"a": Member()}), Group("h", 1.0, {"a": Member()}))
    assert lab.reject(ApplyShares("d", twice)).code == "two_groups"
    assert lab.reject(ApplyShares("d", twice[:1], {"a": Member()})).code == "two_groups"
    assert lab.reject(ApplyShares("d", (), {"a": Member(0.0)})).code == "bad_weight"


@pytest.mark.parametrize(("deadline_s", "first"), [(0.0, "greedy"), (3600.0, "late"), (1e6, "greedy")])
def test_a_campaign_goes_first_once_its_time_is_short(deadline_s: float, first: str) -> None:
    lab = small()
    blocker = lab.start(lab.submit(READ, "x"))
    for _ in range(5):
        lab.submit(READ, "greedy", priority=5)
    deadline = lab.now + int(deadline_s * SECOND) if deadline_s else 0
    lab.do(SubmitCampaign("s", "late", "read", "cell", 3, "t", "d", Terms(deadline=deadline)))
    lab.do(SubmitRow(CampaignId("C1"), 0, READ))
    lab.wait(600.0)
    lab.finish(blocker)
    (started,) = lab.pump()
    assert lab.run(started.partition("#")[0]).user == first
