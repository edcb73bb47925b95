"""One readable sentence for every event."""

from __future__ import annotations

import json
from typing import Any

from labos.core import actions as a
from labos.core import bench as b
from labos.core import experiments as x
from labos.core import interventions as i
from labos.core import lab as g
from labos.core import modules as m
from labos.core import resources as s
from labos.core import runs as r
from labos.core.envelope import Envelope
from labos.core.ids import local
from labos.core.registry import Event
from labos.services.catalogue import Catalogue


def describe(event: Event, head: Envelope, names: Catalogue | None = None) -> str:
    """What happened, in one sentence with local names. ``names`` adds the names of steps."""
    names = names or Catalogue()
    family = head.type.partition(".")[0]
    teller = _FAMILIES.get(family)
    told = teller(event, names) if teller is not None else ""
    return told or f"{head.type} {head.stream}"


def owner_name(owner: str) -> str:
    """``run:R1`` as people say it."""
    if not owner:
        return "nobody"
    if owner == "shared":
        return "everybody (shared)"
    kind, _, name = owner.partition(":")
    return name if kind == "user" else f"{kind} {name}"


def short(value: Any, limit: int = 60) -> str:
    """A value as JSON, cut."""
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def step_name(run: str, index: int, names: Catalogue) -> str:
    """``R1 #3 'Seal plate'``; just ``R1 #3`` where the plan is not known."""
    step = names.step(run, index)
    key = f" {step.key!r}" if step is not None else ""
    return f"{run} #{index}{key}" if run else "no run"


def _action(event: Event, names: Catalogue) -> str:
    if isinstance(event, a.ActionDiscovered):
        return (
            f"{local(event.module)}: the node knows an action {event.name!r} ({event.status}) "
            "that this log does not"
        )
    if not isinstance(event, a.ActionEvent):
        return ""
    step = names.step(event.run, event.step)
    module = local(event.module)
    what = f"{module}.{step.action}" if step is not None and event.run else module
    lead = f"{step_name(event.run, event.step, names)}: " if event.run else ""
    match event:
        case a.ActionRequested():
            return f"{lead}{module}.{event.name} requested (attempt {event.attempt})"
        case a.ActionAccepted():
            return f"{lead}{what} accepted (attempt {event.attempt})"
        case a.ActionRejected():
            again = "for good" if event.final else "for now"
            return f"{lead}{what} refused {again}: {event.why}"
        case a.ActionSucceeded():
            result = f", result {short(event.result)}" if event.result is not None else ""
            return f"{lead}{what} succeeded{result}"
        case a.ActionFailed():
            return f"{lead}{what} failed (effects: {event.effects}): {event.error}"
        case a.ActionUnknown():
            return f"{lead}{what} ended unknown: {event.why}"
        case a.ActionReconciled():
            done = {"all": "it was done", "none": "it was not done"}.get(event.effects, event.effects)
            return f"{lead}{what} settled by {event.by}: {done}"
        case a.ActionEvidence():
            told = "success" if event.succeeded else f"failure ({event.error})"
            return (
                f"{lead}{what}: late word of {told}, effects {event.effects}; settled as {event.settled_as}"
            )
    return ""


def _labware(event: Event, names: Catalogue) -> str:
    if not isinstance(event, b.LabwareEvent):
        return ""
    lead = f"{event.run}: {event.labware} " if event.run else f"{event.labware} "
    match event:
        case b.LabwarePlaced():
            origin = f" from the stack {local(event.stack)}" if event.stack else ""
            return (
                f"{lead}({event.type}) placed at {local(event.station)}{origin}, of {owner_name(event.owner)}"
            )
        case b.LabwareMoved():
            return f"{lead}moved from {local(event.source)} to {local(event.target)}"
        case b.LabwareRemoved():
            where = f" at {local(event.where)}" if event.where else ""
            return f"{lead}left the bench{where}: {event.why}"
        case b.LabwareUncertain():
            places = ", ".join(local(place) or "gone" for place in event.places)
            return f"{lead}may be at any of: {places} ({event.why})"
        case b.LabwareObserved():
            return f"{lead}seen at {local(event.station)} by {event.by}"
        case b.LabwareChanged():
            return f"{lead}now has {event.variable} = {short(event.value)}"
        case b.BarcodeRead():
            return f"{lead}bears the barcode {event.barcode} (read by {event.by})"
        case b.SamplesRegistered():
            return f"{lead}holds {event.count} samples (sheet {event.sheet[:12]})"
        case b.LabwareHandedOver():
            return f"{lead}now belongs to {owner_name(event.owner)}"
    return ""


def _run(event: Event, names: Catalogue) -> str:
    if not isinstance(event, r.RunEvent):
        return ""
    match event:
        case r.RunSubmitted():
            experiment = f" in experiment {event.experiment}" if event.experiment else ""
            closing = " to clear away its labware" if event.closing else ""
            return f"{event.run}: {event.user} submitted {event.workflow!r}{experiment}{closing}"
        case r.RunStarted():
            return f"{event.run}: started"
        case r.RunPaused():
            return f"{event.run}: paused"
        case r.RunResumed():
            return f"{event.run}: resumed"
        case r.RunCancelling():
            why = f": {event.why}" if event.why else ""
            return f"{event.run}: ends when what is in flight has ended{why}"
        case r.RunCompleted():
            return f"{event.run}: completed all {event.steps} steps"
        case r.RunFailed():
            return f"{event.run}: failed ({event.kind} error): {event.why}"
        case r.RunCancelled():
            return f"{event.run}: cancelled"
        case r.WindowBreached():
            anchor = names.step(event.run, event.anchor)
            after = repr(anchor.key) if anchor is not None else f"step {event.anchor}"
            after = f"a step of {event.of}" if event.of else after
            lead = step_name(event.run, event.step, names)
            return f"{lead}: did not start within {event.within_s:g} s after {after}"
    return ""


def _plan(event: Event, names: Catalogue) -> str:
    match event:
        case r.PlanRecorded():
            return f"{event.by}: plan of {event.workflow!r} on {event.workcell}, {event.steps} steps"
        case r.PlanStepsRecorded():
            last = event.first + len(event.steps) - 1
            return f"{event.by}: steps #{event.first} to #{last} of its plan"
    return ""


def _lab(event: Event, names: Catalogue) -> str:
    match event:
        case g.LabCreated():
            pace = f", simulated at {event.pace:g} × real time" if event.pace != 1 else ""
            return f"the lab {event.name!r} was created{pace}"
        case g.KernelStarted():
            return f"a kernel started (epoch {event.epoch}, LabOS {event.version})"
        case g.WorkcellApplied():
            return f"workcell {event.name} applied: {len(event.modules)} modules ({event.digest[:12]})"
        case g.StationsApplied():
            return f"workcell {event.name}: {len(event.stations)} stations"
        case b.StationDeclared():
            counts = {kind: event.contents.count(kind) for kind in event.contents}
            what = ", ".join(f"{n} × {kind}" for kind, n in counts.items()) or "empty"
            return f"{local(event.station)} declared: {what}"
    return ""


def _module(event: Event, names: Catalogue) -> str:
    if not isinstance(event, m.ModuleEvent):
        return ""
    name = local(event.module)
    match event:
        case m.NodeJoined():
            simulated = ", simulated" if event.simulated else ""
            return f"{name}: node joined ({event.driver} {event.version}{simulated}), {event.status}"
        case m.NodeLeft():
            return f"{name}: node gone: {event.why}"
        case m.NodeStateChanged():
            error = f": {event.error}" if event.error else ""
            return f"{name}: {event.status}{error}"
        case m.VariableSet():
            value = "not known" if event.value is None else short(event.value)
            return f"{name}: {event.variable} is {value}" + (f" (by {event.by})" if event.by else "")
        case m.ModuleTakenOut():
            return f"{name}: taken out of service: {event.why}"
        case m.ModulePutBack():
            return f"{name}: back in service"
        case s.LevelSet():
            lot = f" (lot {event.lot})" if event.lot else ""
            return f"{name}: {event.resource} set to {event.level:g} of {event.capacity:g}{lot}"
        case s.ResourceConsumed():
            by = f" by {event.run}" if event.run else ""
            return f"{name}: {event.amount:g} of {event.resource} used{by}"
    return ""


def _intervention(event: Event, names: Catalogue) -> str:
    match event:
        case i.InterventionRequested():
            choices = ", ".join(choice.name for choice in event.choices)
            return f"{event.intervention}: a person is asked: {event.text} Choices: {choices}."
        case i.InterventionResolved():
            note = f" ({event.note})" if event.note else ""
            if event.choice == "withdrawn":
                return f"{event.intervention}: withdrawn{note}"
            return f"{event.intervention}: {event.by} chose {event.choice!r}{note}"
    return ""


def _experiment(event: Event, names: Catalogue) -> str:
    if not isinstance(event, x.ExperimentEvent):
        return ""
    match event:
        case x.ExperimentStarted():
            return f"{event.experiment}: {event.user} started the experiment {event.name!r}"
        case x.ExperimentClosing():
            return f"{event.experiment}: closing: {event.why}"
        case x.ExperimentEnded():
            return f"{event.experiment}: ended"
        case x.ExperimentNoted():
            facts = f": {short(event.facts)}" if event.facts else ""
            return f"{event.experiment}: {event.kind.replace('_', ' ')} {event.name!r}{facts}"
    return ""


_FAMILIES = {
    "action": _action,
    "labware": _labware,
    "run": _run,
    "window": _run,
    "plan": _plan,
    "lab": _lab,
    "kernel": _lab,
    "workcell": _lab,
    "station": _lab,
    "node": _module,
    "module": _module,
    "resource": _module,
    "intervention": _intervention,
    "experiment": _experiment,
}
