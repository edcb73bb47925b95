"""Of an experiment's closing workflow those steps are carried out that find something to clear away."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from labos.core.model import Plan
from tests.support.bench import Driver, module, move, plan, route, station, step, workcell


def make_closed(closing: Plan, *places: str) -> tuple[Driver, Plan | None]:
    """An experiment that has parked plates and has ended; what is left of its closing workflow."""
    lab = Driver(
        workcell(
            [module("arm"), module("cam")],
            [station("stack", "stack", 9), station("trash", "waste", 9), *map(station, ("a", "b", "gate"))],
        )
    )
    lab.stock("stack", 5)
    name = lab.experiment(closing=closing)
    for place in places:
        lab.step(lab.submit(route("stack", place), experiment=name))
    lab.end(name)
    left = next((run for run in lab.state.runs.queued.values() if run.closing), None)
    return lab, None if left is None else lab.state.runs.plan_of(left)


BOTH = [step("arm", move(a, b)) for a, b in (("a", "gate"), ("gate", "trash"), ("b", "trash"))]


@pytest.mark.parametrize(("places", "keys"), [("ab", ["s0", "s1", "s2"]), ("a", ["s0", "s1"]), ("b", ["s2"])])
def test_only_what_finds_something_is_carried_out(places: str, keys: list[str]) -> None:
    lab, left = make_closed(plan(*BOTH, name="clear"), *places)
    assert left is not None
    assert [s.key for s in left.steps] == keys
    assert [s.after for s in left.steps] == [(i - 1,) if i else () for i in range(len(keys))]
    assert lab.work(random.Random(0)), lab.describe_stuck()
    assert (lab.state.bench.labware, lab.state.experiments.open) == ({}, {})
    lab.check_log()


def test_one_that_would_find_nothing_is_not_begun_and_the_labware_is_its_users() -> None:
    lab, left = make_closed(route("b", "trash", name="clear"), "a")
    assert left is None
    assert (lab.owner("P1"), lab.state.experiments.open) == ("user:ada", {})
    lab.check_log()


def test_what_has_nothing_to_do_with_labware_is_done_with_the_rest() -> None:
    closing = plan(step("cam"), *BOTH, name="clear")
    _, left = make_closed(closing, "b")
    assert left is not None
    assert [(s.module, s.effects) for s in left.steps] == [
        (s.module, s.effects) for s in (closing.steps[0], closing.steps[3])
    ]


def test_steps_that_need_each_others_results_are_not_torn_apart() -> None:
    closing = replace(plan(*BOTH, name="clear"), feeds=(0,))
    _, left = make_closed(closing, "b")
    assert left == closing
