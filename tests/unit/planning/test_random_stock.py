"""Random small cells in which things run out: nobody is trapped, nobody sleeps through a refill."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace

from labos.core.decide.stock import Replenish
from labos.core.ids import ModuleName
from labos.core.model import Plan
from tests.support.bench import Driver, consumes, full
from tests.unit.planning.cases import Case

SEEDS = 60
CAPACITY = 4.0


def thirsty(rng: random.Random, plan: Plan) -> Plan:
    """The same plan, some of whose steps use up what its modules hold."""
    steps = tuple(
        replace(step, effects=(*step.effects, consumes("ink", rng.choice([1, 2, 3]))))
        if step.module == full("dev") or rng.random() < 0.2
        else step
        for step in plan.steps
    )
    return replace(plan, steps=steps)


def refill(rng: random.Random, lab: Driver) -> bool:
    """A person fills up one of the modules that are not full; False if all are."""
    short = [name for name, level in lab.state.resources.levels.items() if level.level < level.capacity]
    if not short:
        return False
    module, _, resource = rng.choice(short).rpartition(":")
    lab.do(Replenish(ModuleName(module), resource, lot=f"L{len(lab.log)}"))
    return True


@pytest.mark.slow
def test_whoever_is_refilled_goes_on_and_everybody_completes() -> None:
    refills = 0
    for seed in range(SEEDS):
        rng = random.Random(seed)
        case = Case(rng)
        case.plans = [thirsty(rng, plan) for plan in case.plans]
        lab = case.lab()
        for name in {*case.arms, "dev", "cam", "heat"}:
            lab.level(name, "ink", rng.choice([0, 1, CAPACITY]), CAPACITY)
        for plan in case.plans:
            lab.submit(plan)

        def pump(lab: Driver = lab) -> None:
            lab.pump()
            assert lab.find_missed() == [], lab.describe_stuck()

        while not lab.work(rng, pump):
            assert refill(rng, lab), f"seed {seed}, trapped: {lab.describe_stuck()}"
            refills += 1
        assert lab.types().count("run.completed") == lab.state.runs.named
        assert all(level.level >= 0 for level in lab.state.resources.levels.values())
        lab.check_log()
    assert refills > SEEDS, "the cases are too easy: nothing runs out"
