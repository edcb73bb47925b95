"""A cancelled run goes its way out from where it stands, if its plan has one."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.cancelling import CancelRun, GiveUpWayOut, TakeWayOut
from labos.core.decide.runs import PauseRun
from labos.core.model import ON_CANCEL, Plan, PlanStep
from labos.core.runs import DONE, IN_FLIGHT, PENDING, SKIPPED, RunCancelled, RunCancelling, RunLeaving
from tests.support.bench import Driver, move, needs, plan, requires, sets, small, step, take

MAIN_STEPS = (
    step("arm", take("stack", "a")),
    step("arm", move("a", "dev.n1")),
    step("dev", sets("lid", "closed")),
    step("dev", needs(), requires("lid", "closed")),
    step("dev", sets("lid", "open")),
    step("arm", move("dev.n1", "hotel")),
)
OUT = (
    step("dev", sets("lid", "open")),
    step("arm", move("a", "b")),
    step("arm", move("b", "trash")),
    step("arm", move("dev.n1", "trash")),
)


def with_way_out(*out: PlanStep, main: tuple[PlanStep, ...] = MAIN_STEPS) -> Plan:
    flow = plan(*main)
    first = len(flow.steps)
    steps = [
        msgspec.structs.replace(s, key=f"on_cancel/{n}", part=ON_CANCEL, after=tuple(range(first, first + n)))
        for n, s in enumerate(out)
    ]
    return msgspec.structs.replace(flow, steps=(*flow.steps, *steps))


def under_way(steps: int, flow: Plan | None = None) -> tuple[Driver, str]:
    """A run of which so many steps are done, and the next one is in flight."""
    lab = small()
    run = lab.submit(flow or with_way_out(*OUT))
    for _ in range(steps):
        lab.pump()
        lab.finish(lab.list_flying()[0])
    lab.pump()
    return lab, run


def goes(lab: Driver, run: str) -> list[int]:
    """Cancel a run and let everything end; the steps of its way out that were done."""
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    while lab.list_flying():
        lab.finish(lab.list_flying()[0])
        lab.pump()
    leaving = [entry.event for entry in lab.log if isinstance(entry.event, RunLeaving)]
    assert lab.types()[-1] == "run.cancelled"
    lab.check_log()
    return [index - len(MAIN_STEPS) for event in leaving for index in event.steps]


@pytest.mark.parametrize(
    ("in_flight", "way"),
    [
        pytest.param(0, [1, 2], id="by way of b"),
        pytest.param(1, [3], id="from the device"),
        pytest.param(2, [0, 3], id="its lid has to be opened"),
        pytest.param(3, [0, 3], id="while it works"),
        pytest.param(4, [3], id="its lid is open by then"),
    ],
)
def test_the_way_depends_on_where_it_stands_when_nothing_is_in_flight(in_flight: int, way: list[int]) -> None:
    lab, run = under_way(in_flight)
    assert goes(lab, run) == way
    assert not lab.state.bench.list_owned("user:ada")  # type: ignore[arg-type]
    assert "labware.removed" in lab.types()
    assert not lab.questions()


def test_a_run_whose_last_step_ends_well_is_complete() -> None:
    lab, run = under_way(5)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    assert lab.types()[-1] == "run.completed"


def test_the_steps_that_are_needed_follow_one_another_over_those_that_are_not() -> None:
    lab, run = under_way(3)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == [f"{run}#6"]
    assert lab.code(run, 9) == "after"


def test_its_states_tell_that_it_leaves() -> None:
    lab, run = under_way(1)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert lab.run(run).status == "leaving"
    assert lab.run(run).statuses[:6] == [DONE, DONE, SKIPPED, SKIPPED, SKIPPED, SKIPPED]
    assert lab.run(run).statuses[6:9] == [SKIPPED] * 3


def test_labware_may_stay() -> None:
    lab, run = under_way(1)
    lab.do(CancelRun(run, stay=True))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    assert lab.types()[-1] == "run.cancelled"
    assert lab.question("failed_run")
    assert lab.at("dev.n1")


def test_a_run_on_its_way_out_can_be_left_where_it_is() -> None:
    lab, run = under_way(0)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert lab.run(run).status == "leaving"
    assert lab.do(CancelRun(run)) == []  # type: ignore[arg-type]
    lab.do(CancelRun(run, stay=True))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert lab.types()[-1] == "run.cancelled"
    assert lab.at("b")


def test_one_that_has_not_begun_just_ends() -> None:
    lab = small(0)
    run = lab.submit(with_way_out(*OUT))
    lab.do(CancelRun(run))
    assert lab.types()[-1] == "run.cancelled"


def test_a_paused_run_leaves_too() -> None:
    lab, run = under_way(1)
    lab.do(PauseRun(run))  # type: ignore[arg-type]
    assert goes(lab, run) == [3]


def test_a_failure_while_it_waits_for_the_end_does_not_keep_it() -> None:
    lab, run = under_way(1)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.fail(lab.list_flying()[0], "none")
    lab.pump()
    assert lab.run(run).steps[7].status == IN_FLIGHT  # from a to b
    while lab.list_flying():
        lab.finish(lab.list_flying()[0])
        lab.pump()
    assert lab.types()[-1] == "run.cancelled"


def test_where_nobody_knows_where_its_labware_is_it_goes_nowhere() -> None:
    lab, run = under_way(1)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.fail(lab.list_flying()[0], "unknown")
    lab.pump()
    assert "run.leaving" not in lab.types()
    assert lab.types()[-1] == "run.cancelled"
    assert lab.question("lost_labware")


def test_a_step_of_the_way_out_that_fails_ends_it_with_a_question() -> None:
    lab, run = under_way(0)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    lab.pump()
    lab.fail(lab.list_flying()[0], "none", "jam")
    assert lab.types()[-1] == "run.cancelled"
    assert "its way out failed" in lab.question("failed_run").text


def test_a_way_out_that_is_blocked_for_good_is_given_up() -> None:
    lab, run = under_way(0, with_way_out(step("arm", move("a", "c"))))
    lab.stock("c", 1)
    lab.do(CancelRun(run))  # type: ignore[arg-type]
    lab.finish(lab.list_flying()[0])
    lab.pump()
    assert lab.types()[-1] == "run.cancelled"
    assert "its way out is blocked" in lab.question("failed_run").text


def test_commands_that_come_too_late_change_nothing() -> None:
    lab, run = under_way(1)
    assert lab.do(TakeWayOut(run)) == []  # type: ignore[arg-type]
    assert lab.do(GiveUpWayOut(run)) == []  # type: ignore[arg-type]
    assert lab.run(run).steps[2].status == PENDING


def test_what_the_person_said_who_cancelled_is_in_the_log() -> None:
    lab, run = under_way(1)
    queued = lab.submit(with_way_out(*OUT))
    lab.do(CancelRun(run, why="wrong plate"))  # type: ignore[arg-type]
    lab.do(CancelRun(queued, why="no more reagent"))  # type: ignore[arg-type]
    events = [entry.event for entry in lab.log]
    assert [e.reason for e in events if isinstance(e, RunCancelling)] == ["wrong plate"]
    assert [e.why for e in events if isinstance(e, RunCancelled)] == ["no more reagent"]
    with pytest.raises(AssertionError, match="The field 'why' has"):
        lab.do(CancelRun(run, stay=True, why="x" * 3000))  # type: ignore[arg-type]


def test_a_tool_is_fetched_only_if_it_is_off_and_put_back_only_if_it_is_on() -> None:
    """Steps that need a state and set another one are left out where the other one is there already."""
    flow = with_way_out(
        step("dev", requires("lid", "open"), sets("lid", "closed")),
        step("dev", requires("lid", "closed"), sets("lid", "open")),
    )
    lab, run = under_way(2, flow)  # the lid is being closed
    assert goes(lab, run) == [1]
    lab, run = under_way(4, flow)  # it is being opened
    assert goes(lab, run) == [0, 1]
