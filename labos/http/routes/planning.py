"""Queries before a submission: the actions of modules, and the demand of a workflow."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.core.approvals import ApprovalRequested, Demand
from labos.core.decide import Rejection, decide
from labos.core.decide.policy import sum_demand_of_choices
from labos.core.decide.suggestions import SuggestOrder
from labos.core.ids import RunId, local
from labos.core.model import MAIN
from labos.core.structs import make_from
from labos.core.suggestions import OrderSuggested, Suggested
from labos.errors import NotFound
from labos.http.bodies import NewRun, OrderSuggestion
from labos.http.operation import Call, Method, operate, read, submit
from labos.http.queries import OfModule, OfWorkcell
from labos.http.routes.runs import WORKFLOW
from labos.planning.forecast import is_pending
from labos.spec.about import find_description
from labos.spec.choices import list_choices
from labos.spec.findings import Finding


class ArgumentView(msgspec.Struct, frozen=True):
    """An argument of an action. ``minimum`` and ``maximum`` are in its ``unit``."""

    name: str
    type: str
    description: str
    required: bool
    default: Any
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str | int | float | bool, ...]


class ActionView(msgspec.Struct, frozen=True):
    """An action of a module. ``dangerous`` says how, and is empty for most; ``duration_s`` is nominal, in lab
    seconds."""

    name: str
    description: str
    duration_s: float
    dangerous: str
    result: str
    arguments: list[ArgumentView]


class ActionList(msgspec.Struct, frozen=True):
    """List the actions of a module."""

    module: str
    driver: str
    description: str
    actions: list[ActionView]


class PlannedStep(msgspec.Struct, frozen=True):
    """A step of a plan; ``after`` are the numbers of the steps before it. ``dangerous`` says how;
    ``choices`` are the modules that may do it, if there are several; ``module`` is one of them."""

    key: str
    module: str
    action: str
    args: dict[str, Any]
    after: tuple[int, ...]
    duration_s: float
    dangerous: str
    choices: list[str] = []


class CheckedRun(msgspec.Struct, frozen=True):
    """The run as it would be submitted. ``demand`` is the work and material that its plan needs. ``approval``
    is the reason why it would wait for an approval, and ``refusal`` is the reason why it would be refused in
    the present state (empty: it would not)."""

    workflow: str
    workcell: str
    steps: list[PlannedStep]
    demand: Demand
    approval: tuple[str, ...]
    refusal: str
    warnings: tuple[Finding, ...]


@read(
    route="GET /modules/{module}/actions",
    client=Method("actions"),
    summary="List the actions of a module",
    tag="modules",
)
async def list_actions(call: Call, path: OfModule) -> ActionList:
    """The actions and their arguments, as a step of a workflow uses them."""
    name = call.service.module(path.module)
    spec = call.kernel.state.modules.by_name[name].spec
    found = find_description(spec, call.service.parts.descriptions)
    if found is None:
        raise NotFound(f"The actions of {local(name)} are not described.", remedy="Install its driver.")
    actions = [
        make_from(
            ActionView,
            action,
            arguments=[make_from(ArgumentView, arg) for arg in action.args],
        )
        for action in sorted(found.actions, key=lambda action: not action.exclusive)
    ]
    return ActionList(name, spec.driver, found.description, actions)


@read(
    route="GET /workcells/{workcell}/order",
    client=Method("suggested_order"),
    summary="Show the order that a planner suggests for the next steps of a workcell",
    problems=("not_found",),
)
async def show_order(call: Call, path: OfWorkcell) -> SuggestedOrder:
    """Steps that have started, or whose run has ended, are not in the answer."""
    state = call.kernel.state
    if path.workcell not in state.lab.workcells:
        raise NotFound(
            f"There is no workcell {path.workcell!r}.",
            remedy=f"Name one of these: {', '.join(sorted(state.lab.workcells)) or 'none'}.",
        )
    order = state.suggestions.orders.get(path.workcell)
    if order is None or order.until <= call.kernel.clock.now_ns():
        return SuggestedOrder(path.workcell, "", 0, [], [])
    steps = []
    for one in order.steps:
        run = state.runs.get(one.run)
        if run is not None and is_pending(run, one.step):
            steps.append(OrderedStep(one.run, one.step, one.start))
    line = [str(run) for run in order.line if state.runs.get(run) is not None]
    return SuggestedOrder(path.workcell, order.by, order.until, steps, line)


class OrderedStep(msgspec.Struct, frozen=True):
    """A step that should start at ``start`` (UTC ns)."""

    run: str
    step: int
    start: int


class SuggestedOrder(msgspec.Struct, frozen=True):
    """The order that ``by`` suggests for a workcell, the earliest step first. It is valid until ``until``
    (UTC ns; 0: no suggestion). ``line``: in place of steps, the runs with which the lab's own search
    begins."""

    workcell: str
    by: str
    until: int
    steps: list[OrderedStep]
    line: list[str]


@operate(
    route="POST /workcells/{workcell}/order",
    client=Method("suggest_order", "workcell, steps, until, position, line", take="steps", repeat=True),
    summary="Suggest an order for the next steps of a workcell",
    problems=("not_found", "refused"),
    example={
        "by": "ada",
        "steps": [{"run": "R1", "step": 2, "start": 1_790_000_000_000_000_000}],
        "until": 1_790_000_600_000_000_000,
    },
    example_answer={"steps": 1},
)
async def suggest_order(call: Call, path: OfWorkcell, body: OrderSuggestion) -> StepsLeft:
    """It replaces the previous suggestion. Ended runs are ignored. A suggestion never starts a step that
    could not start without it."""
    steps = tuple(Suggested(RunId(one.run), one.step, one.start, one.outside) for one in body.steps)
    line = tuple(map(RunId, body.line))
    asked = SuggestOrder(path.workcell, body.by, body.until, steps, body.position, line)
    events = await call.kernel.execute(asked, body.by)
    return StepsLeft(sum(len(event.steps) for event in events if isinstance(event, OrderSuggested)))


class StepsLeft(msgspec.Struct, frozen=True):
    """The number of suggested steps that have not started."""

    steps: int


@submit(
    route="POST /runs/check",
    client=Method("_check_run", "workflow, user=''", repeat=True),
    summary="Check a run of a workflow without submitting it",
    tag="runs",
    example={"workflow": WORKFLOW, "user": "ada"},
)
async def check_run(call: Call, body: NewRun) -> CheckedRun:
    """Nothing is submitted or stored."""
    service, state = call.service, call.kernel.state
    service.expect_role(body.user, "submitter")  # before anything is planned
    planned = await service.plan_run(body)
    plan, plans = planned.run.plan, planned.run.plans
    answer = decide(state, planned.run, body.user)
    refusal = f"{answer.message} {answer.remedy}".strip() if isinstance(answer, Rejection) else ""
    asked = [] if isinstance(answer, Rejection) else [e for e in answer if isinstance(e, ApprovalRequested)]
    choices = list_choices(plans)
    steps = [
        make_from(
            PlannedStep,
            step,
            module=local(step.module),
            dangerous=step.hazard,
            choices=choices.get(step.key, []),
        )
        for step in plan.steps
        if step.part == MAIN
    ]
    await call.kernel.flush()
    return CheckedRun(
        workflow=plan.workflow,
        workcell=plan.workcell,
        steps=steps,
        demand=sum_demand_of_choices(plans),
        approval=tuple(why.text for event in asked for why in event.why),
        refusal=refusal,
        warnings=planned.findings,
    )
