"""Dangerous steps: the run waits until somebody else than its user has approved it."""

from __future__ import annotations

from itertools import product

from labos.core.campaigns import Budget
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.policy import (
    Submission,
    list_approval_reasons,
    may_need_approval,
    sum_demand_of_choices,
)
from labos.core.decide.runs import SubmitRun
from labos.core.decide.submissions import ApplyPolicy
from labos.core.decide.users import AddUser, GrantRole
from labos.core.ids import RunId
from labos.core.interventions import Intervention
from labos.core.model import Plan
from labos.core.policy import Policy
from labos.core.users import on_behalf
from tests.support.bench import Driver, plan, small, step
from tests.unit.core.test_rights import make_peopled


def make_burning(steps: int = 1) -> Plan:
    return plan(step("dev"), *(step("dev", dangerous="laser") for _ in range(steps)), name="burn")


def question_of(lab: Driver, run: str) -> Intervention:
    (found,) = lab.state.interventions.find_by_run(run)
    assert found.kind == "second_person"
    return found


def answer(lab: Driver, run: str, by: str, choice: str = "approve") -> ResolveIntervention:
    return ResolveIntervention(question_of(lab, run).id, choice, by)


def test_a_run_waits_until_a_second_person_has_approved_it() -> None:
    lab = make_peopled()
    lab.do(GrantRole("user:ada", "operator"))
    lab.do(SubmitRun(make_burning(), "ada"), "ada")
    assert lab.code("R1") == "unapproved"
    assert lab.pump() == []
    found = lab.reject(answer(lab, "R1", "ada"), "ada")
    assert (found.code, found.message) == (
        "second_person",
        "R1 is a run of ada and needs the approval of a second person.",
    )
    assert lab.reject(answer(lab, "R1", "bo"), "bo").code == "no_right"
    lab.do(answer(lab, "R1", "olga"), "olga")
    assert lab.pump() == ["R1#0"], "it was woken"
    assert not lab.find_missed()
    lab.check_log()


def test_a_program_is_no_second_person_whoever_it_acts_for() -> None:
    lab = make_peopled()
    lab.do(ApplyPolicy("p", Policy(programs=False)))
    lab.do(GrantRole("user:robot", "operator"))
    lab.do(SubmitRun(make_burning(), "ada"), on_behalf("robot", "ada"))
    for actor in ("robot", on_behalf("robot", "olga")):
        assert lab.reject(answer(lab, "R1", actor), actor).code == "second_person"
    # Not even if it says no more than the person's name.
    actor = on_behalf("robot", "olga")
    assert lab.reject(answer(lab, "R1", "olga"), actor).code == "second_person"
    # Nor is the person for whom it was submitted.
    lab.do(GrantRole("user:ada", "operator"))
    assert lab.reject(answer(lab, "R1", "ada"), "ada").code == "second_person"


def test_who_does_not_approve_cancels_it() -> None:
    lab = small()
    run = lab.submit(make_burning(), "ada")
    lab.do(answer(lab, run, "ada", "refuse"))
    assert lab.state.runs.get(run) is None
    assert not lab.state.interventions.open
    lab.check_log()


def test_the_question_goes_with_the_run() -> None:
    lab = small()
    run = lab.submit(make_burning(), "ada")
    lab.do(CancelRun(RunId(run)))
    assert not lab.state.interventions.open


def test_others_of_the_same_shape_do_not_wait_with_it() -> None:
    lab = small()
    first = lab.submit(make_burning(), "ada")
    second = lab.submit(plan(step("dev"), step("dev"), name="burn"), "ada")
    third = lab.submit(make_burning(), "ada")
    assert lab.pump() == [f"{second}#0"]
    lab.do(answer(lab, third, "bo"))
    assert (lab.code(first), lab.run(third).unapproved) == ("unapproved", False)
    lab.check_log()


def test_the_question_names_the_steps_and_whose_run_it_is() -> None:
    lab = small()
    run = lab.submit(make_burning(7), "ada")
    text = question_of(lab, run).text
    assert text.startswith("Run R1 (burn) of ada has dangerous steps: ")
    assert text.count("(laser)") == 5
    assert "and 2 more" in text


def test_users_are_not_needed_for_it() -> None:
    """In an open lab the names that people say have to differ."""
    lab = small()
    run = lab.submit(make_burning(), "ada")
    assert lab.reject(answer(lab, run, "ada")).code == "second_person"
    lab.do(AddUser("ada"))
    lab.do(AddUser("bo"))
    lab.do(GrantRole("user:bo", "operator"))
    lab.do(answer(lab, run, "bo"), "bo")
    assert lab.code(run) == ""


def test_where_no_approval_may_be_needed_there_is_no_reason_for_one() -> None:
    """Each field of a policy that can ask for an approval, alone and with the others; all kinds of users."""
    lab, found = make_peopled(), 0
    work = make_burning()
    demand = sum_demand_of_choices([work])
    fields = (
        {"programs": False},
        {"newcomers": 1},
        {"dangerous": True},
        {"above": Budget(lab_time_s=0.001)},
        {"deadlines": True},
        {"own": True},
    )
    others = {"trusted", "erasure", "priority", "bookings"}  # these never ask for an approval
    assert {*others, *(name for each in fields for name in each)} == {*Policy.__struct_fields__}
    for chosen in product((False, True), repeat=len(fields)):
        given = {
            name: value
            for use, each in zip(chosen, fields, strict=True)
            for name, value in each.items()
            if use
        }
        lab.do(ApplyPolicy(str(chosen), Policy(**given)))
        for actor, propose in product(("ada", "olga", "robot", on_behalf("robot", "ada")), (False, True)):
            asked = Submission("ada", work.workcell, demand, propose)
            reasons = list_approval_reasons(lab.state, asked, actor)
            found += bool(reasons)
            assert may_need_approval(lab.state, actor, "", propose=propose) or not reasons, (given, actor)
    assert found > 100
