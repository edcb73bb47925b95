"""Five users in three groups, one of them greedy: shares follow weights, and nobody waits for ever."""

from __future__ import annotations

import heapq
import random
from typing import Any, NamedTuple

import pytest

from labos.core.campaigns import Terms
from labos.core.decide.campaigns import SubmitCampaign, SubmitRow
from labos.core.decide.shares import ApplyShares
from labos.core.ids import ActionId, CampaignId, local
from labos.core.model import Plan
from labos.core.shares import Group, Member, Quota
from tests.support.bench import SECOND, Driver, module, plan, step, workcell

READERS = ("reader1", "reader2", "reader3")
GROUPS = (
    Group("chemistry", 3.0, {"greedy": Member(1.0), "ada": Member(1.0)}),
    Group("biology", 2.0, {"bo": Member(1.0), "cy": Member(1.0)}),
    Group("physics", 1.0, {"di": Member()}),
)
WANTED = {"greedy": 1 / 4, "ada": 1 / 4, "bo": 1 / 6, "cy": 1 / 6, "di": 1 / 6}
USERS = tuple(WANTED)
LONGEST_WAIT = 120
"""Runs that may be let in while one waits: with four in the queue of each user, the last of them waits for
four turns, and a sixth of all turns are its user's, on each of three modules."""


class Admitted(NamedTuple):
    """A run that was let in, and how many others were while it waited."""

    user: str
    campaign: str
    module: str
    waited: int


class Facility(Driver):
    """Readers that anybody may use, and campaigns of runs that take 5 to 15 minutes."""

    careful = False

    def __init__(self, seed: int, groups: tuple[Group, ...] = GROUPS) -> None:
        super().__init__(workcell([module(name) for name in READERS], []))
        self.rng = random.Random(seed)
        self.ends: list[tuple[int, ActionId]] = []
        self.admitted: list[Admitted] = []
        self._seen = len(self.log)
        self._waiting: dict[str, int] = {}
        self.do(ApplyShares("d", groups))

    def campaign(self, user: str, rows: int, **terms: Any) -> CampaignId:
        self.do(SubmitCampaign("screen", user, "read", "cell", rows, "t", "d", Terms(**terms)))
        return CampaignId(f"C{self.state.campaigns.named}")

    def plan_of(self, row: int) -> Plan:
        return plan(step(READERS[row % len(READERS)], key="read", duration_s=600.0), name="read")

    def feed(self) -> None:
        """What the feeder does: one row of each campaign in turn."""
        again = True
        while again:
            again = False
            for campaign in [c for c in self.state.campaigns.open.values() if c.room]:
                command = SubmitRow(campaign.id, campaign.next_row, self.plan_of(campaign.next_row))
                again = isinstance(self.ask(command), list) or again

    def turn(self) -> None:
        self.feed()
        self.pump()
        for entry in self.log[self._seen :]:
            match entry.event.TYPE:
                case "run.submitted":
                    self._waiting[entry.stream] = len(self.admitted)
                case "run.started":
                    run = self.state.runs.active[entry.stream]  # type: ignore[index]
                    waited = len(self.admitted) - self._waiting.pop(run.id)
                    reader = local(self.state.runs.plan_of(run).steps[0].module)
                    self.admitted.append(Admitted(run.user, run.campaign, reader, waited))
                case "action.requested":
                    takes_s = 600 * self.rng.uniform(0.5, 1.5)
                    ends_at = self.now + int(takes_s * SECOND)
                    heapq.heappush(self.ends, (ends_at, entry.event.action))  # type: ignore[attr-defined]
        self._seen = len(self.log)

    def work(self, runs: int) -> None:
        """Until so many runs more were let in."""
        until = len(self.admitted) + runs
        while len(self.admitted) < until:
            self.turn()
            if not self.ends:
                return
            self.now, action = heapq.heappop(self.ends)
            self.finish(action)

    def shares(self) -> dict[str, float]:
        """Which part of the module time each user has had."""
        spent = {user: had.week.sum_lab_ns(self.now) for user, had in self.state.shares.had.items()}
        return {user: ns / sum(spent.values()) for user, ns in spent.items()}


def all_at_work(seed: int, greedy: int = 10) -> Facility:
    """A greedy user has so many campaigns, the others one each."""
    lab = Facility(seed)
    for _ in range(greedy):
        lab.campaign("greedy", 100_000)
    for user in USERS[1:]:
        lab.campaign(user, 100_000)
    return lab


@pytest.mark.parametrize(
    ("seeds", "runs"),
    [
        pytest.param(range(1), 500, id="one"),
        *(pytest.param([seed], 1000, id=f"whole {seed}", marks=pytest.mark.full) for seed in range(20)),
    ],
)
def test_shares_follow_weights_and_nobody_waits_for_ever(seeds: range, runs: int) -> None:
    for seed in seeds:
        lab = all_at_work(seed)
        lab.work(runs)
        shares = lab.shares()
        print(f"seed {seed}: " + ", ".join(f"{user} {share:.4f}" for user, share in sorted(shares.items())))
        for user, wanted in WANTED.items():
            assert abs(shares[user] - wanted) <= 0.05 * wanted, (seed, user, shares)
        longest = max(run.waited for run in lab.admitted if run.user != "greedy")
        print(f"the longest wait of the others: {longest} runs")
        assert longest <= LONGEST_WAIT, seed


@pytest.mark.parametrize("seed", range(3))
def test_an_urgent_campaign_goes_first_on_each_module(seed: int) -> None:
    lab = all_at_work(seed)
    lab.work(60)
    before = len(lab.admitted)
    name = lab.campaign("greedy", 3, deadline=lab.now + 600 * SECOND)
    lab.work(9)
    first: dict[str, str] = {}
    for run in lab.admitted[before:]:
        first.setdefault(run.module, run.campaign)
    assert first == dict.fromkeys(READERS, name)


def test_a_quota_holds_the_greedy_one_back_and_others_get_what_is_left() -> None:
    (chemistry, *others) = GROUPS
    held = Group("chemistry", 3.0, {**chemistry.members, "greedy": Member(1.0, Quota(running=1))})
    lab = all_at_work(7)
    lab.do(ApplyShares("e", (held, *others)))
    most = 0
    for _ in range(300):
        lab.work(1)
        most = max(most, lab.state.shares.had["greedy"].running)
    assert most == 1
