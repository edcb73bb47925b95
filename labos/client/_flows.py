"""Flows of an experiment: steps one after the other; a failed step is tried again; each is logged."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from labos.client._record import ExperimentRecord
from labos.client._replay import Key, ReplayMismatch, as_json
from labos.client._services import Computations
from labos.errors import BadInput, LabosError

LONGEST_WAIT_S = 60.0
LONGEST_ERROR = 500


class FlowStep(msgspec.Struct, frozen=True):
    """A step of a flow: a function with the flow's ``state`` (a table) as its argument; it returns the result
    of the step. It is tried ``attempts`` times, with a pause of ``wait_s`` seconds, twice as long each time,
    at most 60 s. ``where`` is as for ``Experiment.compute``."""

    name: str
    function: Callable[[dict[str, Any]], Any]
    attempts: int = 1
    wait_s: float = 1.0
    where: str = "local"


class Flow:
    """Steps in their order, for example to analyse, plot and publish the result of a run. Raises BadInput for
    two steps with one name."""

    def __init__(self, name: str, steps: Sequence[FlowStep]) -> None:
        self.name, self.steps = name, tuple(steps)
        names = [step.name for step in self.steps]
        if not names or len(set(names)) < len(names) or "input" in names:
            raise BadInput(
                f"The flow {name!r} has no steps, two steps with the same name, or a step called `input`.",
                remedy="Give it steps with different names.",
            )
        if untried := [step.name for step in self.steps if step.attempts < 1]:
            raise BadInput(
                f"The step {untried[0]!r} of the flow {name!r} has no attempts.",
                remedy="Give `attempts` of 1 or more.",
            )

    def __str__(self) -> str:
        return self.name


class FlowResult(msgspec.Struct, frozen=True):
    """How a flow ended. ``status``: succeeded or failed; ``state`` has its ``input`` and the result of each
    step, by the step's name; ``step`` is the one that failed, and ``why`` the reason."""

    flow: str
    status: str
    state: dict[str, Any]
    step: str = ""
    why: str = ""


class FlowFailed(LabosError):
    """A step of a flow failed in all its attempts."""

    def __init__(self, result: FlowResult) -> None:
        super().__init__(f"Step {result.step!r} of the flow {result.flow!r} failed: {result.why}.")
        self.result = result


def run(
    record: ExperimentRecord,
    computations: Computations,
    key: Key,
    flow: Flow,
    given: Mapping[str, Any],
) -> FlowResult:
    """Carry out a flow; continue after the last step in the log. Raises ReplayMismatch for a flow with other
    steps."""
    state: dict[str, Any] = {"input": as_json(given)}
    names = [step.name for step in flow.steps]
    begun = {"state": "started", "flow_id": str(key), "steps": names}
    before = record.keep(f"{key} started", "flow", flow.name, begun)["facts"]["steps"]
    if before != names:
        raise ReplayMismatch(record.experiment, key, before, names)
    for step in flow.steps:
        error = _carry_out(record, computations, key, flow, step, state)
        if error is not None:
            why = _join_lines(error)
            ended = {"state": "failed", "flow_id": str(key), "step": step.name, "error": why}
            record.keep(f"{key} ended", "flow", flow.name, ended)
            return FlowResult(flow.name, "failed", state, step.name, why)
    record.keep(f"{key} ended", "flow", flow.name, {"state": "succeeded", "flow_id": str(key)})
    return FlowResult(flow.name, "succeeded", state)


def _carry_out(
    record: ExperimentRecord,
    computations: Computations,
    key: Key,
    flow: Flow,
    step: FlowStep,
    state: dict[str, Any],
) -> BaseException | None:
    """The error of the last attempt; None if an attempt succeeded. The result is in ``state`` then."""
    from labos.services.compute import ComputeFailed

    pause = step.wait_s
    for attempt in range(1, step.attempts + 1):
        this = f"{key}/{step.name}#{attempt}"
        try:
            future = computations.submit(step.function, (dict(state),), {}, step.where, this)
            state[step.name] = future.result()
        except ComputeFailed as error:
            if attempt == step.attempts:
                return error.error
            facts: dict[str, Any] = {
                "state": "retrying",
                "flow_id": str(key),
                "step": step.name,
                "attempt": attempt,
            }
            facts["error"] = _join_lines(error.error)
            record.keep(f"{this} failed", "flow", flow.name, facts)
            if record.find_note(f"{key}/{step.name}#{attempt + 1}") is None:
                time.sleep(min(pause, LONGEST_WAIT_S))
            pause *= 2
        else:
            return None
    return None


def _join_lines(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:LONGEST_ERROR]
