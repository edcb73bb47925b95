"""What waits for an approval by the lab's policy, through every door; who may approve; and what runs then."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from labos.core.approvals import Demand, Proposal
from labos.core.campaigns import Budget, CampaignStatus, Terms
from labos.core.decide import Command
from labos.core.decide.campaigns import (
    AmendCampaign,
    CancelCampaign,
    PauseCampaign,
    ResumeCampaign,
    SubmitCampaign,
    SubmitRow,
    SubmitRows,
)
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.composites import ReportRound, SubmitWithLabware
from labos.core.decide.control import CancelExperiment
from labos.core.decide.experiments import EndExperiment, StartExperiment
from labos.core.decide.handover import HandOver
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.proposals import ApproveProposal, RefuseProposal
from labos.core.decide.runs import SubmitRun
from labos.core.decide.shares import ApplyShares
from labos.core.decide.shorter import SayContents
from labos.core.decide.stock import LoadStation
from labos.core.decide.submissions import ApplyPolicy, allows_more, name_both_actors
from labos.core.decide.users import GrantRole
from labos.core.ids import CampaignId, ExperimentId, LabwareId, RunId, StationName, experiment_owner
from labos.core.labware import LabwarePlaced
from labos.core.model import Plan
from labos.core.policy import Policy
from labos.core.registry import Event
from labos.core.shares import Group, Member, Quota
from labos.core.state import encode_picture, from_picture
from labos.core.users import on_behalf
from tests.support.bench import Driver, consumes, full, move, plan, route, small, step
from tests.unit.core.test_rights import make_peopled

ROBOT = on_behalf("robot", "ada")
C1, E1 = CampaignId("C1"), ExperimentId("E1")


def work(name: str = "work", **more: Any) -> Plan:
    return plan(step("dev", **{"duration_s": 60.0, **more}), name=name)


def lab_with(**policy: Any) -> Driver:
    """A lab of which everybody who submits is a user, with a policy."""
    lab = make_peopled()
    lab.level("dev", "tips", 1000.0, 1000.0)
    if policy:
        lab.do(ApplyPolicy("p", Policy(**policy)), "root-1")
    return lab


def screen(rows: int = 10, user: str = "ada", terms: Terms = Terms(), **more: Any) -> SubmitCampaign:  # noqa: B008
    return SubmitCampaign("screen", user, "work", "cell", rows, "t", "d", terms, **more)


def find_proposal(lab: Driver, subject: str) -> Proposal:
    return lab.state.approvals.open[subject]


def approve(lab: Driver, subject: str, by: str = "olga", **more: Any) -> list[Event]:
    digest = find_proposal(lab, subject).digest
    return lab.do(ApproveProposal(subject, digest, by, **more), by)


def codes(lab: Driver, subject: str) -> list[str]:
    found = lab.state.approvals.open.get(subject)
    return [why.code for why in found.why] if found is not None else []


def feed(lab: Driver, what: Plan | None = None) -> list[str]:
    """Rows of C1, as long as it takes any."""
    while C1 in lab.state.campaigns.open and lab.state.campaigns.open[C1].room:
        campaign = lab.state.campaigns.open[C1]
        lab.do(SubmitRow(C1, campaign.next_row, what or work()))
    return [str(run) for run in lab.state.campaigns.open[C1].runs]


# -- what waits ----------------------------------------------------------------------------------


@pytest.mark.parametrize("actor", ["robot", ROBOT])
def test_what_a_program_submits_waits_unless_the_policy_says_otherwise(actor: str) -> None:
    lab = lab_with()
    user = actor.rpartition(" ")[2]
    lab.do(SubmitRun(work(), user), actor)
    lab.do(StartExperiment("app", user), actor)
    lab.do(screen(user=user), actor)
    assert lab.pump() == []
    assert feed(lab) == []
    assert [codes(lab, name) for name in ("R1", "E1", "C1")] == [["program"]] * 3
    assert lab.check_start("R1").reason.sentence == (  # type: ignore[union-attr]
        "run R1 waits for approval, because it was made by a program (robot)"
    )
    assert len(lab.questions("approval")) == 3
    lab.check_log()


def test_a_run_that_comes_with_labware_waits_too() -> None:
    """The labware stands there in any case, each piece under a name of its own."""
    lab = lab_with()
    lab.do(GrantRole("user:robot", "operator"), "root-1")
    lab.do(GrantRole("user:ada", "operator"), "root-1")
    a, b = (LoadStation(StationName(full(name)), "plate", 1) for name in "ab")
    run = SubmitRun(plan(step("arm", move("a", "c"))), "ada", request="key")
    events = lab.do(SubmitWithLabware(run, (a, b)), ROBOT)
    assert len({e.labware for e in events if isinstance(e, LabwarePlaced)}) == 2
    assert codes(lab, "R1") == ["program"]
    assert lab.pump() == []
    assert lab.do(SubmitWithLabware(run, (a, b)), ROBOT) == [], "the same request again"
    approve(lab, "R1", "root-1")
    assert lab.pump() != []
    lab.check_log()


def test_what_a_program_says_for_a_person_is_put_down_to_both_in_each_part() -> None:
    a = StationName(full("a"))
    report = ReportRound("ada", (SayContents(a, "ada", ("empty",)),), (a,))
    told = name_both_actors(report, ROBOT)
    assert isinstance(told, ReportRound)
    assert (told.by, told.stations[0].by) == (ROBOT, ROBOT)
    assert name_both_actors(report, "ada") is report


def test_trusted_programs_and_people_do_not_wait() -> None:
    for policy, actor in (
        ({"trusted": ("robot",)}, ROBOT),
        ({"programs": False}, "robot"),
        ({"programs": True}, "ada"),
    ):
        lab = lab_with(**policy)
        lab.do(SubmitRun(work(), actor.rpartition(" ")[2]), actor)
        assert lab.pump() == ["R1#0"]


def test_a_program_cannot_have_more_rights_than_that() -> None:
    """An admin's program waits, too, and can neither approve nor change the policy for others to do it."""
    lab = lab_with()
    lab.do(GrantRole("user:robot", "operator"), "root-1")
    lab.do(SubmitRun(work(), "robot"), "robot")
    digest = find_proposal(lab, "R1").digest
    for actor in ("robot", on_behalf("robot", "olga")):
        by = "olga" if " " in actor else actor
        found = lab.reject(ApproveProposal("R1", digest, by), actor)
        assert found.code in ("no_person", "not_you", "own_approval"), actor
    assert lab.reject(ApproveProposal("R1", digest, on_behalf("robot", "olga")), ROBOT).code == "not_you"
    acting = on_behalf("robot", "olga")
    assert lab.reject(ApproveProposal("R1", digest, acting), acting).code == "no_person"
    question = lab.question("approval")
    assert lab.reject(ResolveIntervention(question.id, "approve", acting), acting).code == "no_person"
    assert lab.reject(ApplyPolicy("q", Policy(programs=False)), "robot").code == "no_right"
    lab.do(GrantRole("user:robot", "admin"), "root-1")
    assert lab.reject(ApplyPolicy("q", Policy(trusted=("robot",))), "robot").code == "no_person"
    assert lab.reject(ResolveIntervention(question.id, "approve", "bo"), "bo").code == "no_right"
    assert lab.pump() == []


def test_the_first_submissions_of_a_user_wait() -> None:
    lab = lab_with(newcomers=2)
    for number in (1, 2):
        lab.do(SubmitRun(work(), "ada"), "ada")
        assert codes(lab, f"R{number}") == ["newcomer"]
        approve(lab, f"R{number}")
    lab.do(SubmitRun(work(), "ada"), "ada")
    lab.do(SubmitRun(work(), "olga"), "olga")  # who may approve is nobody's newcomer
    lab.do(SubmitRun(work(), "bo"), "bo")
    assert not codes(lab, "R3")
    assert not codes(lab, "R4")
    assert codes(lab, "R5") == ["newcomer"]
    # What is refused does not count.
    lab.do(RefuseProposal("R5", "olga"), "olga")
    lab.do(SubmitRun(work(), "bo"), "bo")
    assert "0 of the first 2" in find_proposal(lab, "R6").why[0].text


def test_dangerous_steps_wait_also_where_the_workcell_asks_for_no_second_person() -> None:
    lab = lab_with(dangerous=True)
    lab.do(SubmitRun(work(hazard="laser"), "ada"), "ada")
    lab.do(StartExperiment("app", "ada", work(hazard="hot")), "ada")
    lab.do(screen(demand=Demand(dangers=("burn on dev (laser)",))), "ada")
    assert [codes(lab, name) for name in ("R1", "E1", "C1")] == [["dangerous"]] * 3
    assert "s0 on dev (laser)" in find_proposal(lab, "R1").why[0].text
    # An approval of the campaign is one of its dangers.
    approve(lab, "C1")
    assert len(feed(lab, work(hazard="laser"))) == 4


def test_a_row_that_turns_out_dangerous_has_its_campaign_wait() -> None:
    lab = lab_with(dangerous=True)
    lab.do(screen(), "ada")
    dangerous = SubmitRow(C1, 1, work(hazard="laser"))
    lab.do(SubmitRows((SubmitRow(C1, 0, work()), dangerous, SubmitRow(C1, 2, work()))))
    campaign = lab.state.campaigns.open[C1]
    assert (campaign.status, campaign.next_row) == (CampaignStatus.PROPOSED, 1)
    approve(lab, "C1")
    lab.do(SubmitRow(C1, 1, work(hazard="laser")))
    assert lab.state.campaigns.open[C1].next_row == 2
    lab.check_log()


def test_what_is_above_the_budget_waits() -> None:
    above = Budget(runs=5, lab_time_s=3600.0, consumables={"tips": 96.0})
    big = Demand(module_time_s=36_000.0, consumables={"tips": 960.0})
    cases: list[tuple[Command, str]] = [
        (SubmitRun(work(), "ada"), ""),
        (SubmitRun(work(duration_s=3601.0), "ada"), "1 h lab time"),
        (SubmitRun(plan(step("dev", consumes("tips", 97.0))), "ada"), "97 tips"),
        (screen(5), ""),
        (screen(6), "6 runs"),
        (screen(6, terms=Terms(budget=Budget(runs=5))), ""),
        (screen(2, demand=big), "10 h lab time"),
        (screen(2, demand=big, terms=Terms(budget=Budget(lab_time_s=3600.0))), "960 tips"),
        (
            screen(2, demand=big, terms=Terms(budget=Budget(0, 3600.0, {"tips": 96.0}))),
            "",
        ),
        # A limit of none is a limit.
        (screen(2, demand=big, terms=Terms(budget=Budget(0, 3600.0, {"tips": 0.0}))), ""),
    ]
    for command, said in cases:
        lab = lab_with(above=above)
        lab.do(command, "ada")
        texts = [why.text for proposal in lab.state.approvals.open.values() for why in proposal.why]
        assert bool(texts) == bool(said), command
        assert all(said in text for text in texts), texts


def test_whoever_wants_it_approved_says_so() -> None:
    """Also in a lab without users, where others' names are believed."""
    lab = small()
    lab.do(SubmitRun(work(), "ada", propose=True), "ada")
    lab.do(StartExperiment("app", "ada", propose=True), "ada")
    lab.do(screen(propose=True), "ada")
    assert lab.pump() == []
    assert {*lab.state.approvals.open} == {"R1", "E1", "C1"}
    assert (
        lab.reject(ApproveProposal("R1", find_proposal(lab, "R1").digest, "ada"), "ada").code
        == "own_approval"
    )
    approve(lab, "R1", "bo")
    assert lab.pump() == ["R1#0"]


def test_the_lab_itself_is_not_asked() -> None:
    """Closing workflows and rows are LabOS' own doing; they were approved with what they belong to."""
    lab = lab_with(newcomers=9, dangerous=True)
    closing = plan(step("arm", move("a", "trash"), hazard="hot"), name="clear")
    lab.do(StartExperiment("app", "ada", closing), "ada")
    approve(lab, "E1")
    lab.do(SubmitRun(route("stack", "a"), "ada", experiment=E1), "ada")
    approve(lab, "R1")
    lab.work(random.Random(1))
    lab.do(EndExperiment(E1), "ada")
    assert lab.pump() == ["R2#0"]
    assert lab.run("R2").closing


# -- who may approve, and what -------------------------------------------------------------------


def test_nobody_approves_what_is_their_own() -> None:
    lab = lab_with(above=Budget(lab_time_s=1.0))
    lab.do(SubmitRun(work(), "olga"), "olga")
    found = lab.reject(ApproveProposal("R1", find_proposal(lab, "R1").digest, "olga"), "olga")
    assert (found.code, found.message) == (
        "own_approval",
        "R1 belongs to olga, and the lab's policy requires the approval of another person.",
    )
    assert lab.reject(ApproveProposal("R1", find_proposal(lab, "R1").digest, "bo"), "bo").code == "no_right"
    # Nor by the question in the inbox, and nor for a program that acts in one's name.
    question = lab.question("approval")
    assert lab.reject(ResolveIntervention(question.id, "approve", "olga"), "olga").code == "own_approval"
    lab.do(GrantRole("user:ada", "operator"))
    lab.do(SubmitRun(work(), "ada"), ROBOT)
    assert (
        lab.reject(ApproveProposal("R2", find_proposal(lab, "R2").digest, "ada"), "ada").code
        == "own_approval"
    )
    approve(lab, "R1", "root-1")
    assert lab.pump() == ["R1#0"]


def test_a_policy_may_let_operators_approve_their_own() -> None:
    lab = lab_with(above=Budget(lab_time_s=1.0), own=True)
    lab.do(SubmitRun(work(), "olga"), "olga")
    assert not codes(lab, "R1"), "whoever could approve it need not ask"
    lab.do(SubmitRun(work(), "bo"), "bo")
    lab.do(GrantRole("user:ada", "operator"))
    lab.do(SubmitRun(work(), "ada"), ROBOT)
    approve(lab, "R3", "ada")
    assert lab.pump(), "R1 and R3"


@pytest.mark.parametrize("seen", ["", "ab" * 32, "short"])
def test_only_what_was_looked_at_is_approved(seen: str) -> None:
    lab = lab_with()
    lab.do(screen(), ROBOT)
    digest = find_proposal(lab, "C1").digest
    assert lab.reject(ApproveProposal("C1", seen or digest[:11], "olga"), "olga").code == "changed"
    lab.do(ApproveProposal("C1", digest[:12], "olga"), "olga")


def test_what_was_changed_after_it_was_looked_at_cannot_run_under_its_digest() -> None:
    lab = lab_with()
    lab.do(screen(terms=Terms(budget=Budget(runs=1))), ROBOT)
    seen, question = find_proposal(lab, "C1").digest, lab.question("approval")
    lab.do(AmendCampaign(C1, Terms(budget=Budget(runs=10))), ROBOT)
    assert lab.reject(ApproveProposal("C1", seen, "olga"), "olga").code == "changed"
    assert lab.reject(ResolveIntervention(question.id, "approve", "olga"), "olga").code == "no_intervention"
    anew = lab.question("approval")
    lab.do(ResolveIntervention(anew.id, "approve", "olga", "ten are fine"), "olga")
    given = next(e.event for e in lab.log if e.event.TYPE == "approval.given")
    assert (given.comment, given.digest != seen) == ("ten are fine", True)  # type: ignore[attr-defined]
    assert lab.state.campaigns.open[C1].status == CampaignStatus.OPEN
    lab.check_log()


def test_a_run_is_what_it_was_when_it_was_proposed() -> None:
    """The same name with another plan or other values is another proposal, and says what has changed."""
    lab = lab_with()
    first = SubmitRun(work(), "ada", {"time": 3}, pins={"workflow": "w1", "request": "q1"})
    lab.do(first, ROBOT)
    approve(lab, "R1")
    for payload, pins, changed in (
        ({"time": 3}, {"workflow": "w1", "request": "q2"}, ()),
        ({"time": 4}, {"workflow": "w1", "request": "q3"}, ("payload",)),
        ({"time": 3}, {"workflow": "w2", "request": "q4"}, ("workflow",)),
    ):
        lab.do(SubmitRun(work(), "ada", payload, pins=pins), ROBOT)
        name = f"R{lab.state.runs.named}"
        assert (find_proposal(lab, name).before, find_proposal(lab, name).changed) == ("R1", changed)
        assert lab.code(name) == "not_approved"
    files = plan(step("dev"), name="work", files={"a.py": "ff"})
    lab.do(SubmitRun(files, "ada", {"time": 3}, pins={"workflow": "w1"}), ROBOT)
    assert find_proposal(lab, "R5").changed == ("file:a.py",)


def test_an_approval_may_change_priority_and_terms() -> None:
    lab = lab_with()
    lab.do(SubmitRun(work(), "ada", priority=9), ROBOT)
    approve(lab, "R1", priority=-3)
    assert lab.run("R1").priority == -3
    lab.do(screen(), ROBOT)
    approve(lab, "C1", terms=Terms(priority=2, budget=Budget(runs=3)), why="three are enough")
    assert lab.state.campaigns.open[C1].terms.budget.runs == 3
    lab.do(SubmitRow(C1, 0, work()))
    assert lab.run("R2").priority == 2
    lab.do(StartExperiment("app", "ada", priority=4), ROBOT)
    assert (
        lab.reject(ApproveProposal("E1", find_proposal(lab, "E1").digest, "olga", terms=Terms()), "olga").code
        == "no_such_change"
    )
    approve(lab, "E1", priority=1)
    assert lab.state.experiments.open[E1].priority == 1
    lab.check_log()


def test_what_is_refused_is_cancelled() -> None:
    lab = lab_with()
    lab.do(SubmitRun(work(), "ada"), ROBOT)
    lab.do(StartExperiment("app", "ada"), ROBOT)
    lab.do(screen(), ROBOT)
    for name in ("R1", "E1", "C1"):
        lab.do(RefuseProposal(name, "olga", "not today"), "olga")
    lab.pump()
    assert not lab.state.runs.queued
    assert not lab.state.experiments.open
    assert not lab.state.campaigns.open
    assert lab.state.approvals.open == {}
    assert not lab.questions()
    assert lab.reject(RefuseProposal("R1", "olga"), "olga").code == "no_proposal"
    lab.check_log()


@pytest.mark.parametrize(
    ("submit", "withdraw"),
    [
        (SubmitRun(work(), "ada"), CancelRun(RunId("R1"))),
        (StartExperiment("app", "ada"), EndExperiment(E1)),
        (StartExperiment("app", "ada"), CancelExperiment(E1, "ada")),
        (screen(), CancelCampaign(C1)),
    ],
)
def test_its_user_may_take_it_back(submit: Command, withdraw: Command) -> None:
    lab = lab_with()
    lab.do(submit, ROBOT)
    lab.do(withdraw, "ada")
    lab.pump()
    assert lab.state.approvals.open == {}
    assert not lab.questions()


# -- every door ----------------------------------------------------------------------------------


def amend(lab: Driver, terms: Terms, actor: str) -> None:
    lab.do(AmendCampaign(C1, terms), actor)


def test_a_change_by_which_a_campaign_may_do_more_waits_and_the_campaign_goes_on() -> None:
    lab = lab_with(above=Budget(lab_time_s=3600.0))
    small_one = Terms(budget=Budget(lab_time_s=3600.0))
    lab.do(screen(terms=small_one, demand=Demand(module_time_s=36_000.0)), "ada")
    assert not codes(lab, "C1")
    amend(lab, Terms(budget=Budget(lab_time_s=7200.0)), "ada")
    assert (find_proposal(lab, "C1").kind, codes(lab, "C1")) == ("amendment", ["budget"])
    campaign = lab.state.campaigns.open[C1]
    assert (campaign.status, campaign.terms) == (CampaignStatus.OPEN, small_one)
    assert feed(lab)
    # Another change takes its place; one that asks for less is made at once.
    amend(lab, Terms(), "ada")
    assert "any lab time" in find_proposal(lab, "C1").why[0].text
    amend(lab, Terms(budget=Budget(lab_time_s=60.0), tags=("x",)), "ada")
    assert campaign.terms.budget.lab_time_s == 60.0
    approve(lab, "C1", terms=Terms(budget=Budget(lab_time_s=5000.0)))
    assert campaign.terms.budget.lab_time_s == 5000.0
    # An operator who changes it has looked at it.
    amend(lab, Terms(budget=Budget(lab_time_s=9000.0)), "olga")
    assert campaign.terms.budget.lab_time_s == 9000.0
    lab.check_log()


def test_a_program_may_only_ask_for_less() -> None:
    lab = lab_with()
    lab.do(screen(terms=Terms(budget=Budget(runs=5))), ROBOT)
    approve(lab, "C1")
    amend(lab, Terms(budget=Budget(runs=3)), ROBOT)
    assert lab.state.campaigns.open[C1].terms.budget.runs == 3
    amend(lab, Terms(priority=1, budget=Budget(runs=3)), ROBOT)
    assert codes(lab, "C1") == ["program"]
    lab.do(RefuseProposal("C1", "olga"), "olga")
    campaign = lab.state.campaigns.open[C1]
    assert (campaign.status, campaign.terms.priority) == (CampaignStatus.OPEN, 0)


@pytest.mark.parametrize(
    ("old", "new", "more"),
    [
        (Terms(), Terms(tags=("x",)), False),
        (Terms(priority=3), Terms(priority=2), False),
        (Terms(priority=3), Terms(priority=4), True),
        (Terms(), Terms(deadline=5), True),
        (Terms(deadline=5), Terms(deadline=6), False),
        (Terms(deadline=5), Terms(deadline=4), True),
        (Terms(deadline=5), Terms(), False),
        (Terms(stop_after=3), Terms(), True),
        (Terms(), Terms(stop_after=3), False),
        (Terms(budget=Budget(runs=3)), Terms(), True),
        (Terms(budget=Budget(consumables={"tips": 8.0})), Terms(), True),
        (Terms(), Terms(budget=Budget(consumables={"tips": 8.0})), False),
        (
            Terms(budget=Budget(consumables={"tips": 0.0})),
            Terms(budget=Budget(consumables={"tips": 1.0})),
            True,
        ),
    ],
)
def test_which_changes_ask_for_more(old: Terms, new: Terms, more: bool) -> None:
    assert allows_more(old, new) is more


def test_a_campaign_that_waits_can_neither_be_paused_nor_resumed() -> None:
    lab = lab_with()
    lab.do(screen(), ROBOT)
    for command in (PauseCampaign(C1), ResumeCampaign(C1)):
        assert "waits for approval" in lab.reject(command, "ada").message


def test_runs_of_an_experiment_wait_for_it_and_for_themselves() -> None:
    lab = lab_with()
    lab.do(StartExperiment("app", "ada"), ROBOT)
    lab.do(SubmitRun(work(), "ada", experiment=E1), ROBOT)
    lab.do(SubmitRun(work(), "ada", experiment=E1), "ada")
    assert (codes(lab, "R1"), codes(lab, "R2")) == (["program", "experiment"], ["experiment"])
    found = lab.reject(ApproveProposal("R1", find_proposal(lab, "R1").digest, "olga"), "olga")
    assert found.code == "experiment_first"
    approve(lab, "E1")
    assert lab.pump() == ["R2#0"]
    assert codes(lab, "R1") == ["program", "experiment"]
    approve(lab, "R1")
    lab.check_log()


def test_further_runs_alike_go_on_if_the_operator_says_so() -> None:
    """Other values, the same workflow, in the same experiment; dangers are looked at each time."""
    lab = lab_with(dangerous=True)
    lab.do(StartExperiment("app", "ada"), ROBOT)
    approve(lab, "E1")

    def submit(number: int, pins: str = "w1", **more: Any) -> str:
        lab.do(SubmitRun(work(**more), "ada", {"n": number}, experiment=E1, pins={"workflow": pins}), ROBOT)
        return f"R{lab.state.runs.named}"

    approve(lab, submit(1), alike=True)
    assert not codes(lab, submit(2))
    assert codes(lab, submit(3, "w2")) == ["program"]
    assert codes(lab, submit(4, hazard="laser")) == ["dangerous"]
    # Not in another experiment, nor once this one has ended.
    lab.do(StartExperiment("app", "ada"), ROBOT)
    lab.do(SubmitRun(work(), "ada", experiment=ExperimentId("E2"), pins={"workflow": "w1"}), ROBOT)
    assert codes(lab, f"R{lab.state.runs.named}") == ["program", "experiment"]
    lab.do(CancelExperiment(E1, "ada"), "ada")
    lab.pump()
    for action in lab.list_flying():
        lab.finish(action)
    lab.pump()
    assert "E1" not in lab.state.approvals.alike


def test_an_experiment_that_nobody_approved_carries_nothing_out_at_its_end() -> None:
    """Its closing workflow neither, though labware was handed over to it."""
    lab = lab_with()
    lab.do(SubmitRun(route("stack", "a"), "ada"), "ada")
    lab.work(random.Random(1))
    name = LabwareId("P1")
    assert lab.owner(name) == "user:ada"
    lab.do(StartExperiment("app", "ada", work("clear away")), ROBOT)
    lab.do(HandOver(name, experiment_owner(E1), "ada"), "ada")
    lab.do(EndExperiment(E1), ROBOT)
    assert lab.pump() == []
    assert not lab.state.experiments.open
    assert not lab.state.runs.queued
    assert lab.owner(name) == "user:ada"


def test_a_second_person_is_asked_once() -> None:
    """Who approves a run of somebody else is also the second person that its dangers take."""
    lab = lab_with()
    lab.do(SubmitRun(work(dangerous="laser"), "ada"), ROBOT)
    assert [q.kind for q in lab.questions()] == ["approval"]
    approve(lab, "R1")
    assert lab.pump() == ["R1#0"]
    # Where operators may approve their own, the second person is still somebody else.
    lab = lab_with(own=True)
    lab.do(GrantRole("user:ada", "operator"))
    lab.do(SubmitRun(work(dangerous="laser"), "ada"), ROBOT)
    approve(lab, "R1", "ada")
    assert (lab.code("R1"), [q.kind for q in lab.questions()]) == ("unapproved", ["second_person"])
    lab.check_log()


def test_the_same_request_twice_is_one_proposal() -> None:
    lab = lab_with()
    lab.do(SubmitRun(work(), "ada", request="k"), ROBOT)
    approve(lab, "R1")
    assert lab.do(SubmitRun(work(), "ada", request="k"), ROBOT) == []
    assert lab.state.approvals.open == {}


def test_a_state_with_proposals_is_kept_in_a_picture() -> None:
    lab = lab_with(trusted=("x",))
    lab.do(screen(), ROBOT)
    assert from_picture(encode_picture(lab.state)) == lab.state


# -- priority ------------------------------------------------------------------------------------

CHEMISTS = Group(
    "chemistry", members={"ada": Member(), "bo": Member(quota=Quota(priority=-1))}, quota=Quota(priority=5)
)


@pytest.mark.parametrize(
    ("user", "priority", "fits"),
    [("ada", 5, True), ("ada", 6, False), ("bo", -1, True), ("bo", 0, False), ("olga", 99, True)],
)
@pytest.mark.parametrize(
    "submission",
    [
        lambda user, priority: SubmitRun(work(), user, priority=priority),
        lambda user, priority: StartExperiment("app", user, priority=priority),
        lambda user, priority: screen(user=user, terms=Terms(priority=priority)),
    ],
)
def test_groups_and_users_have_a_highest_priority(
    submission: Callable[[str, int], Command], user: str, priority: int, fits: bool
) -> None:
    lab = lab_with()
    lab.do(ApplyShares("s", (CHEMISTS,)), "root-1")
    if fits:
        lab.do(submission(user, priority), user)
        return
    found = lab.reject(submission(user, priority), user)
    assert found.code == "priority"
    assert "which is the highest for " in found.message
    # Nor may a program for them.
    assert lab.reject(submission(user, priority), on_behalf("robot", user)).code == "priority"


def test_a_policy_has_the_highest_priority_of_all_others() -> None:
    lab = lab_with(priority=0)
    assert lab.reject(SubmitRun(work(), "ada", priority=1), "ada").message == (
        "The priority 1 is above 0, which is the highest for whoever has no quota for it."
    )
    lab.do(SubmitRun(work(), "olga", priority=7), "olga")
    lab.do(screen(), "ada")
    assert lab.reject(AmendCampaign(C1, Terms(priority=1)), "ada").code == "priority"
    lab.do(AmendCampaign(C1, Terms(priority=4)), "olga")
    # What an operator has raised stays when the user changes something else.
    lab.do(AmendCampaign(C1, Terms(priority=4, tags=("x",))), "ada")
    assert feed(lab)
    assert lab.run("R2").priority == 4


def test_a_deadline_by_which_others_wait_can_take_an_approval() -> None:
    lab = lab_with(deadlines=True)
    lab.do(screen(terms=Terms(deadline=lab.now + 1)), "ada")
    assert codes(lab, "C1") == ["deadline"]
    lab.do(screen(user="olga", terms=Terms(deadline=lab.now + 1)), "olga")
    assert not codes(lab, "C2")
    approve(lab, "C1")
    lab.do(AmendCampaign(C1, Terms(deadline=lab.now)), "ada")
    assert codes(lab, "C1") == ["deadline"]
