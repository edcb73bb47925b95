"""Names for ids: the workflow of a run, the names of its steps, the user who submitted it."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from labos.core.envelope import Envelope
from labos.core.experiments import ExperimentStarted
from labos.core.interventions import InterventionRequested
from labos.core.lab import LabCreated
from labos.core.model import PlanStep
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.registry import Event
from labos.core.runs import RunBound, RunSubmitted
from labos.ports import LogQuery
from labos.services.log import Log, decode_events

LEARNT = (
    LabCreated.TYPE,
    PlanRecorded.TYPE,
    PlanStepsRecorded.TYPE,
    RunSubmitted.TYPE,
    RunBound.TYPE,
    ExperimentStarted.TYPE,
    InterventionRequested.TYPE,
)
"""The types that a catalogue learns from."""


class PlanEntry(msgspec.Struct):
    workflow: str
    workcell: str
    steps: list[PlanStep] = []


class Catalogue(msgspec.Struct):
    """Facts that the log states once and that are needed to read its other events."""

    pace: float = 1.0
    lab: str = ""
    plans: dict[str, PlanEntry] = {}
    runs: dict[str, RunSubmitted] = {}
    experiments: dict[str, ExperimentStarted] = {}
    interventions: dict[str, InterventionRequested] = {}

    def learn(self, event: Event) -> None:
        """Take in one event; most events add nothing."""
        match event:
            case PlanRecorded():
                self.plans[event.plan] = PlanEntry(event.workflow, event.workcell)
            case PlanStepsRecorded():
                plan = self.plans.get(event.plan)
                if plan is not None:
                    plan.steps = [*plan.steps[: event.first], *event.steps]
            case RunSubmitted():
                self.runs[event.run] = event
            case RunBound():
                known = self.runs.get(event.run)
                if known is not None:
                    bound = {"plan": event.plan, "planned_by": event.planned_by}
                    self.runs[event.run] = msgspec.structs.replace(known, **bound)
            case ExperimentStarted():
                self.experiments[event.experiment] = event
            case InterventionRequested():
                self.interventions[event.intervention] = event
            case LabCreated():
                self.pace, self.lab = event.pace, event.name

    def plan_of(self, run: str) -> PlanEntry | None:
        submitted = self.runs.get(run)
        return None if submitted is None else self.plans.get(submitted.plan)

    def find_step(self, run: str, index: int) -> PlanStep | None:
        plan = self.plan_of(run)
        return plan.steps[index] if plan is not None and index < len(plan.steps) else None

    def find_workcell(self, run: str) -> str:
        plan = self.plan_of(run)
        return plan.workcell if plan is not None else ""

    def find_experiment(self, run: str) -> str:
        submitted = self.runs.get(run)
        return str(submitted.experiment) if submitted is not None else ""


def read_catalogue(log: Log, upto: int | None = None) -> Catalogue:
    """The catalogue of a whole log."""
    catalogue = Catalogue()
    teach(catalogue, decode_events(log.select(LogQuery(types=LEARNT, upto=upto))))
    return catalogue


def teach(catalogue: Catalogue, pairs: Iterable[tuple[Event, Envelope]]) -> None:
    for event, _ in pairs:
        catalogue.learn(event)
