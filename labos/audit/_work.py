"""Runs, steps and actions as rows."""

from __future__ import annotations

from typing import Any, assert_never

from labos.audit._bench_tables import LABWARE_TABLE as LABWARE
from labos.audit._rows import Row, RowChanges, convert_to_seconds
from labos.audit._touches import labware_of
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

NUMBERS: dict[AnyPart, int] = {MAIN: -1, ON_CANCEL: -2}
"""The numbers in a table for the parts of a plan that do not belong to a step."""

# -- plans and runs ----------------------------------------------------------------------------


def on_plan_recorded(rows: RowChanges, event: p.PlanRecorded, head: Envelope, at: float) -> None:
    rows.put(PLANS, {"steps": []}, event)


def on_plan_steps_recorded(rows: RowChanges, event: p.PlanStepsRecorded, head: Envelope, at: float) -> None:
    plan = rows.change(PLANS, event.plan)
    if plan is not None:
        steps = [[s.key, s.module, s.action, NUMBERS.get(s.part, s.part), list(s.after)] for s in event.steps]
        plan["steps"] = [*plan["steps"][: event.first], *steps]


def on_submitted(rows: RowChanges, event: r.RunSubmitted, head: Envelope, at: float) -> None:
    plan = rows.get(PLANS, event.plan)
    steps = plan["steps"] if plan is not None else []
    rows.put(
        RUNS,
        {
            "workcell": plan["workcell"] if plan is not None else "",
            "user_id": event.user,
            "row": event.row if event.campaign else None,
            "status": "queued",
            "submitted_at_s": at,
            "due_at_s": convert_to_seconds(event.due_at) if event.due_at else None,
            "steps": len(steps),
            "steps_done": 0,
            "submitted_position": head.position,
        },
        event,
    )
    for number, (key, module, name, part, after) in enumerate(steps):
        rows.put(
            STEPS,
            {
                "run": event.run,
                "step": number,
                "key": key,
                "module": module,
                "name": name,
                "state": "pending" if part == NUMBERS[MAIN] else "asleep",
                "part": part,
                "after": after,
                "attempts": 0,
            },
        )
    experiment = rows.change(EXPERIMENTS, event.experiment) if event.experiment else None
    if experiment is not None:
        experiment["runs"] += 1


def on_bound(rows: RowChanges, event: r.RunBound, head: Envelope, at: float) -> None:
    run = rows.change(RUNS, event.run)
    if run is None:
        return
    run["plan"] = event.plan
    for number in range(run["steps"]):
        known = rows.get(STEPS, event.run, number)
        module = event.modules.get(known["key"]) if known is not None else None
        step = rows.change(STEPS, event.run, number) if module is not None else None
        if step is not None:
            step["module"] = module


def on_started(rows: RowChanges, event: r.RunStarted, head: Envelope, at: float) -> None:
    rows.update(RUNS, event.run, status="active", started_at_s=at, started_position=head.position)


def on_paused(rows: RowChanges, event: r.RunPaused, head: Envelope, at: float) -> None:
    rows.update(RUNS, event.run, status="paused", why=event.why)


def on_resumed(rows: RowChanges, event: r.RunResumed, head: Envelope, at: float) -> None:
    run = rows.change(RUNS, event.run)
    if run is not None:
        run["status"], run["why"] = "active" if run["started_at_s"] is not None else "queued", ""


def on_cancelling(rows: RowChanges, event: r.RunCancelling, head: Envelope, at: float) -> None:
    run = rows.change(RUNS, event.run)
    if run is not None:
        run["status"], run["why"] = "cancelling", run["why"] or event.why or event.reason


def on_leaving(rows: RowChanges, event: r.RunLeaving, head: Envelope, at: float) -> None:
    run = rows.update(RUNS, event.run, status="leaving")
    for number in range(run["steps"]) if run is not None else ():
        step = rows.get(STEPS, event.run, number)
        if step is not None and number in event.steps:
            _set_step_status(rows, event.run, number, "pending")
        elif step is not None and step["state"] == "pending":
            _set_step_status(rows, event.run, number, "skipped")


def on_run_ended(rows: RowChanges, event: r.RunEnd, head: Envelope, at: float) -> None:
    run = rows.update(RUNS, event.run, ended_at_s=at, ended_position=head.position)
    if run is None:
        return
    match event:
        case r.RunCompleted():
            run["status"] = "completed"
        case r.RunFailed():
            run["status"], run["why"], run["failure"] = "failed", event.why, event.kind
        case r.RunCancelled():
            run["status"], run["why"] = "cancelled", run["why"] or event.why
        case _:
            assert_never(event)


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
    run = rows.get(RUNS, event.run)
    for number in range(run["steps"]) if run is not None else ():
        step = rows.get(STEPS, event.run, number)
        if step is not None and step["part"] == event.step and step["state"] == "asleep":
            _set_step_status(rows, event.run, number, "pending")


def _set_step_status(
    rows: RowChanges, run: str, number: int, state: str, error: str | None = None
) -> Row | None:
    """Change the state of a step, and the number of done steps of its run."""
    step = rows.change(STEPS, run, number) if run else None
    if step is None:
        return None
    if "done" in (state, step["state"]) and state != step["state"]:
        whole = rows.change(RUNS, run)
        if whole is not None:
            whole["steps_done"] += 1 if state == "done" else -1
    step["state"] = state
    if error is not None:
        step["error"] = error
    return step


_OF_NODE = ("driver", "driver_version", "about", "simulated")
"""Facts of the present node that are stored with an action."""

# -- actions -----------------------------------------------------------------------------------


def on_requested(rows: RowChanges, event: a.ActionRequested, head: Envelope, at: float) -> None:
    step = _set_step_status(rows, event.run, event.step, "in flight", "")
    if step is not None:
        step["attempts"] = max(step["attempts"], event.attempt)
        step["requested_at_s"], step["ended_at_s"] = at, None
    if event.attempt > 1 and rows.update(ACTIONS, event.action, attempts=event.attempt, status="requested"):
        return
    present = rows.get(PRESENT, event.module)
    node = rows.get(NODES, present["position"]) if present is not None else None
    rows.put(
        ACTIONS,
        {
            "key": step["key"] if step is not None else "",
            **({name: node[name] for name in _OF_NODE} if node is not None else {}),
            "labware": labware_of(event.effects),
            "status": "requested",
            "effects": "",
            "attempts": event.attempt,
            "requested_at_s": at,
            "requested_position": head.position,
            "plate": find_labware_of_action(event),
        },
        event,
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


def on_succeeded(rows: RowChanges, event: a.ActionSucceeded, head: Envelope, at: float) -> None:
    _end(rows, event, head, at, "succeeded", "done", "all")
    _add_results(rows, event, head, convert_to_seconds(event.ended_ns) if event.ended_ns else at)


def on_failed(rows: RowChanges, event: a.ActionFailed, head: Envelope, at: float) -> None:
    _end(rows, event, head, at, "failed", "failed", event.effects, event.error)


def on_rejected(rows: RowChanges, event: a.ActionRejected, head: Envelope, at: float) -> None:
    _end(rows, event, head, at, "rejected", "failed" if event.final else "pending", "none", event.why)


def on_reconciled(rows: RowChanges, event: a.ActionReconciled, head: Envelope, at: float) -> None:
    state = {"all": "done", "none": "pending"}.get(event.effects, "failed")
    error = "" if state == "done" else f"settled by {event.by}"
    action = _end(rows, event, head, at, "reconciled", state, event.effects, error)
    if action is not None:
        action["settled_by"] = event.by
    _add_results(rows, event, head, at)


def _end(
    rows: RowChanges,
    event: a.ActionEvent,
    head: Envelope,
    at: float,
    status: str,
    state: str,
    effects: str,
    error: str = "",
) -> Row | None:
    step = _set_step_status(rows, event.run, event.step, state, error)
    if step is not None:
        step["ended_at_s"] = at
    ended_ns = getattr(event, "ended_ns", 0)
    return rows.update(
        ACTIONS,
        event.action,
        status=status,
        effects=effects,
        error=error,
        ended_at_s=at,
        ended_position=head.position,
        device_ended_at_s=convert_to_seconds(ended_ns) if ended_ns else None,
    )


def _add_results(
    rows: RowChanges, event: a.ActionSucceeded | a.ActionReconciled, head: Envelope, ended: float
) -> None:
    """Add the results of the device: files, and values by well."""
    action = rows.change(ACTIONS, event.action)
    if action is None or event.result is None:
        return
    action["result"] = event.result
    for number, (name, digest, size) in enumerate(iterate_files(event.result)):
        file = ("returned", digest, name, size, event.run, event.action)
        rows.add(FILES, head.position, number, ended, *file)
    plate = action["plate"]
    labware = rows.get(LABWARE, plate) if plate else None
    samples = labware["samples"] if labware is not None else {}
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
    rows.put(PRESENT, {"module": event.module, "position": head.position})
    rows.put(
        NODES,
        {
            "position": head.position,
            "driver_version": event.version,
            "joined_at_s": at,
        },
        event,
    )


def on_left(rows: RowChanges, event: m.NodeLeft, head: Envelope, at: float) -> None:
    _leave(rows, event.module, at)


def _leave(rows: RowChanges, module: str, at: float) -> None:
    present = rows.get(PRESENT, module)
    node = rows.change(NODES, present["position"]) if present is not None else None
    if node is not None and node["left_at_s"] is None:
        node["left_at_s"] = at
