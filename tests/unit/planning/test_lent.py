"""Labware that several runs need where it stands: whose it is while one works on it, and that nobody is
trapped by that."""

from __future__ import annotations

import random

import pytest

from labos.core.model import Plan
from labos.planning.scheduler import Scheduler
from tests.support.bench import Driver, move, needs, plan, small, step, take


def thrown_away() -> Plan:
    """A plate of its own, and the one at ``a``, into the waste."""
    return plan(
        step("arm", take("stack", "b")),
        step("arm2", move("a", "trash")),
        step("arm", move("b", "trash")),
        name="throws",
    )


def looked_at(place: str = "a") -> Plan:
    return plan(step("cam", needs(place)), step("cam", needs(place)), name="looks")


def lab_with(place: str = "a") -> Driver:
    lab = small()
    lab.stock(place, 1)
    return lab


@pytest.mark.parametrize("restarts", [False, True])
def test_who_needs_shared_labware_traps_nobody_who_throws_it_away(restarts: bool) -> None:
    """Both are let in; the one that needs the plate where it stands comes first."""
    lab = lab_with()
    throws = lab.submit(thrown_away(), user="bob")
    lab.pump()
    lab.submit(looked_at(), user="ada")

    def pump() -> None:
        if restarts:
            lab.scheduler = Scheduler()
        lab.pump()

    assert lab.work(random.Random(1), pump), lab.stuck()
    assert lab.types().count("run.completed") == 2
    assert throws not in lab.state.runs.active
    lab.check_log()
