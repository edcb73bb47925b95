"""A centrifuge with four places: what is in it is spun together, and nobody waits for that for ever."""

from __future__ import annotations

import random

import pytest

from labos.cli.explain import list_sentences
from labos.core.actions import ActionRequested
from labos.core.decide.actions import StartStep
from labos.core.decide.nodes import LoseNode
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.decide.together import StartTogether
from labos.core.ids import ActionId, ModuleName, RunId, StationName
from labos.core.model import Plan, StationSpec, Together, Window
from labos.core.setups import Setup
from labos.core.state import encode_picture, from_picture
from labos.planning.forecast import find_usual_time
from labos.planning.virtual import Play, VirtualLab
from labos.services.runs import RunHistory, StepHistory
from tests.support.bench import (
    SECOND,
    Driver,
    full,
    module,
    move,
    needs,
    plan,
    station,
    step,
    take,
    workcell,
)

PLACES = 4
TEN_MIN = Together(("spin",), 600.0)


def centrifuge(
    together: Together | None = TEN_MIN, *more: StationSpec, places: int = PLACES, setup: Setup | None = None
) -> Driver:
    lab = Driver(
        workcell(
            [
                module("arm"),
                module("arm2"),
                module(
                    "spinner", variables={"lid": "open"}, rest={"lid": "open"}, together=together, setup=setup
                ),
            ],
            [
                station("stack", "stack", 60),
                station("spinner.rotor", "hotel", places, access={"lid": "open"}),
                station("trash", "waste", 99),
                *more,
            ],
        )
    )
    lab.stock("stack", 60)
    return lab


def spin(g: int = 3000, **more: object) -> Plan:
    """Bring a plate, spin it, throw it away."""
    return plan(
        step("arm", take("stack", "spinner.rotor"), key="in", duration_s=30.0),
        step("spinner", needs(), action="spin", key="spin", args={"g": g}, duration_s=300.0, **more),
        step("arm", move("spinner.rotor", "trash"), key="out", duration_s=30.0),
        name=f"spin at {g}",
    )


def play(lab: Driver) -> Play:
    state = from_picture(encode_picture(lab.state))
    return VirtualLab(state, lab.now, lambda _, one: find_usual_time(state, one)).go_on()


def go_on(lab: Driver, rng: random.Random | None = None, rounds: int = 400) -> None:
    """Let actions end one after the other, those that a device does together at once; where nothing is in
    flight, let time pass to what is due next."""
    for _ in range(rounds):
        lab.pump()
        check_rotor(lab)
        flying = list(lab.state.actions.open.values())
        if flying:
            first = rng.choice(flying) if rng is not None else flying[0]
            lab.wait(300.0 if first.name == "spin" else 30.0)
            for name in first.together or (first.id,):
                lab.finish(name)
            continue
        due = lab.scheduler.find_next_deadline(lab.state)
        if due is None or not lab.state.runs.active:
            return
        lab.now = max(lab.now, due)
    raise AssertionError(f"it does not come to rest: {lab.describe_stuck()}")


def groups(lab: Driver) -> list[int]:
    """How many runs each turn of the rotor was for."""
    spins = [e.event for e in lab.log if isinstance(e.event, ActionRequested) and e.event.name == "spin"]
    return [len(s.together) or 1 for s in spins if not s.together or s.together[0] == s.action]


def check_rotor(lab: Driver) -> None:
    """The rotor turns for all whose labware is in it, and for nobody else."""
    spins = [action for action in lab.state.actions.open.values() if action.name == "spin"]
    if spins:
        inside = lab.state.bench.stations[StationName(full("spinner.rotor"))].labware
        owners = {lab.state.bench.labware[name].owner for name in inside}
        assert owners == {f"run:{action.run}" for action in spins}


def test_four_plates_are_spun_together() -> None:
    lab = centrifuge()
    for _ in range(8):
        lab.submit(spin())
    go_on(lab)
    assert groups(lab) == [4, 4]
    assert not lab.state.runs.active
    lab.check_log()


def test_they_start_in_one_decision_and_name_each_other() -> None:
    lab = centrifuge()
    for _ in range(4):
        lab.submit(spin())
    while "spin" not in {a.name for a in lab.state.actions.open.values()}:
        for name in lab.list_flying():
            lab.finish(name)
        lab.pump()
    spins = [a for a in lab.state.actions.open.values() if a.name == "spin"]
    assert {a.together for a in spins} == {tuple(a.id for a in spins)}
    positions = [a.position for a in spins]
    assert positions == list(range(positions[0], positions[0] + 4))
    assert {a.run for a in spins} == {"R1", "R2", "R3", "R4"}


def test_a_device_that_does_not_do_it_together_spins_one_by_one() -> None:
    lab = centrifuge(None)
    for _ in range(4):
        lab.submit(spin())
    go_on(lab)
    assert groups(lab) == [1, 1, 1, 1]


def test_nobody_waits_where_nobody_can_come() -> None:
    lab = centrifuge()
    lab.submit(spin())
    lab.pump()
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == ["R1#1"]


def test_others_with_other_arguments_are_not_waited_for_and_stay_out() -> None:
    lab = centrifuge()
    for g in (3000, 500, 3000, 500):
        lab.submit(spin(g))
    go_on(lab)
    assert sorted(groups(lab)) in ([2, 2], [1, 1, 2], [1, 1, 1, 1])
    assert not lab.state.runs.active


def test_the_wait_has_a_sentence_and_an_end() -> None:
    lab = centrifuge(Together(("spin",), 60.0), station("front"), station("back"))
    for _ in range(2):
        lab.submit(through_a_nest(3000, 1))
    lab.step("R1")
    lab.step("R1", 1)
    assert "R2#0" in lab.pump()
    [(index, wait)] = lab.scheduler.list_waits(lab.state, lab.run("R1"), lab.now)
    assert (index, wait.code, wait.until) == (2, "for_others", lab.now + 60 * SECOND)
    assert wait.reason.sentence.startswith(
        "it waits for labware of other runs, so that 'spin' is done together: "
        "1 of 4 places of spinner are taken; until "
    )
    assert lab.scheduler.find_next_wake() == wait.until
    lab.wait(61.0)  # the arm is slow
    assert lab.pump() == ["R1#2"]


def test_a_run_that_is_paused_inside_keeps_the_others_waiting_and_says_so() -> None:
    lab = centrifuge()
    lab.submit(spin())
    lab.submit(spin())
    lab.pump()
    lab.finish(lab.list_flying()[0])
    lab.pump()
    lab.do(PauseRun(RunId("R1"), "ada"))
    lab.finish(lab.list_flying()[0])
    assert lab.pump() == []
    [(_, wait)] = lab.scheduler.list_waits(lab.state, lab.run("R2"), lab.now)
    assert wait.code == "inside_too"
    told = "P1 of run R1 is also at spinner.rotor, and 'spin' acts on everything in it"
    assert wait.reason.sentence == told
    lab.do(ResumeRun(RunId("R1")))
    assert sorted(lab.pump()) == ["R1#1", "R2#1"]


def test_only_the_same_work_of_several_runs_is_started_together() -> None:
    lab = centrifuge()
    for g in (3000, 3000, 500):
        lab.submit(spin(g))
    for run in ("R1", "R2", "R3"):
        lab.step(run)

    def start(*runs: str) -> StartTogether:
        return StartTogether(
            tuple(StartStep(RunId(r), 1, ActionId(f"X{n}"), lab.now) for n, r in enumerate(runs))
        )

    assert lab.reject(start("R1", "R3")).code == "not_together"
    assert lab.reject(start("R1", "R1")).code == "not_together"
    assert lab.reject(start("R1")).code == "not_together"
    assert lab.reject(start("R1", "R2")).code == "inside_too", "R3's plate would be spun with them"
    assert lab.code("R1", 1) == "inside_too"


def test_work_with_other_arguments_stays_out_while_the_node_is_away() -> None:
    """Runs that need a module that is down count as stuck, and yet nobody may come in their way for good."""
    lab = centrifuge(TEN_MIN, station("front"), station("back"))
    lab.submit(through_a_nest(3000, 1))
    lab.submit(through_a_nest(500, 1))
    for run, index in (("R1", 0), ("R1", 1), ("R2", 0)):
        lab.step(run, index)
    lab.do(LoseNode(ModuleName(full("spinner")), "i1", "silence"))
    assert lab.pump() == []
    lab.join("spinner")
    assert lab.pump() == ["R1#2"]


def test_each_run_is_charged_its_part_of_the_time() -> None:
    lab = centrifuge()
    for user in ("ada", "ada", "bo"):
        lab.submit(spin(), user)
        lab.step(f"R{lab.state.runs.named}")
    assert len(lab.pump()) == 3
    lab.wait(300.0)
    for name in lab.list_flying():
        lab.finish(name)
    assert [lab.state.shares.usage[user].used_ns / SECOND for user in ("ada", "bo")] == [200.0, 100.0]
    assert not lab.state.shares.parts


def test_explain_says_with_whom() -> None:
    lab = centrifuge()
    for _ in range(3):
        lab.submit(spin())
        lab.step(f"R{lab.state.runs.named}")
    assert len(lab.pump()) == 3
    steps = [StepHistory(1, "spin", "cell/spinner", "spin", "in flight")]
    story = RunHistory("R2", "spin at 3000", "cell", "ada", "", 0, steps)
    assert list_sentences(lab.state, story, lab.now)[0].endswith("; together with R1, R3")


def test_a_running_clock_ends_the_wait() -> None:
    lab = centrifuge()
    for _ in range(2):
        lab.submit(spin(windows=(Window(0, within_s=900.0),)))
    lab.pump()
    lab.finish(lab.list_flying()[0])
    assert "R1#1" in lab.pump()


def test_a_forecast_knows_that_they_are_spun_together() -> None:
    lab = centrifuge()
    for _ in range(4):
        lab.submit(spin())
    told = play(lab)
    assert not told.stays
    assert (max(told.ends.values()) - lab.now) / SECOND == 4 * 30 + 300 + 4 * 30


def test_a_set_up_is_a_part_of_each_of_the_actions() -> None:
    lab = centrifuge(setup=Setup("g", 60.0))
    for _ in range(2):
        lab.submit(spin())
    for run in ("R1", "R2"):
        lab.step(run)
    assert sorted(lab.pump()) == ["R1#1", "R2#1"]
    spinner = lab.state.modules.by_name[ModuleName(full("spinner"))]
    assert [flight.setup_s for flight in spinner.in_flight.values()] == [60.0, 60.0]
    assert (play(lab).begun[RunId("R1"), 2] - lab.now) / SECOND == 360.0


def through_a_nest(g: int, turn: int) -> Plan:
    """In by a nest in front of the centrifuge, and out by the same nest, or another."""
    out = ("front", "back")[turn % 2]
    return plan(
        step("arm", take("stack", "front"), key="get", duration_s=20.0),
        step("arm2", move("front", "spinner.rotor"), key="in", duration_s=20.0),
        step("spinner", needs(), action="spin", key="spin", args={"g": g}, duration_s=300.0),
        step("arm2", move("spinner.rotor", f"{out}"), key="out", duration_s=20.0),
        step("arm", move(f"{out}", "trash"), key="away", duration_s=20.0),
        name=f"spin at {g} to {out}",
    )


def two_plates(g: int) -> Plan:
    """Two plates of one run, which may be brought in either order, and are spun together."""
    spun = {"action": "spin", "args": {"g": g}, "duration_s": 300.0}
    return plan(
        step("arm", take("stack", "spinner.rotor"), key="one", duration_s=20.0),
        step("arm2", take("stack", "front"), key="other", duration_s=20.0),
        step("arm2", move("front", "spinner.rotor"), key="in", duration_s=20.0, after=(1,)),
        step("spinner", needs(), key="spin", after=(0, 2), **spun),
        step("arm", move("spinner.rotor", "trash"), key="out", duration_s=20.0, after=(3,)),
        step("arm2", move("spinner.rotor", "back"), key="back", duration_s=20.0, after=(3,)),
        step("arm", move("back", "trash"), key="away", duration_s=20.0, after=(5,)),
        name=f"two at {g}",
        parallel=True,
    )


@pytest.mark.parametrize("seed", range(20))
def test_runs_whose_steps_have_no_order_wait_for_nobody_for_ever(seed: int) -> None:
    """What a run brings last is known only when it is there: who is not ready keeps the others waiting."""
    rng = random.Random(f"two/{seed}")
    nests = [station("front"), station("back")]
    lab = centrifuge(Together(("spin",), 600.0), *nests, places=rng.choice([2, 3, 4]))
    lab.careful = False
    for _ in range(8):
        kinds = [two_plates, two_plates, spin, lambda g: through_a_nest(g, rng.randint(0, 1))]
        lab.submit(rng.choice(kinds)(rng.choice([500, 3000])))
        if rng.random() < 0.5:
            lab.pump()
            for action in list(lab.state.actions.open.values())[:1]:
                for name in action.together or (action.id,):
                    lab.finish(name)
    go_on(lab, rng)
    assert not lab.state.runs.active, lab.describe_stuck()
    assert not lab.state.runs.queued, lab.describe_stuck()


@pytest.mark.parametrize("seed", range(30))
def test_nobody_waits_for_ever(seed: int) -> None:
    """Arguments, ways in and out, places, waits, users and ends at random: every run comes to its end, and
    each turn of the rotor was for all whose labware was in it."""
    rng = random.Random(f"spin/{seed}")
    together = Together(("spin",), rng.choice([0.0, 60.0, 600.0, 36000.0]))
    nests = [station("front"), station("back")]
    lab = centrifuge(together, *nests, places=rng.choice([1, 2, 3, 4]))
    lab.careful = seed < 4
    for _ in range(20):
        made = rng.choice([spin, lambda g: through_a_nest(g, rng.randint(0, 1))])(rng.choice([500, 3000]))
        lab.submit(made, rng.choice(["ada", "bo"]), priority=rng.choice([0, 0, 1]))
        if rng.random() < 0.5:
            lab.pump()
            check_rotor(lab)
            lab.wait(rng.uniform(0, 300))
            for action in list(lab.state.actions.open.values())[:1]:
                for name in action.together or (action.id,):
                    lab.finish(name)
    go_on(lab, rng)
    assert not lab.state.runs.active, lab.describe_stuck()
    assert not lab.state.runs.queued, lab.describe_stuck()
    assert not lab.rejected
    assert lab.find_missed() == []
