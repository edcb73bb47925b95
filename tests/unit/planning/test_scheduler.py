"""What is started when: in a fair order, looked at only where something has changed."""

from __future__ import annotations

import random

import pytest

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.experiments import EndExperiment
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.nodes import LoseNode, PutBack, TakeOut
from labos.core.decide.runs import PauseRun, ResumeRun, SubmitRun
from labos.core.ids import ExperimentId, ModuleName
from labos.core.model import Plan, Window
from labos.core.shares import Usage
from labos.planning.scheduler import Scheduler
from labos.planning.touch import every_wait_key
from labos.planning.waiting import PATIENCE, PRIORITY_WEIGHT, WaitingRoom, find_head
from tests.support.bench import (
    SECOND,
    Driver,
    consumes,
    full,
    module,
    move,
    plan,
    route,
    sets,
    small,
    small_cell,
    station,
    step,
    take,
    workcell,
)

QUERY = plan(step("dev"))
LONG = plan(step("dev"), step("dev"), name="long")


def use_lab_time(lab: Driver, **seconds: float) -> None:
    """Lab time that users have had."""
    for user, value in seconds.items():
        lab.state.shares.usage[user] = Usage(value * SECOND, lab.now)


def sequence(lab: Driver) -> list[str]:
    """The order in which everything runs on the one module that all want."""
    started = lab.pump()
    while lab.list_flying():
        lab.finish(lab.list_flying()[0])
        started += lab.pump()
    return started


# -- order ------------------------------------------------------------------------------------------


def test_of_one_user_the_oldest_goes_first() -> None:
    lab = small()
    for _ in range(3):
        lab.submit(QUERY)
    assert sequence(lab) == ["R1#0", "R2#0", "R3#0"]


def test_priority_goes_before_age() -> None:
    lab = small()
    lab.submit(QUERY)
    lab.submit(QUERY, priority=5)
    lab.submit(QUERY, priority=9)
    assert sequence(lab) == ["R3#0", "R2#0", "R1#0"]


def test_who_has_had_less_goes_first() -> None:
    lab = small()
    use_lab_time(lab, ada=100.0, bob=5.0)
    lab.submit(QUERY, user="ada")
    lab.submit(QUERY, user="bob")
    lab.submit(QUERY, user="new")
    assert sequence(lab) == ["R3#0", "R2#0", "R1#0"]


def test_users_take_turns() -> None:
    lab = small()
    for user in ("ada", "ada", "ada", "bob", "bob"):
        lab.submit(QUERY, user=user)
    order = []
    lab.pump()
    while lab.list_flying():
        order.append(next(iter(lab.state.actions.open.values())).run)
        lab.wait(10)
        lab.finish(lab.list_flying()[0])
        lab.pump()
    assert order == ["R1", "R4", "R2", "R5", "R3"]


def test_time_used_long_ago_counts_less() -> None:
    lab = small()
    use_lab_time(lab, ada=100.0)
    lab.wait(10 * 24 * 3600)
    use_lab_time(lab, bob=5.0)
    lab.submit(QUERY, user="ada")
    lab.submit(QUERY, user="bob")
    assert sequence(lab)[0] == "R1#0"


def test_who_is_inside_goes_before_who_waits_outside() -> None:
    lab = small()
    lab.submit(LONG)
    lab.submit(QUERY)
    assert sequence(lab) == ["R1#0", "R1#1", "R2#0"]


def test_a_closing_window_goes_before_everything() -> None:
    lab = small()
    timed = plan(
        step("cam", exclusive=False),
        step("dev", windows=(Window(0, within_s=30.0),)),
    )
    lab.submit(plan(step("cam", exclusive=False), step("dev")), priority=9)
    lab.submit(timed)
    lab.submit(QUERY, priority=9)
    blocker = lab.start(lab.submit(plan(step("dev"))), 0)
    lab.pump()
    for action in lab.list_flying():
        if action != blocker:
            lab.finish(action)
    lab.pump()
    lab.finish(blocker)
    assert [s for s in sequence(lab) if s in ("R1#1", "R2#1", "R3#0")] == ["R2#1", "R1#1", "R3#0"]


# -- windows ----------------------------------------------------------------------------------------


def make_windowed(wait: float = 0.0, within: float | None = None, on_breach: str = "continue") -> Plan:
    window = Window(0, wait, within, on_breach)  # type: ignore[arg-type]
    return plan(step("dev"), step("cam", windows=(window,)))


def test_a_step_sleeps_until_its_time_has_come() -> None:
    lab = small()
    lab.submit(make_windowed(wait=60.0))
    lab.pump()
    lab.finish("A1")
    assert lab.pump() == []
    assert lab.scheduler.find_next_deadline(lab.state) == lab.now + 60 * SECOND
    lab.wait(59.0)
    before = lab.scheduler.evaluations
    assert lab.pump() == []
    assert lab.scheduler.evaluations == before
    lab.wait(1.0)
    assert lab.pump() == ["R1#1"]
    assert lab.scheduler.find_next_deadline(lab.state) is None


@pytest.mark.parametrize("on_breach", ["continue", "fail"])
def test_a_window_that_passes_is_breached_once(on_breach: str) -> None:
    lab = small()
    lab.submit(make_windowed(within=30.0, on_breach=on_breach))
    lab.pump()
    lab.do(TakeOut(ModuleName("cell/cam"), "service"))
    lab.finish("A1")
    lab.pump()
    assert lab.scheduler.find_next_deadline(lab.state) == lab.now + 30 * SECOND + 1
    lab.wait(30.0)
    lab.pump()
    assert "window.breached" not in lab.types()
    lab.wait(0.1)
    lab.pump()
    lab.pump()
    assert lab.types().count("window.breached") == 1
    assert lab.scheduler.find_next_deadline(lab.state) is None
    assert (lab.types()[-1] == "run.failed") == (on_breach == "fail")
    if on_breach == "continue":
        lab.do(PutBack(ModuleName("cell/cam")))
        assert lab.pump() == ["R1#1"]


def test_a_window_whose_anchor_has_not_ended_runs_for_nobody() -> None:
    lab = small()
    other = step("arm", take("stack", "a"))
    late = step("cam", windows=(Window(1, wait_s=5.0, within_s=9.0),))
    lab.submit(plan(step("dev"), other, late, parallel=True))
    assert list(lab.scheduler.iterate_due(lab.state, lab.now)) == []
    assert lab.pump()[0] == "R1#0"
    assert lab.scheduler.find_next_deadline(lab.state) is None


def test_alarms_of_steps_that_have_gone_on_are_forgotten() -> None:
    lab = small()
    lab.submit(make_windowed(wait=60.0))
    lab.pump()
    lab.finish("A1")
    lab.pump()
    lab.do(CancelRun(lab.run("R1").id))
    lab.pump()
    assert lab.scheduler.find_next_deadline(lab.state) is None


# -- the queue costs nothing ------------------------------------------------------------------------


def evaluations(queued: int) -> float:
    """Evaluations per event while 30 runs of a mixed queue go through a cell with a blocked head."""
    lab = small(stock=9)
    lab.careful = False
    lab.level("dev", "tips", 0.0)
    lab.submit(plan(step("dev", consumes("tips", 1.0))))
    work = [
        plan(step("cam"), step("cam", exclusive=False), name="c"),
        plan(step("arm2"), step("arm2"), name="a"),
    ]
    work.append(plan(step("arm"), step("dev", sets("lid", "open")), name="d"))
    for number in range(queued):
        lab.submit(work[number % 3], user=("ada", "bob")[number // 3 % 2])
    lab.pump()
    events, counted = len(lab.log), lab.scheduler.evaluations
    for _ in range(20):
        lab.wait(1)
        lab.finish(lab.list_flying()[0])
        lab.pump()
    return (lab.scheduler.evaluations - counted) / (len(lab.log) - events)


def test_evaluations_per_event_do_not_grow_with_the_queue() -> None:
    few, many = evaluations(30), evaluations(2000)
    assert many <= 1.5 * few, (few, many)


def test_ten_queued_cost_as_much_as_two_thousand() -> None:
    """Two of the ten finish before the queue runs low; the same two events of the two thousand."""

    def first_events(queued: int) -> float:
        lab = small()
        lab.careful = False
        for _ in range(queued):
            lab.submit(QUERY)
        lab.pump()
        before, events = lab.scheduler.evaluations, len(lab.log)
        for _ in range(8):
            lab.finish(lab.list_flying()[0])
            lab.pump()
        return (lab.scheduler.evaluations - before) / (len(lab.log) - events)

    assert first_events(2000) <= 1.5 * first_events(10)


def test_only_the_head_of_a_class_is_looked_at() -> None:
    lab = small()
    lab.start(lab.submit(LONG))
    for _ in range(50):
        lab.submit(QUERY)
    lab.pump()
    assert lab.scheduler.evaluations <= 4
    before = lab.scheduler.evaluations
    lab.submit(QUERY)
    lab.pump()
    assert lab.scheduler.evaluations == before, "behind a head that waits nobody is looked at"
    (group,) = lab.state.runs.queue
    assert find_head(lab.state, group).id == "R2"


def test_workflows_that_begin_alike_are_looked_at_together() -> None:
    lab = small()
    lab.careful = False
    lab.level("dev", "tips", 90.0)
    lab.start(lab.submit(LONG))
    for tips in range(40):
        lab.submit(plan(step("dev"), step("dev", consumes("tips", float(tips))), name=f"w{tips}"))
    lab.pump()
    before = lab.scheduler.evaluations
    lab.finish("A1")
    assert lab.pump() == ["R1#1"]
    assert lab.scheduler.evaluations <= before + 4, "forty bundles wait for the same module"


def test_of_workflows_that_begin_alike_only_that_waits_for_which_there_is_too_little() -> None:
    lab = small()
    lab.level("dev", "tips", 5.0)
    lab.start(lab.submit(LONG))
    for name, tips in (("much", 9.0), ("little", 4.0), ("none", 0.0)):
        lab.submit(plan(step("dev"), step("dev", consumes("tips", tips)), name=name))
    lab.pump()
    assert sequence(lab) == ["R1#1", "R3#0", "R3#1", "R4#0", "R4#1"]
    found = [wait for _, wait in lab.scheduler.wait_list.list_all()]
    assert [wait.code for wait in found] == ["used_up"]
    assert found == [wait for _, wait in lab.scheduler.list_waits(lab.state, lab.run("R2"), lab.now)]


def test_a_class_goes_on_with_its_next_head() -> None:
    lab = small()
    for _ in range(3):
        lab.submit(plan(step("dev", exclusive=False)))
    assert lab.pump() == ["R1#0", "R2#0", "R3#0"]


def test_a_plan_with_several_first_steps_starts_with_one_that_can() -> None:
    lab = small()
    lab.start(lab.submit(QUERY, user="eve"))
    run = lab.submit(plan(step("dev"), step("cam"), parallel=True, name="both"))
    waits = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    assert [(index, wait.code) for index, wait in waits] == [(0, "module_busy")]
    assert lab.pump() == ["R2#1"]
    lab.finish("A1")
    assert lab.pump() == ["R2#0"]


# -- nobody starves ---------------------------------------------------------------------------------


def test_a_head_that_was_overtakings_often_enough_is_protected() -> None:
    lab = small()
    use_lab_time(lab, bob=1e6)
    blocker = lab.start(lab.submit(QUERY, user="eve"))
    elder = lab.submit(QUERY, user="bob")
    for _ in range(PATIENCE + 6):
        lab.submit(QUERY, user="ada")
    lab.finish(blocker)
    order = [name.partition("#")[0] for name in sequence(lab)]
    assert order.index(elder) == PATIENCE
    assert len(order) == PATIENCE + 7


def test_a_queue_of_higher_priority_does_not_keep_a_run_out_for_ever() -> None:
    lab = small()
    lab.start(lab.submit(QUERY, user="eve"))
    low = lab.submit(QUERY, user="bob", priority=0)
    passed = 0
    while lab.run(low).status == "queued":
        while len(lab.state.runs.queued) < 3:
            lab.submit(QUERY, user="ada", priority=9)
        lab.finish(lab.list_flying()[0])
        passed += len(lab.pump())
        assert passed <= PATIENCE * PRIORITY_WEIGHT + 1, "it waits and waits"
    assert passed > PATIENCE * PRIORITY_WEIGHT, "priority goes first until then"


def test_others_are_told_for_whom_they_wait() -> None:
    lab = small()
    elder = lab.submit(plan(step("dev"), name="elder"), user="bob")
    lab.start(lab.submit(QUERY, user="eve"))
    young = lab.submit(QUERY, user="ada")
    lab.scheduler.room.overtake(lab.state, lab.run(elder), PATIENCE)
    free = lab.submit(plan(step("cam")), user="ada")
    lab.finish("A1")
    wait = lab.scheduler.check_start(lab.state, lab.run(young), 0, lab.now)
    assert wait is not None
    assert (wait.code, wait.names) == ("after_elder", (elder,))
    assert lab.scheduler.check_start(lab.state, lab.run(free), 0, lab.now) is None


@pytest.mark.parametrize("why", ["paused", "waits for a person"])
def test_nobody_waits_for_an_elder_who_cannot_start_anyway(why: str) -> None:
    lab = small()
    lab.level("dev", "tips", 5.0, 10.0)
    elder = lab.submit(
        plan(step("dev", consumes("tips", 9.0)) if why != "paused" else step("dev")), user="bob"
    )
    if why == "paused":
        lab.do(PauseRun(elder))
    lab.scheduler.room.overtake(lab.state, lab.run(elder), PATIENCE + 1)
    young = lab.submit(plan(step("dev"), step("cam")), user="ada")
    assert lab.scheduler.check_start(lab.state, lab.run(young), 0, lab.now) is None
    lab.do(CancelRun(elder))
    assert lab.scheduler.check_start(lab.state, lab.run(young), 0, lab.now) is None
    assert elder not in lab.scheduler.room._overtakings["cell"]


def test_nobody_waits_for_an_elder_whose_later_step_needs_a_dead_module() -> None:
    """Its first step could start at once: it is kept out because it could not come to its end."""
    lab = small()
    lab.do(LoseNode(ModuleName(full("cam")), "i1", "silence"))
    elder = lab.submit(plan(step("dev"), step("cam")), user="bob")
    lab.scheduler.room.overtake(lab.state, lab.run(elder), PATIENCE + 1)
    young = lab.submit(plan(step("dev")), user="ada")
    assert lab.scheduler.check_start(lab.state, lab.run(young), 0, lab.now) is None
    wait = lab.scheduler.check_start(lab.state, lab.run(elder), 0, lab.now)
    assert wait is not None
    assert (wait.code, wait.blocked) == ("module_down", True)
    assert wait.reason.sentence == "cam is GONE (silence)"


def test_nobody_waits_for_an_elder_who_waits_for_an_application() -> None:
    """The elder needs the place where an experiment has parked; the experiment's next run needs the elder
    to let it in."""
    lab = small()
    name = lab.experiment(closing=route("a", "trash"))
    lab.step(lab.submit(route("stack", "a"), experiment=name))
    elder = lab.submit(route("stack", "b", "a", "trash"), user="bob")
    lab.scheduler.room.overtake(lab.state, lab.run(elder), PATIENCE + 1)
    again = lab.submit(route("a", "b", "a"), experiment=name)
    assert lab.pump() == [f"{again}#0"]


def test_an_elder_of_higher_need_is_let_in_once_the_cell_empties() -> None:
    """The elder needs two nests at once; the younger ones each need one, and would share them
    among themselves for ever."""
    lab = Driver(
        workcell(
            [module("arm"), module("arm2"), module("cam")],
            [station("stack", "stack", 40), station("trash", "waste", 99), station("x"), station("y")],
        )
    )
    lab.stock("stack", 40)
    use_lab_time(lab, bob=1e6)
    both = plan(
        step("arm", take("stack", "x")),
        step("arm", take("stack", "y")),
        step("cam"),
        step("arm", move("x", "trash")),
        step("arm", move("y", "trash")),
    )
    lab.start(lab.submit(route("stack", "x", "trash"), user="eve"))
    elder = lab.submit(both, user="bob")
    for number in range(24):
        place = ("x", "y")[number % 2]
        lab.submit(plan(*route("stack", place, "trash").steps, name=f"n{number % 2}"), user="ada")
    order: list[str] = []
    lab.pump()
    while lab.list_flying():
        lab.wait(1)
        lab.finish(lab.list_flying()[0])
        order += [s.partition("#")[0] for s in lab.pump() if s.endswith("#0")]
    assert elder in order
    assert order.index(elder) <= PATIENCE + 4, order
    assert not lab.state.runs.queued


# -- waking -----------------------------------------------------------------------------------------


def test_a_start_that_is_rejected_is_not_proposed_for_ever() -> None:
    """The caller here carries nothing out, as if every start had been rejected."""
    lab = small()
    for _ in range(3):
        lab.submit(QUERY)
    lab.submit(plan(step("cam")))
    proposed = [start.run for start in lab.scheduler.iterate_proposals(lab.state, lab.now)]
    assert sorted(proposed) == ["R1", "R4"]


def test_a_new_scheduler_looks_at_everything_once() -> None:
    lab = small()
    lab.submit(LONG)
    lab.step("R1")
    lab.submit(plan(step("cam")))
    fresh = Scheduler()
    assert {(s.run, s.step) for s in fresh.iterate_proposals(lab.state, lab.now)} >= {("R1", 1)}


def test_a_run_that_has_ended_in_between_waits_for_nothing() -> None:
    lab = small()
    wait = lab.scheduler.check_start(lab.state, None, 0, lab.now)
    assert wait is not None
    assert wait.code == "gone"
    for _ in range(2):
        lab.scheduler.note_changes(lab.state, ("run:R9",))
        assert list(lab.scheduler.iterate_proposals(lab.state, lab.now)) == []


def test_pausing_and_resuming_wake() -> None:
    lab = small()
    lab.submit(LONG)
    lab.pump()
    lab.do(PauseRun(lab.run("R1").id))
    lab.finish("A1")
    assert lab.pump() == []
    lab.do(ResumeRun(lab.run("R1").id))
    assert lab.pump() == ["R1#1"]


def test_a_new_workcell_wakes() -> None:
    lab = small()
    lab.stock("a", 1, "lid")
    lab.submit(route("a", "cam.nest"))
    assert lab.pump() == []
    cell = small_cell()
    wider = [station("cam.nest") if s.name == "cell/cam.nest" else s for s in cell.stations]
    lab.do(ApplyWorkcell(workcell(cell.modules, wider)))
    assert lab.pump() == ["R1#0"]


def test_who_waits_for_the_place_of_an_open_experiment_is_woken_when_it_closes() -> None:
    lab = small()
    experiment = lab.experiment(closing=route("b", "trash"))
    lab.submit(route("stack", "b"), experiment=experiment)
    assert lab.work(random.Random(1))
    other = lab.submit(route("stack", "a", "b", "trash"))
    assert lab.pump() == []
    assert lab.code(other) == ""  # nothing forbids it but safety
    lab.end(experiment)
    assert (
        every_wait_key("cell") in lab.keys
    )  # its closing workflow may wait for the very one that has to be woken
    lab.pump()
    assert lab.work(random.Random(1))


def test_what_another_run_lacks_keeps_no_run_with_the_same_first_step_waiting() -> None:
    lab = small()
    lab.level("dev", "ink", 0)
    lab.submit(plan(step("cam", exclusive=False), step("dev", consumes("ink", 1.0)), name="dry"))
    lab.submit(plan(step("cam", exclusive=False), step("cam"), name="free"))
    assert lab.pump() == ["R2#0"]


@pytest.mark.parametrize("seed", range(20))
def test_the_bundles_of_waiting_runs_are_those_that_a_new_scheduler_makes(seed: int) -> None:
    rng = random.Random(seed)
    lab = small()
    plans = (QUERY, LONG, route("stack", "a", "trash"), route("stack", "b", "a", "trash"))
    closing = route("a", "trash")

    def check_bundles() -> None:
        room, expected = lab.scheduler.room, WaitingRoom()
        expected.fill(lab.state)
        waiting = {group: room._bundle_of.get(group) for group in lab.state.runs.queue}
        assert waiting == expected._bundle_of
        assert room._present == expected._present

    for _ in range(60):
        flying, experiments = lab.list_flying(), list(lab.state.experiments.open)
        match rng.randrange(4):
            case 0:
                experiment = (
                    rng.choice(["", *experiments]) if rng.random() < 0.8 else lab.experiment(closing=closing)
                )
                lab.ask(
                    SubmitRun(
                        rng.choice(plans), rng.choice(["ada", "bob"]), experiment=ExperimentId(experiment)
                    )
                )
            case 1 if experiments and rng.random() < 0.3:
                lab.ask(EndExperiment(rng.choice(experiments)))
            case _ if flying:
                lab.finish(rng.choice(flying))
        lab.pump()
        check_bundles()
