"""What plans have in common is held once, and only what is written the same is the same."""

from __future__ import annotations

from msgspec.json import decode, encode

from labos.core.effects import Move
from labos.core.ids import ModuleName, StationName
from labos.core.model import PlanStep
from labos.core.plans import PlanRecorded, Plans, PlanStepsRecorded, share_plans
from labos.core.runs import Runs, fold_plan_recorded, fold_plan_steps_recorded

CARRY = PlanStep(
    key="carry",
    module=ModuleName("rpl/arm"),
    action="transfer",
    effects=(Move(StationName("rpl/a.nest"), StationName("rpl/b.nest")),),
)


def seal(time: object) -> PlanStep:
    return PlanStep(key="seal", module=ModuleName("rpl/sealer"), action="seal", args={"time": time})


def fold_plans(**plans: tuple[PlanStep, ...]) -> Plans:
    runs = Runs()
    for name, steps in plans.items():
        fold_plan_recorded(runs, PlanRecorded("run:1", name, "shape", "w", "rpl", len(steps), (), {}), 0)
        # as they come from the log: values of their own
        copies = tuple(PlanStep(**{f: getattr(s, f) for f in s.__struct_fields__}) for s in steps)
        fold_plan_steps_recorded(runs, PlanStepsRecorded("run:1", name, 0, copies), 0)
    return runs.plans


def test_steps_that_are_written_the_same_are_held_once() -> None:
    plans = fold_plans(one=(CARRY, seal(3)), other=(CARRY, seal(4)))
    one, other = plans["one"].plan.steps, plans["other"].plan.steps
    assert one == (CARRY, seal(3))
    assert other == (CARRY, seal(4))
    assert one[0] is other[0]


def test_what_python_calls_equal_but_is_written_otherwise_stays_itself() -> None:
    times = (1, 1.0, True)
    plans = fold_plans(**{f"p{n}": (seal(time),) for n, time in enumerate(times)})
    kept = [plans[f"p{n}"].plan.steps[0].args["time"] for n in range(3)]
    assert [type(time) for time in kept] == [int, float, bool]


def test_plans_from_a_picture_share_too() -> None:
    plans = decode(encode(fold_plans(one=(CARRY,), other=(CARRY, seal(5)))), type=Plans)
    assert plans["one"].plan.steps[0] is not plans["other"].plan.steps[0]
    share_plans(plans)
    assert plans["one"].plan.steps[0] is plans["other"].plan.steps[0]
