"""A run that needs a module that is down waits where it is in nobody's way, if it passes such a place."""

from __future__ import annotations

import random

import msgspec
import pytest

from labos.core.decide.nodes import LoseNode
from labos.core.envelope import Envelope
from labos.core.ids import ModuleName
from labos.core.model import Plan, Window
from labos.services.standstill import Cause, Standstill
from tests.support.bench import Driver, full, module, move, needs, plan, station, step, take, workcell


def cell(*more: str) -> Driver:
    """A sealer and a thermocycler with one place each, nests, and others as named."""
    lab = Driver(
        workcell(
            [*map(module, ("arm", "arm2", "sealer", "tc"))],
            [
                station("stack", "stack", 20),
                station("trash", "waste", 20),
                station("hotel", "hotel", 4),
                *(station(name) for name in ("a", "b", *more)),
                station("sealer.nest", "deck", claim=True),
                station("tc.nest", "deck", claim=True),
            ],
        )
    )
    lab.stock("stack", 12)
    return lab


def make_carried(*places: str) -> Plan:
    """Labware goes from place to place; devices work on it."""
    steps = [step("arm", take("stack", places[0]))]
    for here, there in zip(places, [*places[1:], "trash"], strict=True):
        if "." in here:
            steps.append(step(here.partition(".")[0], needs(here)))
        if there == "tc.nest":
            steps.append(step("tc", action="open"))
        steps.append(step("arm", move(here, there)))
    return plan(*steps, name="-".join(places))


def lose(lab: Driver, name: str = "tc") -> None:
    known = lab.state.modules.by_name[ModuleName(full(name))]
    lab.do(LoseNode(known.spec.name, known.instance, "silence"))


def cause(lab: Driver, run: str) -> Cause | None:
    """What the time that a run stands still is charged to."""
    account = Standstill()
    for entry in lab.log:
        what = entry.event.TYPE
        account.add(
            entry.event,
            Envelope(
                "lab", entry.position, "", entry.stream, entry.version, what, 1, entry.at, "labos", "", "", ""
            ),
        )
    return account.find_cause(lab.run(run))


def count_ended(lab: Driver) -> int:
    return lab.types().count("run.completed")


@pytest.mark.parametrize("seed", range(8))
def test_a_run_bound_for_a_dead_thermocycler_leaves_the_sealer_to_the_others(seed: int) -> None:
    lab = cell()
    lab.submit(make_carried("a", "sealer.nest", "tc.nest"))
    lab.pump()
    lab.finish("A1")
    lose(lab)
    for _ in range(5):
        lab.submit(make_carried("b", "sealer.nest"), user="bob")
    lab.work(random.Random(seed))
    assert count_ended(lab) == 5, lab.describe_stuck()
    assert lab.where("P1") == "a"
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run("R1"), lab.now)
    assert (wait.code, wait.names[1:]) == ("better_here", ("cell/tc",))
    assert lab.find_missed() == []
    assert cause(lab, "R1") == Cause("error", "node gone", "cell/tc", "operational")

    lab.join("tc")
    assert lab.work(random.Random(seed)), lab.describe_stuck()
    assert count_ended(lab) == 6
    lab.check_log()


def test_it_waits_also_where_nobody_needs_the_sealer_yet() -> None:
    lab = cell()
    lab.submit(make_carried("a", "sealer.nest", "tc.nest"))
    lab.pump()
    lose(lab)
    lab.work(random.Random(0))
    assert lab.where("P1") == "a"
    lab.submit(make_carried("b", "sealer.nest"), user="bob")
    lab.work(random.Random(0))
    assert count_ended(lab) == 1, lab.describe_stuck()


def test_who_finds_a_free_place_behind_the_sealer_goes_on_to_it() -> None:
    lab = cell()
    lab.submit(make_carried("a", "sealer.nest", "hotel", "tc.nest"))
    lab.pump()
    lab.finish("A1")
    lose(lab)
    for _ in range(3):
        lab.submit(make_carried("b", "sealer.nest"), user="bob")
    lab.work(random.Random(0))
    assert (count_ended(lab), lab.where("P1")) == (3, "hotel")


def test_who_is_in_the_way_where_it_is_goes_on_as_far_as_it_can() -> None:
    lab = cell()
    lab.submit(make_carried("a", "sealer.nest", "tc.nest"))
    lab.pump()
    lab.finish("A1")
    lose(lab)
    lab.submit(make_carried("a", "b"), user="bob")
    lab.work(random.Random(0))
    assert (count_ended(lab), lab.where("P1")) == (1, "sealer.nest")


def test_who_is_in_the_sealer_already_comes_out_of_it_if_its_way_leads_out() -> None:
    lab = cell()
    lab.submit(make_carried("sealer.nest", "b", "tc.nest"))
    lab.pump()
    lab.finish("A1")
    lose(lab)
    lab.submit(make_carried("a", "sealer.nest"), user="bob")
    lab.work(random.Random(0))
    assert (count_ended(lab), lab.where("P1")) == (1, "b")


def test_a_run_whose_clock_runs_goes_on_as_far_as_it_can() -> None:
    lab = cell()
    what = make_carried("a", "sealer.nest", "tc.nest")
    timed = msgspec.structs.replace(what.steps[2], windows=(Window(0, 0.0, 600.0),))
    lab.submit(msgspec.structs.replace(what, steps=(*what.steps[:2], timed, *what.steps[3:])))
    lab.pump()
    lose(lab)
    lab.work(random.Random(0))
    assert lab.where("P1") == "sealer.nest"
