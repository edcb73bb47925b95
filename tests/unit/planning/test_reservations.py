"""Room is kept for steps whose clock runs, softly: in time, for as long as it helps, for nobody who
has to move first."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from labos.core.decide.cancelling import CancelRun
from labos.core.decide.nodes import TakeOut
from labos.core.decide.runs import PauseRun
from labos.core.decide.stock import UnloadStation
from labos.core.ids import ModuleName, StationName
from labos.core.model import Plan, PlanStep, Window
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.reservations import Reservations
from labos.planning.scheduler import Scheduler
from labos.planning.waiting import PATIENCE
from tests.support.bench import (
    SECOND,
    Driver,
    claims,
    hold,
    module,
    move,
    needs,
    plan,
    releases,
    sets,
    small,
    station,
    step,
    take,
    workcell,
)
from tests.unit.planning.cases import Case


def read(wait: float = 60.0, within: float | None = 100.0, takes: float = 10.0) -> Plan:
    """A run that starts a clock on ``dev`` and has to be read on ``cam`` in time."""
    window = Window(0, wait, within)
    return plan(
        step("dev", key="dose", duration_s=10.0),
        step("cam", key="read", duration_s=takes, windows=(window,)),
        name="read",
    )


def picture(takes: float) -> Plan:
    return plan(step("cam", duration_s=takes), name=f"picture {takes}")


def start_clock(lab: Driver, what: Plan | None = None, **more: float) -> str:
    """A run whose clock has just been started by its step on ``dev``."""
    run = lab.submit(what or read(**more))
    assert lab.pump()[0] == f"{run}#0"
    lab.finish(lab.list_flying()[0])
    lab.pump()
    return run


def why(lab: Driver, run: str, index: int = 0) -> Wait | None:
    return lab.scheduler.check_start(lab.state, lab.state.runs.get(run), index, lab.now, only_asking=True)


def code(lab: Driver, run: str, index: int = 0) -> str:
    wait = why(lab, run, index)
    return wait.code if wait is not None else ""


# -- in time or not --------------------------------------------------------------------------------


def test_who_would_still_be_there_at_the_deadline_waits_and_is_told_for_whom() -> None:
    lab = small()
    start_clock(lab)
    run = lab.submit(picture(takes=95.0))
    assert lab.pump() == []
    wait = why(lab, run)
    assert wait is not None
    assert (wait.code, wait.names, wait.blocked) == ("reserved", ("cell/cam", "R1", "read"), False)
    assert wait.reason.sentence == "cam is reserved for run R1, whose step 'read' has to start in time"
    assert wait.until == lab.now + 60 * SECOND, "it is looked at again when the step may start"
    assert {"window:R1", "module:cell/cam", "cell:cell"} <= set(wait.on)


def test_who_ends_in_time_is_not_stopped() -> None:
    lab = small()
    start_clock(lab)
    run = lab.submit(picture(takes=90.0))
    assert lab.pump() == [f"{run}#0"]


def test_durations_pass_at_the_pace_of_the_lab() -> None:
    lab = Driver(workcell([module("dev"), module("cam")], []), pace=10.0)
    start_clock(lab)
    assert code(lab, lab.submit(picture(takes=95.0))) == "reserved"
    assert code(lab, lab.submit(picture(takes=85.0))) == ""
    lab.wait(6.0)
    assert lab.pump() == ["R1#1"]


def test_the_wait_ends_with_the_step_that_it_was_for() -> None:
    lab = small()
    start_clock(lab)
    lab.submit(picture(takes=95.0))
    lab.wait(60.0)
    assert lab.pump() == ["R1#1"]
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == ["R2#0"]
    assert lab.find_missed() == []


def test_nothing_is_held_after_the_deadline() -> None:
    """The windowed step cannot start: somebody has taken the plate away that it needs."""
    lab = small()
    lab.stock("cam.nest", 1)
    window = Window(0, within_s=100.0)
    reads = lab.submit(plan(step("dev"), step("cam", needs("cam.nest"), windows=(window,))))
    assert lab.pump() == [f"{reads}#0"]
    lab.do(UnloadStation(StationName("cell/cam.nest"), by="ada"))
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == []
    run = lab.submit(picture(takes=300.0))
    assert lab.pump() == []
    wait = why(lab, run)
    assert wait is not None
    assert wait.until == lab.now + 100 * SECOND + 1
    lab.wait(100.0)
    assert lab.pump() == []
    lab.now += 1
    assert lab.pump() == [f"{run}#0"]
    assert "window.breached" in lab.types()
    assert lab.scheduler.reservations.list_open(lab.state, lab.now, "cell") == []


@pytest.mark.parametrize("how", ["paused", "cancelling", "its module is down"])
def test_nothing_is_held_for_a_run_that_cannot_go_on(how: str) -> None:
    lab = small()
    window = Window(0, 60.0, 100.0)
    beside = step("arm2", key="beside", after=(0,))
    read_it = step("cam", key="read", after=(0,), windows=(window,))
    run = lab.submit(plan(step("dev"), beside, read_it, step("arm", after=(2,)), parallel=True))
    lab.step(run)
    lab.start(run, 1)
    lab.pump()
    lab.submit(picture(takes=300.0))
    assert lab.pump() == []
    if how == "paused":
        lab.do(PauseRun(lab.run(run).id))
    elif how == "cancelling":
        lab.do(CancelRun(lab.run(run).id))
    else:
        lab.do(TakeOut(ModuleName("cell/cam"), "service"))
    assert lab.scheduler.reservations.list_open(lab.state, lab.now, "cell") == []
    assert lab.pump() == ([] if how == "its module is down" else ["R2#0"])


def test_the_way_to_the_step_is_reserved_too() -> None:
    """The arm has to be free a motion's time before the deadline."""
    lab = small()
    lab.stock("a", 1)
    window = Window(0, 60.0, 100.0)
    start_clock(
        lab,
        plan(
            step("dev"),
            step("arm", move("a", "cam.nest"), duration_s=30.0, windows=(Window(0, 60.0),)),
            step("cam", needs("cam.nest"), windows=(window,)),
        ),
    )
    assert code(lab, lab.submit(plan(step("arm", duration_s=63.0)))) == "reserved"
    assert code(lab, lab.submit(plan(step("arm", duration_s=60.0)))) == ""
    assert code(lab, lab.submit(plan(step("arm2", duration_s=500.0)))) == ""


def test_a_wait_on_the_way_counts() -> None:
    """The arm has to be done 50 s before the deadline, for the step after it has to wait so long."""
    lab = small()
    start_clock(
        lab,
        plan(
            step("dev"),
            step("arm", duration_s=10.0, windows=(Window(0, 5.0),)),
            step("cam", windows=(Window(0, 0.0, 100.0), Window(1, 50.0))),
        ),
    )
    assert code(lab, lab.submit(plan(step("arm", duration_s=40.0)))) == "reserved"
    assert code(lab, lab.submit(plan(step("arm", duration_s=34.0)))) == ""


# -- labware that would stay -----------------------------------------------------------------------


def make_carried_to(place: str) -> Plan:
    """A run whose plate has to be at a place within 100 s."""
    return plan(
        step("dev"),
        step("arm", take("stack", place), windows=(Window(0, 60.0, 100.0),)),
        step("arm", move(place, "trash")),
    )


@pytest.mark.parametrize(("between", "stopped"), [(60.0, ""), (95.0, "reserved")])
def test_labware_counts_until_its_run_carries_it_away(between: float, stopped: str) -> None:
    lab = small()
    start_clock(lab, make_carried_to("b"))
    guest = plan(
        step("arm2", take("stack", "b")), step("cam", duration_s=between), step("arm2", move("b", "trash"))
    )
    assert code(lab, lab.submit(guest)) == stopped


def test_labware_that_comes_to_rest_where_somebody_has_to_be_stays_away() -> None:
    lab = small()
    start_clock(lab, make_carried_to("b"))
    assert code(lab, lab.submit(plan(step("arm2", take("stack", "b"))))) == "reserved"
    assert code(lab, lab.submit(plan(step("arm2", take("stack", "c"))))) == ""


def test_where_there_is_room_for_more_nobody_waits() -> None:
    lab = small()
    start_clock(lab, make_carried_to("hotel"))
    for expected in ("", "", "reserved"):
        run = lab.submit(plan(step("arm2", take("stack", "hotel"))))
        assert code(lab, run) == expected
        if not expected:
            lab.step(run)


@pytest.mark.parametrize(("between", "stopped"), [(60.0, ""), (95.0, "reserved")])
def test_a_deck_is_taken_by_whoever_stands_on_it(between: float, stopped: str) -> None:
    lab = small()
    start_clock(lab, plan(step("cam"), step("dev", windows=(Window(0, 60.0, 100.0),))))
    guest = plan(
        step("arm", take("stack", "dev.n2")),
        step("cam", duration_s=between),
        step("arm", move("dev.n2", "trash")),
    )
    assert code(lab, lab.submit(guest)) == stopped


@pytest.mark.parametrize(("between", "stopped"), [(60.0, ""), (95.0, "reserved")])
def test_a_lid_that_is_shut_counts_until_it_is_opened(between: float, stopped: str) -> None:
    lab = small()
    start_clock(lab, plan(step("cam"), step("dev", windows=(Window(0, 60.0, 100.0),))))
    guest = plan(
        step("dev", sets("lid", "shut")), step("cam", duration_s=between), step("dev", sets("lid", "open"))
    )
    assert code(lab, lab.submit(guest)) == stopped


@pytest.mark.parametrize(("between", "stopped"), [(60.0, ""), (95.0, "reserved")])
def test_a_module_that_a_plan_holds_counts_until_it_lets_go(between: float, stopped: str) -> None:
    lab = small()
    start_clock(lab, plan(step("cam"), step("dev", windows=(Window(0, 60.0, 100.0),))))
    steps = (step("arm", duration_s=1.0), step("arm", duration_s=between), step("arm", duration_s=500.0))
    assert code(lab, lab.submit(plan(*steps, holds=(hold("dev", 0, 1),)))) == stopped


# -- whom a reservation never stops ----------------------------------------------------------------


def test_its_own_run_and_experiment_are_stopped_only_while_that_keeps_the_window() -> None:
    lab = small()
    experiment = lab.experiment()
    run = lab.submit(
        plan(
            step("dev"),
            step("cam", key="beside", duration_s=300.0, after=(0,)),
            step("cam", key="read", after=(0,), windows=(Window(0, 60.0, 100.0),)),
            parallel=True,
        ),
        experiment=experiment,
    )
    lab.step(run)
    assert code(lab, run, 1) == "follows_late", "it may as well be done after the reading"
    assert code(lab, lab.submit(picture(300.0), experiment=experiment)) == "would_delay"
    assert code(lab, lab.submit(picture(95.0), experiment=experiment)) == "", "no margin is kept among them"
    assert code(lab, lab.submit(picture(95.0))) == "reserved"
    lab.wait(60.0)
    assert lab.pump()[0] == f"{run}#2"
    lab.finish(lab.list_flying()[0])
    assert code(lab, run, 1) == ""


def test_of_two_that_reserve_against_each_other_the_earlier_deadline_goes_first() -> None:
    """Each needs both modules, one after the other, for longer than the other can wait. If the one with the
    earlier deadline goes first, the other is late by less than it would be itself."""
    lab = small()
    window = Window(0, 0.0, 30.0)

    def both(first: str, then: str, takes: float, deadline: float) -> Plan:
        late = replace(window, within_s=deadline)
        return plan(
            step("arm", exclusive=False, duration_s=0.1),
            step(first, key="one", duration_s=takes),
            step(then, key="two", duration_s=10.0, windows=(late,)),
        )

    later = lab.submit(both("dev", "cam", 100.0, 125.0))
    sooner = lab.submit(both("cam", "dev", 50.0, 60.0))
    lab.step(later)
    lab.step(sooner)
    assert code(lab, later, 1) == "reserved"
    assert code(lab, sooner, 1) == ""
    assert lab.pump() == [f"{sooner}#1"]
    order = [f"{sooner}#1"]
    while lab.list_flying():
        lab.wait(50.0)
        lab.finish(lab.list_flying()[0])
        order += lab.pump()
    assert order[:2] == [f"{sooner}#1", f"{sooner}#2"]
    assert len(order) == 4
    assert not lab.state.runs.active


def in_the_way() -> tuple[Driver, str]:
    """A run in a hurry has to bring its plate from ``a`` to ``b``, where a guest's plate stands."""
    lab = small()
    lab.stock("a", 1)
    guest = lab.submit(
        plan(
            step("arm2", take("stack", "b")),
            step("arm", move("b", "c"), duration_s=80.0),
            step("cam", duration_s=500.0),
            step("arm", move("c", "trash"), duration_s=80.0),
        )
    )
    lab.step(guest)
    hurry = plan(
        step("dev"),
        step("arm", move("a", "b"), duration_s=30.0),
        step("cam", windows=(Window(0, 0.0, 100.0),)),
        step("arm", move("b", "trash")),
    )
    lab.step(lab.submit(hurry))
    return lab, guest


def test_who_stands_in_the_way_may_go() -> None:
    lab, guest = in_the_way()
    stranger = lab.submit(plan(step("arm", duration_s=80.0)))
    assert code(lab, stranger) == "reserved"
    assert code(lab, guest, 1) == ""
    assert lab.pump() == [f"{guest}#1"]


def test_who_stands_in_the_way_of_somebody_in_the_way_may_go() -> None:
    lab, guest = in_the_way()
    third = lab.submit(
        plan(step("arm2", take("stack", "c")), step("arm", move("c", "trash"), duration_s=80.0))
    )
    lab.step(third)
    assert code(lab, guest, 1) == "occupied"
    assert code(lab, third, 1) == ""
    assert lab.pump() == [f"{third}#1"]


@pytest.mark.parametrize("how", ["hold", "setpoint"])
def test_who_holds_what_the_run_needs_may_go_on_until_it_lets_go(how: str) -> None:
    lab = small()
    lets_go = [step("arm", duration_s=300.0), step("dev", releases("t"), exclusive=False)]
    held = plan(
        step("arm2", *([claims("t", 37)] if how == "setpoint" else [])),
        *lets_go,
        holds=(hold("arm2", 0, 2),) if how == "hold" else (),
    )
    guest = lab.submit(held)
    lab.step(guest)
    window = Window(0, 0.0, 100.0)
    lab.step(
        lab.submit(
            plan(
                step("dev", key="dose"),
                step("arm2", *([claims("t", 42)] if how == "setpoint" else []), after=(0,)),
                step("arm", after=(1,), windows=(window,)),
            )
        )
    )
    assert code(lab, lab.submit(plan(step("arm", duration_s=300.0)))) == "reserved"
    assert code(lab, guest, 1) == ""


def test_an_experiment_that_parks_its_labware_in_the_way_may_fetch_it() -> None:
    lab = small()
    lab.stock("a", 1)
    experiment = lab.experiment()
    lab.step(lab.submit(plan(step("arm2", take("stack", "b"))), experiment=experiment))
    hurry = plan(
        step("dev"),
        step("arm", move("a", "b"), duration_s=30.0, windows=(Window(0, 0.0, 100.0),)),
        step("arm", move("b", "trash")),
    )
    lab.step(lab.submit(hurry))
    fetch = plan(step("arm", move("b", "trash"), duration_s=300.0))
    assert code(lab, lab.submit(plan(step("arm", duration_s=300.0)))) == "reserved"
    assert code(lab, lab.submit(fetch, user="eve")) == "not_yours"
    assert code(lab, lab.submit(fetch, experiment=experiment)) == ""


def test_who_would_be_trapped_by_the_run_may_go_before_it() -> None:
    """R2 in ``c`` has to pass ``b``; R1 may go to ``b`` by the rules, but then neither could ever go
    on. So R2 goes first, though its plate will be in ``b`` when R1's deadline comes."""
    lab = small()
    lab.stock("a", 1)
    hurry = lab.submit(
        plan(
            step("dev"),
            step("arm", move("a", "b"), windows=(Window(0, 0.0, 100.0),)),
            step("arm", move("b", "c")),
            step("arm", move("c", "trash")),
        )
    )
    other = lab.submit(
        plan(
            step("arm2", take("stack", "c")),
            step("arm2", move("c", "b")),
            step("cam", duration_s=300.0),
            step("arm2", move("b", "trash")),
        )
    )
    lab.step(other)
    lab.step(hurry)
    assert lab.code(hurry, 1) == ""
    assert code(lab, hurry, 1) == "unsafe"
    assert code(lab, other, 1) == ""
    assert lab.pump() == [f"{other}#1"]


def test_it_is_seen_in_time_that_somebody_has_to_go_first() -> None:
    """As before, but R1 has to wait. R2 does not wait with it: the sooner it goes, the less R1 is late."""
    lab = small()
    lab.stock("a", 1)
    hurry = lab.submit(
        plan(
            step("dev"),
            step("arm", move("a", "b"), windows=(Window(0, 60.0, 100.0),)),
            step("arm", move("b", "c")),
            step("arm", move("c", "trash")),
        )
    )
    other = lab.submit(
        plan(
            step("arm2", take("stack", "c")),
            step("arm2", move("c", "b")),
            step("cam", duration_s=300.0),
            step("arm2", move("b", "trash")),
        )
    )
    lab.step(other)
    lab.step(hurry)
    assert lab.pump() == [f"{other}#1"]


def test_no_room_is_kept_for_a_run_that_could_not_reach_its_end_anyway() -> None:
    """Its clock runs outside, but it is not let in: what another user has left at ``c`` is in the way
    of its last step."""
    lab = small()
    experiment = lab.experiment()
    lab.step(lab.submit(plan(step("dev", key="dose"), name="dose"), experiment=experiment))
    window = Window(None, 0.0, 100.0, of="dose", of_step="dose")
    hurry = plan(step("arm", take("stack", "b"), windows=(window,)), step("cam"), step("arm", move("b", "c")))
    stranger = plan(step("arm", duration_s=300.0))
    run = lab.submit(hurry, experiment=experiment)
    assert code(lab, lab.submit(stranger)) == "reserved"
    lab.step(lab.submit(plan(step("arm2", take("stack", "c"))), user="eve"))
    assert code(lab, run) == "no_way_out"
    assert len(lab.scheduler.reservations.list_open(lab.state, lab.now, "cell")) == 1
    assert code(lab, lab.submit(stranger)) == ""


def test_a_clock_that_runs_outside_does_not_wait_for_an_elder() -> None:
    """The elder waits for that clock's sake: if each waited for the other, both would be late."""
    lab = small()
    experiment = lab.experiment()
    lab.step(lab.submit(plan(step("dev", key="dose"), name="dose"), experiment=experiment))
    elder = lab.submit(picture(takes=300.0), user="bob")
    window = Window(None, 0.0, 100.0, of="dose", of_step="dose")
    hurry = lab.submit(plan(step("cam", windows=(window,))), experiment=experiment)
    lab.scheduler.room.overtake(lab.state, lab.run(elder), PATIENCE)
    assert code(lab, elder) == "reserved"
    assert code(lab, hurry) == ""
    assert lab.pump()[0] == f"{hurry}#0"


# -- clocks that had better not be started ---------------------------------------------------------


def test_a_clock_is_not_started_for_a_time_that_is_taken() -> None:
    lab = small()
    first = start_clock(lab, read(60.0, 62.0, takes=60.0))
    second = lab.submit(read(50.0, 55.0, takes=60.0))
    assert lab.pump() == []
    wait = why(lab, second)
    assert wait is not None
    assert (wait.code, wait.names) == ("reserved", ("cell/cam", first, "read"))
    lab.wait(60.0)
    assert lab.pump()[0] == f"{first}#1"
    assert f"{second}#0" in [*lab.pump(), f"{second}#0"]


def test_a_clock_is_started_where_both_find_their_time() -> None:
    lab = small()
    start_clock(lab, read(60.0, 62.0, takes=60.0))
    second = lab.submit(read(130.0, 200.0, takes=60.0))
    assert lab.pump() == [f"{second}#0"]


def test_a_stay_and_the_work_during_it_count_once() -> None:
    """A plate is brought to ``dev``, worked on and carried away: 132 s in all. Then there is time."""
    lab = small()
    lab.stock("a", 1)
    start_clock(
        lab,
        plan(
            step("cam"),
            step("arm", move("a", "dev.n1"), duration_s=10.0, windows=(Window(0, 5.0),)),
            step("dev", duration_s=100.0, windows=(Window(0, 0.0, 60.0),)),
            step("arm", move("dev.n1", "trash"), duration_s=10.0),
        ),
    )

    def after(seconds: float) -> str:
        window = Window(0, 50.0, seconds)
        return lab.submit(
            plan(step("arm2", exclusive=False), step("dev", duration_s=10.0, windows=(window,)))
        )

    assert code(lab, after(160.0)) == ""
    assert code(lab, after(100.0)) == "reserved"


def test_a_clock_that_is_about_to_start_counts() -> None:
    """The first clock's step is still in flight on another module."""
    lab = small()
    late = Window(0, 60.0, 62.0)
    first = lab.submit(plan(step("arm", duration_s=10.0), step("cam", duration_s=60.0, windows=(late,))))
    assert lab.pump() == [f"{first}#0"]
    assert code(lab, lab.submit(read(50.0, 60.0, takes=60.0))) == "reserved"


def test_a_clock_is_not_started_while_what_is_in_flight_lasts_too_long() -> None:
    lab = small()
    lab.start(lab.submit(picture(takes=300.0)))
    run = lab.submit(read(0.0, 100.0))
    wait = why(lab, run)
    assert wait is not None
    assert (wait.code, wait.names) == ("not_in_time", ("cell/cam", "read"))
    assert wait.reason.sentence == "cam will not be free in time for 'read'"
    lab.pump()
    lab.wait(210.0)
    assert code(lab, run) == "not_in_time"
    lab.wait(40.0)
    assert code(lab, run) == ""


def test_without_an_end_a_window_reserves_nothing() -> None:
    lab = small()
    start_clock(lab, within=None)
    assert lab.scheduler.reservations.list_open(lab.state, lab.now, "cell") == []
    assert code(lab, lab.submit(picture(1000.0))) == ""


# -- cost ------------------------------------------------------------------------------------------


class Counting(Reservations):
    """Counts how often it works the reservations out, and how many runs it looks at."""

    looked_at = 0

    def _work_out(self, state: LabState, now: int, cell: str) -> None:
        self.looked_at += len(state.runs.windowed)
        super()._work_out(state, now, cell)


def cost(queued: int) -> tuple[int, int]:
    """Runs looked at for reservations, and evaluations, while ten actions end."""
    lab = small()
    lab.careful = False
    counting = lab.scheduler.reservations = Counting(lab.scheduler.safety, {})
    start_clock(lab, read(500.0, 600.0))
    for number in range(queued):
        lab.submit(plan(step("cam", duration_s=20.0), name="short"), user=f"u{number % 2}")
        lab.submit(picture(takes=5000.0), user=f"u{number % 2}")
    lab.pump()
    counting.looked_at, before = 0, lab.scheduler.evaluations
    for _ in range(10):
        lab.wait(1.0)
        lab.finish(lab.list_flying()[0])
        lab.pump()
    return counting.looked_at, lab.scheduler.evaluations - before


def test_reservations_cost_nothing_for_those_who_queue() -> None:
    few, many = cost(20), cost(1000)
    assert few == many
    assert few[0] <= 60, "one run, a few times for each event"


# -- nobody stands still ---------------------------------------------------------------------------


def give_windows(rng: random.Random, case: Case) -> None:
    """Give about half of the plans a window, some of them one that cannot be kept."""

    def with_window(what: Plan) -> Plan:
        steps: list[PlanStep] = [replace(s, duration_s=rng.choice([2.0, 10.0, 60.0])) for s in what.steps]
        if rng.random() < 0.6 and len(steps) > 2:
            index = rng.randrange(1, len(steps))
            wait = rng.choice([0.0, 0.0, 30.0])
            window = Window(rng.randrange(index), wait, wait + rng.choice([5.0, 40.0, 300.0]))
            steps[index] = replace(steps[index], windows=(window,))
        return replace(what, steps=tuple(steps))

    case.plans = [with_window(what) for what in case.plans]


def live(rng: random.Random, lab: Driver) -> None:
    """Actions end in random order after about their time; time passes to the next alarm where
    nothing is in flight. Nothing may be left that a scheduler without memory would start, and nobody
    stands still only because of reservations."""
    for _ in range(3000):
        lab.pump()
        assert lab.find_missed() == [], lab.describe_stuck()
        flying = lab.list_flying()
        if flying:
            action = lab.state.actions.open[rng.choice(flying)]
            took = lab.state.runs.plan_of(lab.run(action.run)).steps[action.step].duration_s
            lab.wait(rng.uniform(0.1, 1.1) * took)
            lab.finish(action.id)
            continue
        runs = [*lab.state.runs.active.values(), *lab.state.runs.queued.values()]
        if not runs:
            return
        codes = {w.code for run in runs for _, w in lab.scheduler.list_waits(lab.state, run, lab.now)}
        assert "too_early" in codes or not codes & {"reserved", "not_in_time"}, (
            f"{codes} {lab.describe_stuck()}"
        )
        alarm = lab.scheduler.find_next_deadline(lab.state)
        assert alarm is not None, f"trapped: {lab.describe_stuck()}"
        lab.now = max(lab.now, alarm)
    raise AssertionError(f"the lab does not come to rest: {lab.describe_stuck()}")


@pytest.mark.parametrize("how", ["", "lids", "holds"])
@pytest.mark.slow
def test_nobody_stands_still_because_of_reservations(how: str) -> None:
    refused = 0
    for seed in range(40):
        rng = random.Random(seed)
        case = Case(rng, lids=how == "lids", holds=how == "holds")
        give_windows(rng, case)
        lab = case.submit_all()
        lab.careful = False
        live(rng, lab)
        assert not lab.state.runs.active, f"seed {seed}"
        assert not lab.state.runs.queued, f"seed {seed}"
        refused += lab.scheduler.reservations.refusals > 0
    assert refused > 6, "the cases are too easy: nobody ever had to wait"


def test_a_scheduler_that_starts_anew_decides_alike() -> None:
    lab = small()
    start_clock(lab)
    run = lab.submit(picture(takes=300.0))
    assert [w.code for _, w in Scheduler().list_waits(lab.state, lab.run(run), lab.now)] == ["reserved"]


def test_stations_without_a_module_are_reserved_by_name() -> None:
    lab = Driver(
        workcell([module("arm"), module("arm2"), module("dev")], [station("stack", "stack", 9), station("b")])
    )
    lab.stock("stack", 5)
    window = Window(0, 60.0, 100.0)
    start_clock(lab, plan(step("dev"), step("arm", take("stack", "b"), windows=(window,))))
    wait = why(lab, lab.submit(plan(step("arm2", take("stack", "b")))))
    assert wait is not None
    assert wait.names[0] == "cell/b"
