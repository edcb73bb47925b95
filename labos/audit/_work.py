"""Runs, steps and actions as rows."""

from __future__ import annotations

from typing import Any

from labos.audit._bench import labware_of
from labos.audit._bench_tables import LABWARE_TABLE as LABWARE
from labos.audit._rows import Row, RowChanges, convert_to_seconds
from labos.audit._work_tables import ACTIONS, EXPERIMENTS, FILES, NODES, PLANS, PRESENT, RESULTS, RUNS, STEPS
from labos.core import actions as a
from labos.core import modules as m
from labos.core import plans as p
from labos.core import runs as r
from labos.core import steps as st
from labos.core.envelope import Envelope
from labos.core.model import MAIN, ON_CANCEL, AnyPart
from labos.services.files import iterate_files
from labos.services.results import find_labware_of_action, iterate_tables
from labos.services.runs import describe_step_end

NUMBERS: dict[AnyPart, int] = {MAIN: -1, ON_CANCEL: -2}
"""The numbers in a table for the parts of a plan that do not belong to a step."""

# -- plans and runs ----------------------------------------------------------------------------


def on_plan_recorded(rows: RowChanges, event: p.PlanRecorded, head: Envelope, at: float) -> None:
    rows.put(PLANS, event, steps=[])


def on_plan_steps_recorded(rows: RowChanges, event: p.PlanStepsRecorded, head: Envelope, at: float) -> None:
    plan = rows.change(PLANS, event.plan)
    steps = [[s.key, s.module, s.action, NUMBERS.get(s.part, s.part), list(s.after)] for s in event.steps]
    plan["steps"] = [*list(plan["steps"])[: event.first], *steps]


def on_submitted(rows: RowChanges, event: r.RunSubmitted, head: Envelope, at: float) -> None:
    plan = rows.get(PLANS, event.plan)
    steps = plan["steps"]
    rows.put(
        RUNS,
        event,
        workcell=plan["workcell"],
        user_id=event.user,
        row=event.row if event.campaign else None,
        status="queued",
        submitted_at_s=at,
        due_at_s=convert_to_seconds(event.due_at) if event.due_at else None,
        steps=len(steps),
        steps_done=0,
        submitted_position=head.position,
    )
    for number, (key, module, name, part, after) in enumerate(steps):
        rows.put(
            STEPS,
            run=event.run,
            step=number,
            key=key,
            module=module,
            name=name,
            state="pending" if part == NUMBERS[MAIN] else "asleep",
            part=part,
            after=after,
            attempts=0,
        )
    rows.change(EXPERIMENTS, event.experiment)["runs"] += 1


def on_bound(rows: RowChanges, event: r.RunBound, head: Envelope, at: float) -> None:
    run = rows.update(RUNS, event.run, plan=event.plan)
    for number in range(run["steps"]):
        module = event.modules.get(rows.get(STEPS, event.run, number)["key"])
        if module is not None:
            rows.update(STEPS, event.run, number, module=module)


def on_started(rows: RowChanges, event: r.RunStarted, head: Envelope, at: float) -> None:
    rows.update(RUNS, event.run, status="active", started_at_s=at, started_position=head.position)


def on_paused(rows: RowChanges, event: r.RunPaused, head: Envelope, at: float) -> None:
    rows.update(RUNS, event.run, status="paused", why=event.why)


def on_resumed(rows: RowChanges, event: r.RunResumed, head: Envelope, at: float) -> None:
    run = rows.change(RUNS, event.run)
    run["status"], run["why"] = "active" if run["started_at_s"] is not None else "queued", ""


def on_cancelling(rows: RowChanges, event: r.RunCancelling, head: Envelope, at: float) -> None:
    run = rows.change(RUNS, event.run)
    run["status"], run["why"] = "cancelling", run["why"] or event.why or event.reason


def on_leaving(rows: RowChanges, event: r.RunLeaving, head: Envelope, at: float) -> None:
    run = rows.update(RUNS, event.run, status="leaving")
    for number in range(run["steps"]):
        if number in event.steps:
            _set_step_status(rows, event.run, number, "pending")
        elif rows.get(STEPS, event.run, number)["state"] == "pending":
            _set_step_status(rows, event.run, number, "skipped")


def on_run_ended(rows: RowChanges, event: r.RunEnd, head: Envelope, at: float) -> None:
    outcome = event.TYPE.rpartition(".")[2]
    run = rows.update(RUNS, event.run, status=outcome, ended_at_s=at, ended_position=head.position)
    if isinstance(event, r.RunFailed):
        run["why"], run["failure"] = event.why, event.kind
    elif isinstance(event, r.RunCancelled):
        run["why"] = run["why"] or event.why


# -- steps -------------------------------------------------------------------------------------


def on_breached(rows: RowChanges, event: st.WindowBreached, head: Envelope, at: float) -> None:
    rows.update(STEPS, event.run, event.step, breached=True)


def on_retried(rows: RowChanges, event: st.StepRetried, head: Envelope, at: float) -> None:
    _set_step_status(rows, event.run, event.step, "pending")


def on_skipped(rows: RowChanges, event: st.StepSkipped, head: Envelope, at: float) -> None:
    _set_step_status(rows, event.run, event.step, "skipped", event.why)


def on_unexpected(rows: RowChanges, event: st.StepUnexpected, head: Envelope, at: float) -> None:
    _set_step_status(rows, event.run, event.step, "failed", event.why)


def on_recovering(rows: RowChanges, event: st.StepRecovering, head: Envelope, at: float) -> None:
    _set_step_status(rows, event.run, event.step, "failed", event.why)
    for number in range(rows.get(RUNS, event.run)["steps"]):
        step = rows.get(STEPS, event.run, number)
        if step["part"] == event.step and step["state"] == "asleep":
            _set_step_status(rows, event.run, number, "pending")


def _set_step_status(rows: RowChanges, run: str, number: int, state: str, error: str | None = None) -> Row:
    """Change the state of a step, and the number of done steps of its run."""
    step = rows.change(STEPS, run, number)
    if "done" in (state, step["state"]) and state != step["state"]:
        rows.change(RUNS, run)["steps_done"] += 1 if state == "done" else -1
    step["state"] = state
    if error is not None:
        step["error"] = error
    return step


_OF_NODE = ("driver", "driver_version", "about", "simulated")
"""Facts of the present node that are stored with an action."""

# -- actions -----------------------------------------------------------------------------------


def on_requested(rows: RowChanges, event: a.ActionRequested, head: Envelope, at: float) -> None:
    step = _set_step_status(rows, event.run, event.step, "in flight", "")
    step["attempts"] = max(step["attempts"], event.attempt)
    step["requested_at_s"], step["ended_at_s"] = at, None
    if event.attempt > 1 and rows.get(ACTIONS, event.action)["action"]:
        rows.update(ACTIONS, event.action, attempts=event.attempt, status="requested")
        return
    node = rows.get(NODES, rows.get(PRESENT, event.module)["position"])
    rows.put(
        ACTIONS,
        event,
        key=step["key"],
        **{name: node[name] for name in _OF_NODE},
        labware=labware_of(event.effects),
        status="requested",
        effects="",
        attempts=event.attempt,
        requested_at_s=at,
        requested_position=head.position,
        plate=find_labware_of_action(event),
    )
    for number, (name, digest) in enumerate(event.files.items()):
        rows.add(FILES, head.position, number, at, "given", digest, name, None, event.run, event.action)


def on_accepted(rows: RowChanges, event: a.ActionAccepted, head: Envelope, at: float) -> None:
    rows.update(ACTIONS, event.action, status="accepted", accepted_at_s=at)


def on_reported(rows: RowChanges, event: a.ActionReported, head: Envelope, at: float) -> None:
    rows.update(ACTIONS, event.action, status="reported")


def on_unknown(rows: RowChanges, event: a.ActionUnknown, head: Envelope, at: float) -> None:
    _set_step_status(rows, event.run, event.step, "unknown", event.why)
    rows.update(ACTIONS, event.action, status="unknown", effects="unknown", error=event.why)


def on_action_ended(rows: RowChanges, event: a.ActionEnd, head: Envelope, at: float) -> None:
    state, error = describe_step_end(event)
    _set_step_status(rows, event.run, event.step, state, error)["ended_at_s"] = at
    ended_ns = getattr(event, "ended_ns", 0)
    device_ended = convert_to_seconds(ended_ns) if ended_ns else None
    action = rows.update(
        ACTIONS,
        event.action,
        status=event.TYPE.rpartition(".")[2],
        effects=getattr(event, "effects", "none" if isinstance(event, a.ActionRejected) else "all"),
        error=error,
        ended_at_s=at,
        ended_position=head.position,
        device_ended_at_s=device_ended,
    )
    if isinstance(event, a.ActionReconciled):
        action["settled_by"] = event.by
    if isinstance(event, a.ActionSucceeded | a.ActionReconciled):
        _add_results(rows, event, head, device_ended or at)


def _add_results(
    rows: RowChanges, event: a.ActionSucceeded | a.ActionReconciled, head: Envelope, ended: float
) -> None:
    """Add the results of the device: files, and values by well."""
    action = rows.change(ACTIONS, event.action)
    if not action["action"] or event.result is None:
        return
    action["result"] = event.result
    for number, (name, digest, size) in enumerate(iterate_files(event.result)):
        file = ("returned", digest, name, size, event.run, event.action)
        rows.add(FILES, head.position, number, ended, *file)
    plate = action["plate"]
    samples = rows.get(LABWARE, plate)["samples"]
    number = 0
    for table in iterate_tables(event.result):
        for well, value in table.values.items():
            about = (event.run, event.step, action["key"], event.action, event.module, plate, well)
            measured = (samples.get(well, ""), table.quantity, *_split_value(value), table.unit)
            rows.add(RESULTS, head.position, number, ended, *about, *measured)
            number += 1


def _split_value(value: Any) -> tuple[float | None, str]:
    """A measured value as a number, if possible, and as text."""
    if isinstance(value, bool):
        return None, "true" if value else "false"
    return (None, value) if isinstance(value, str) else (float(value), str(value))


# -- nodes -------------------------------------------------------------------------------------


def on_joined(rows: RowChanges, event: m.NodeJoined, head: Envelope, at: float) -> None:
    _leave(rows, event.module, at)
    rows.put(PRESENT, module=event.module, position=head.position)
    rows.put(
        NODES,
        event,
        position=head.position,
        driver_version=event.version,
        joined_at_s=at,
    )


def on_left(rows: RowChanges, event: m.NodeLeft, head: Envelope, at: float) -> None:
    _leave(rows, event.module, at)


def _leave(rows: RowChanges, module: str, at: float) -> None:
    node = rows.change(NODES, rows.get(PRESENT, module)["position"])
    if node["left_at_s"] is None:
        node["left_at_s"] = at
