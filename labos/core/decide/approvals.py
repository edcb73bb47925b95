"""Asking a second person to approve a run with dangerous steps, and the events after the answer."""

from __future__ import annotations

from collections.abc import Iterator

from labos.core.approvals import ApprovalGiven, RunApproved
from labos.core.decide._base import Decision, Rejection
from labos.core.decide.endings import record_end
from labos.core.ids import RunId, local
from labos.core.registry import Event
from labos.core.runs import RunCancelled, RunSubmitted
from labos.core.state import LabState
from labos.core.topics import SecondPerson, name_some
from labos.core.users import ON_BEHALF, find_person

MOST_NAMED = 5
"""The question names at most this number of dangerous steps."""


def answer_approval(state: LabState, topic: SecondPerson, choice: str, by: str) -> Decision:
    """A second person approves a run's dangerous steps, or refuses."""
    run = state.runs.queued.get(RunId(topic.run))
    if run is None:
        return []
    if choice != "approve":
        return record_end(state, run, RunCancelled(run.id, f"{by} did not approve it"), "was not approved")
    user = state.users.known.get(by)
    if find_person(by) == run.user:
        return Rejection(
            "second_person",
            f"{run.id} is a run of {run.user} and needs the approval of a second person.",
            "Ask another operator.",
        )
    if ON_BEHALF in by or (user is not None and user.kind == "service"):
        return Rejection("second_person", f"{by} is not a person.", "Ask an operator to check it.")
    return [RunApproved(run.id, by)]


# -- reactions -----------------------------------------------------------------------------------


def ask_second_person(state: LabState, event: RunSubmitted | ApprovalGiven) -> Iterator[Event]:
    """A run with dangerous steps on modules that require a second person waits for an approval, unless it
    already waits for one."""
    name = event.run if isinstance(event, RunSubmitted) else RunId(event.subject)
    run = state.runs.queued.get(name)
    if run is None or not run.unapproved or run.held:
        return
    plans = (state.runs.plans[name] for name in run.choices or (run.plan,))
    steps = next([known.plan.steps[index] for index in known.dangers] for known in plans if known.dangers)
    named = [f"{step.key!r} on {local(step.module)} ({step.dangerous})" for step in steps]
    text = (
        f"Run {run.id} ({run.workflow}) of {run.user} has dangerous steps: {name_some(named, MOST_NAMED)}. "
        "It needs the approval of a second person."
    )
    yield state.interventions.ask(SecondPerson(run=run.id, module=steps[0].module), text)
