"""Why safety keeps a run out, in words."""

from __future__ import annotations

from itertools import pairwise
from typing import get_args

from labos.core.reasons import AnyReason, BetterHere, NeedsPerson, Quota
from labos.planning.obstacle import explain_wait
from labos.services.waits import list_reasons
from tests.support.bench import Driver, module, move, plan, station, step, take, workcell

CELL = workcell(
    [module("arm"), module("dev"), module("reader")],
    [
        station("stack", "stack", 20),
        station("trash", "waste", 9),
        station("hall", "nest"),
        station("out", "hotel", 1),
        station("dev.nest", "deck", claim=True),
    ],
)


def cause(lab: Driver, run: str) -> str:
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    assert wait.code == "no_way_out"
    return explain_wait(lab.scheduler.safety, lab.state, lab.run(run), wait)


def through(*places: str) -> Driver:
    """A lab with plates, and a run R1 over these places that has been asked for."""
    lab = Driver(CELL)
    lab.stock("stack", 5)
    hops = [step("arm", take("stack", places[0]), key="get")]
    hops += [step("arm", move(a, b), key=f"to {b}") for a, b in pairwise(places)]
    lab.submit(plan(*hops))
    return lab


def test_a_full_place_at_the_end_is_named_with_what_stands_there() -> None:
    lab = through("hall", "out")
    lab.stock("out", 1, "lid")
    told = cause(lab, "R1")
    assert told == (
        "after 'get' the run could not reach its end at present: 'to out' needs room at out, "
        "where P1 of shared stands"
    )
    (reason,) = list_reasons(lab.state, lab.run("R1"), lab.now)
    assert (reason.why, bool(reason.remedy)) == (told, True)
    (plain,) = list_reasons(lab.state, lab.run("R1"), lab.now, causes=False)
    assert plain.why == "after 'get' the run could not reach its end at present"


def test_a_module_that_another_holds_is_named() -> None:
    lab = through("hall", "dev.nest")
    lab.stock("dev.nest", 1)
    assert "'to dev.nest' needs room at dev.nest, where P1 of shared stands" in cause(lab, "R1")


def test_a_run_that_will_come_to_rest_in_the_way_is_named() -> None:
    lab = through("hall", "out")
    assert lab.pump() == ["R1#0"]
    lab.finish(lab.list_flying()[0])
    lab.submit(plan(step("arm", take("stack", "dev.nest")), step("arm", move("dev.nest", "out"), key="end")))
    assert "'end' needs room at out, where labware of R1 comes to rest" in cause(lab, "R2")


def test_what_a_person_can_do_is_said_for_every_blocked_wait() -> None:
    people = {kind for kind in get_args(AnyReason) if issubclass(kind, NeedsPerson)}
    without = {kind for kind in people if not kind.REMEDY and "remedy" not in vars(kind)}
    assert without == {Quota, BetterHere}, "these end with a day, and with a module"
    lab = Driver(CELL)
    run = lab.submit(plan(step("arm", take("stack", "hall"), key="get")))
    ((_, wait),) = lab.scheduler.list_waits(lab.state, lab.run(run), lab.now)
    assert wait.reason.remedy == "Fill it and report that: labos load stack --type TYPE --count N --lot LOT"


def test_whoever_waits_for_a_module_in_doubt_hears_of_the_question() -> None:
    lab = Driver(CELL)
    first, second = (lab.submit(plan(step("dev"))) for _ in range(2))
    lab.doubt(lab.start(first))
    (reason,) = list_reasons(lab.state, lab.run(second), lab.now)
    assert reason.why == "it is not known how the last action of dev ended"
    assert "labos resolve I1" in reason.remedy
