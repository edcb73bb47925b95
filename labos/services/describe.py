"""One readable sentence for every event."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

from labos.core import actions as a
from labos.core import bookings as k
from labos.core import campaigns as c
from labos.core import experiments as x
from labos.core import interventions as i
from labos.core import lab as g
from labos.core import labware as b
from labos.core import modules as m
from labos.core import resources as s
from labos.core import runs as r
from labos.core import shares as q
from labos.core import shorter as h
from labos.core import steps as st
from labos.core import users as u
from labos.core.approvals import ApprovalGiven, ApprovalRefused, ApprovalRequested, RunApproved
from labos.core.envelope import Envelope
from labos.core.erasure import ErasureAsked, ErasureRefused, WordsErased
from labos.core.ids import local, split_key
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.policy import PolicyApplied
from labos.core.registry import Event
from labos.core.repeated import RequestRepeated
from labos.core.signatures import RecordsSigned, RunSigned
from labos.core.suggestions import OrderSuggested
from labos.core.wells import sort_by_well
from labos.services.catalogue import Catalogue
from labos.services.times import show_time


def describe(event: Event, head: Envelope, names: Catalogue | None = None) -> str:
    """A sentence that describes the event, with local names. ``names`` adds the names of steps."""
    sentence = SENTENCES.get(type(event))
    if sentence is None:
        return f"{head.type} {head.stream}"
    names = names or Catalogue()
    return _name_subject(event, names) + sentence(event, names)


def owner_name(owner: str) -> str:
    """``run:R1`` in words."""
    if not owner:
        return "nobody"
    if owner == "shared":
        return "everybody (shared)"
    kind, name = split_key(owner)
    return name if kind == "user" else f"{kind} {name}"


def shorten_value(value: Any, limit: int = 60) -> str:
    """A value as JSON, shortened to ``limit`` characters."""
    text = json.dumps(sort_by_well(value), ensure_ascii=False)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def step_name(run: str, index: int, names: Catalogue) -> str:
    """``R1 #3 'Seal plate'``; just ``R1 #3`` if the plan is not known."""
    step = names.find_step(run, index)
    key = f" {step.key!r}" if step is not None else ""
    return f"{run} #{index}{key}" if run else "no run"


def _name_subject(event: Event, names: Catalogue) -> str:
    """The subject of a sentence: a person, a run, labware or a module."""
    match event:
        case a.ActionDiscovered():
            return f"{local(event.module)}: "
        case a.ActionEvent():
            return f"{step_name(event.run, event.step, names)}: " if event.run else ""
        case (
            st.WindowBreached()
            | st.StepRetried()
            | st.StepSkipped()
            | st.StepRecovering()
            | st.StepUnexpected()
        ):
            return f"{step_name(event.run, event.step, names)}: "
        case b.LabwareEvent():
            return f"{event.run}: {event.labware} " if event.run else f"{event.labware} "
        case r.RunEvent():
            return f"{event.run}: "
        case PlanRecorded() | PlanStepsRecorded():
            return f"{event.by}: "
        case m.ModuleEvent():
            return f"{local(event.module)}: "
        case i.InterventionRequested() | i.InterventionResolved() | i.InterventionOverdue():
            return f"{event.intervention}: "
        case x.ExperimentEvent():
            return f"{event.experiment}: "
        case c.CampaignEvent():
            return f"{event.campaign}: "
        case RequestRepeated():
            return f"{'the lab' if event.subject == g.WHOLE_LAB else local(event.subject)}: "
    return ""


def _name_action(event: Any, names: Catalogue) -> str:
    """``sealer.seal``; just ``sealer`` if the step is not known."""
    step = names.find_step(event.run, event.step)
    module = local(event.module)
    return f"{module}.{step.action}" if step is not None and event.run else module


def _name_anchor(event: st.WindowBreached, names: Catalogue) -> str:
    if event.anchor is None:
        return f"a step of {event.of}"
    anchor = names.find_step(event.run, event.anchor)
    return repr(anchor.key) if anchor is not None else f"step {event.anchor}"


def _when(value: Any, text: str) -> str:
    return text if value else ""


def _words_of(event: ErasureAsked | WordsErased) -> str:
    """The subject whose words are erased."""
    if event.user:
        return f"what {event.user} wrote"
    positions = ", ".join(map(str, event.records[:MOST_NAMED]))
    return f"the words of position {positions}{_when(len(event.records) > MOST_NAMED, ' …')}"


def _name_place(target: str) -> str:
    """The scope in which starts are paused: an experiment, or a place."""
    return "in the lab" if target == g.WHOLE_LAB else f"of {local(target)}"


def describe_counts(contents: Sequence[str]) -> str:
    """``2 × plate96, 1 × lid96``, or ``empty``."""
    counts = {kind: contents.count(kind) for kind in contents}
    return ", ".join(f"{n} × {kind}" for kind, n in counts.items()) or "empty"


def _describe_sight(event: b.StationObserved) -> str:
    what = event.labware or event.type or "something"
    if event.count is None:
        return what
    return f"{event.count} × {what}" if event.count else "nothing"


MOST_NAMED = 5
"""At most so many positions are named."""

_DONE = {"all": "it was done", "none": "it was not done"}


def _describe_suggestion(event: OrderSuggested) -> str:
    if event.line:
        return f"{event.by} suggests an order of {len(event.line)} runs in {event.workcell} to begin with"
    if not event.steps:
        return f"{event.by} suggests no order in {event.workcell} any more"
    return f"{event.by} suggests an order for {len(event.steps)} steps in {event.workcell}"


def _describe_booking(event: k.BookingTerms) -> str:
    whom = (
        "maintenance" if event.maintenance else _when(event.group, f"the group {event.group}") or event.user
    )
    times = f"from {show_time(event.begins)} until {show_time(event.ends)}"
    more = f"{_when(event.rule, f', {event.rule}')}{_when(event.why, f': {event.why}')}"
    over = ", ".join(event.over)
    return f"{local(event.target)} for {whom} {times}{more}{_when(over, f', over {over}')}"


SENTENCES: dict[type[Event], Callable[[Any, Catalogue], str]] = {
    a.ActionRequested: lambda e, _: f"{local(e.module)}.{e.name} requested (attempt {e.attempt})",
    a.ActionAccepted: lambda e, n: f"{_name_action(e, n)} accepted (attempt {e.attempt})",
    a.ActionRejected: lambda e, n: (
        f"{_name_action(e, n)} refused for {'good' if e.final else 'now'}: {e.why}"
    ),
    a.ActionSucceeded: lambda e, n: (
        f"{_name_action(e, n)} succeeded" + _when(e.result is not None, f", result {shorten_value(e.result)}")
    ),
    a.ActionReported: lambda e, n: (
        f"{_name_action(e, n)} is reported as done; observed: {', '.join(map(local, e.looks))}"
    ),
    a.ActionFailed: lambda e, n: (
        f"{_name_action(e, n)} failed (effects: {e.effects}"
        + _when(e.kind != "software", f", {e.kind} error")
        + f"): {e.error}"
    ),
    a.ActionUnknown: lambda e, n: f"{_name_action(e, n)} ended unknown: {e.why}",
    a.ActionReconciled: lambda e, n: (
        f"{_name_action(e, n)} settled by {e.by}: {_DONE.get(e.effects, e.effects)}"
    ),
    a.ActionEvidence: lambda e, n: (
        f"{_name_action(e, n)}: late report of "
        f"{('success' if e.succeeded else f'failure ({e.error})')}, effects {e.effects}; settled as "
        f"{e.settled_as}"
    ),
    a.ActionDiscovered: lambda e, _: (
        f"the node knows an action {e.name!r} ({e.status}) that this log does not"
    ),
    b.LabwarePlaced: lambda e, _: (
        f"({e.type}) placed at {local(e.station)}"
        + _when(e.stack, f" from the stack {local(e.stack)}")
        + _when(e.lot, f" (lot {e.lot})")
        + _when(e.on, f" on {e.on}")
        + f", of {owner_name(e.owner)}"
    ),
    b.LabwareMoved: lambda e, _: (
        f"moved from {local(e.source)} to {local(e.target)}" + _when(e.on, f", onto {e.on}")
    ),
    b.LabwareRemoved: lambda e, _: f"left the bench{_when(e.where, f' at {local(e.where)}')}: {e.why}",
    b.LabwareUncertain: lambda e, _: (
        f"may be at any of: {', '.join(local(place) or 'gone' for place in e.places)} ({e.why})"
    ),
    b.LabwareObserved: lambda e, _: f"seen at {local(e.station)} by {e.by}",
    b.LabwareChanged: lambda e, _: f"now has {e.variable} = {shorten_value(e.value)}",
    b.BarcodeRead: lambda e, _: f"bears the barcode {e.barcode} (read by {e.by})",
    b.LiquidTransferred: lambda e, _: (
        f"got {sum(e.volumes_ul):g} µL of {e.liquid} into {len(e.wells)} wells at {local(e.module)}"
        + _when(e.lots, f" (lot {', '.join(e.lots)})")
        + _when(not e.certain, ", or part of it")
    ),
    b.LiquidDrawn: lambda e, _: (
        f"gave {sum(e.volumes_ul):g} µL out of {len(e.wells)} wells at {local(e.module)}"
        + _when(not e.certain, ", or part of it")
    ),
    b.SamplesRegistered: lambda e, _: f"holds {e.count} samples (sheet {e.sheet[:12]})",
    b.LabwareHandedOver: lambda e, _: (
        ("is lent to " if e.lent else "now belongs to ")
        + owner_name(e.owner)
        + _when(e.by, f" (given by {e.by}{_when(e.note, f': {e.note}')})")
    ),
    b.StationLoaded: lambda e, _: (
        f"{e.count} × {e.type} loaded at {local(e.station)}{_when(e.lot, f' (lot {e.lot})')}"
    ),
    b.StationUnloaded: lambda e, _: f"{e.count} taken away from {local(e.station)}",
    b.StationObserved: lambda e, _: f"{e.by} saw {_describe_sight(e)} at {local(e.station)}",
    b.StationDeclared: lambda e, _: f"{local(e.station)} declared: {describe_counts(e.contents)}",
    b.WasteEmptied: lambda e, _: f"{local(e.station)} was emptied",
    r.RunSubmitted: lambda e, _: (
        f"{e.user} submitted {e.workflow!r}"
        + _when(e.experiment, f" in experiment {e.experiment}")
        + _when(e.closing, " to clear away its labware")
        + _when(e.due_at, f", due {show_time(e.due_at)}")
    ),
    r.RunBound: lambda e, _: (
        f"takes {', '.join(f'{local(m)} for {key!r}' for key, m in e.modules.items())}"
        + _when(e.why, f", as {e.why}")
        if e.modules
        else "is bound to one of its plans"
    ),
    r.RunStarted: lambda e, _: "started",
    RequestRepeated: lambda e, _: f"{e.request} was requested again: {e.why}",
    r.RunPaused: lambda e, _: f"paused{_when(e.why, f': {e.why}')}",
    r.RunResumed: lambda e, _: "resumed",
    r.RunCancelling: lambda e, _: (
        f"ends when its running actions have ended{_when(e.why or e.reason, f': {e.why or e.reason}')}"
    ),
    r.RunLeaving: lambda e, _: (
        f"clears its labware away in {len(e.steps)} step{('s' if len(e.steps) > 1 else '')}"
    ),
    r.RunCompleted: lambda e, _: f"completed all {e.steps} steps",
    r.RunFailed: lambda e, _: f"failed ({e.kind} error): {e.why}",
    r.RunCancelled: lambda e, _: f"cancelled{_when(e.why, f': {e.why}')}",
    st.WindowBreached: lambda e, n: f"did not start within {e.within_s:g} s after {_name_anchor(e, n)}",
    st.StepRetried: lambda e, _: (
        f"is done again{_when(e.delay_s, f' in {e.delay_s:g} s')} (retry {e.number} of {e.times}): {e.why}"
    ),
    st.StepSkipped: lambda e, _: f"is left out: {e.why}",
    st.StepUnexpected: lambda e, _: f"is not as expected: {e.why}",
    st.StepRecovering: lambda e, _: f"failed, and its recovery steps begin: {e.why}",
    PlanRecorded: lambda e, _: f"plan of {e.workflow!r} on {e.workcell}, {e.steps} steps",
    PlanStepsRecorded: lambda e, _: f"steps #{e.first} to #{e.first + len(e.steps) - 1} of its plan",
    g.LabCreated: lambda e, _: (
        f"the lab {e.name!r} was created" + _when(e.pace != 1, f", simulated at {e.pace:g} × real time")
    ),
    g.KernelStarted: lambda e, _: f"a kernel started (epoch {e.epoch}, LabOS {e.version})",
    h.LogFoundShorter: lambda e, _: (
        f"this log has lost its end: it ends at {e.ended}, and {local(e.evidence)} {e.knows}"
    ),
    h.StationsChecked: lambda e, _: f"{e.by} has reported the content of {', '.join(map(local, e.stations))}",
    h.BenchCompared: lambda e, _: (
        f"{e.by} has checked the whole bench{_when(e.note, f' ({e.note})')}: the lab continues"
    ),
    g.WorkcellApplied: lambda e, _: (
        f"workcell {e.name} applied: {len(e.modules)} modules ({e.digest[:12]})"
        + _when(e.labware, f", its labware: {', '.join(kind.name for kind in e.labware)}")
    ),
    g.StartsPaused: lambda e, _: f"{e.by} paused starts {_name_place(e.target)}{_when(e.why, f': {e.why}')}",
    g.StartsResumed: lambda e, _: f"{e.by} resumed starts {_name_place(e.target)}",
    g.AccessRequested: lambda e, _: (
        f"workcell {e.name}: {e.by} requested access{_when(e.why, f' ({e.why})')}; nothing starts there"
    ),
    g.AccessGranted: lambda e, _: f"workcell {e.name}: nothing moves",
    g.AccessEnded: lambda e, _: f"workcell {e.name}: {e.by} ended the access{_when(e.note, f' ({e.note})')}",
    g.StationsApplied: lambda e, _: f"workcell {e.name}: {len(e.stations)} stations",
    m.NodeJoined: lambda e, _: (
        f"node joined ({e.driver} {e.version}{_when(e.simulated, ', simulated')}), {e.status}"
    ),
    m.NodeLeft: lambda e, _: f"node gone: {e.why}",
    m.NodeStateChanged: lambda e, _: f"{e.status}{_when(e.error, f': {e.error}')}",
    m.VariableSet: lambda e, _: (
        f"{e.variable} is {'not known' if e.value is None else shorten_value(e.value)}"
        + _when(e.by, f" (by {e.by})")
    ),
    m.SetpointClaimed: lambda e, _: (
        f"{e.setpoint} is {('not known' if e.value is None else shorten_value(e.value))}, held for {e.by}"
    ),
    m.SetpointReleased: lambda e, _: f"{e.setpoint} is no longer held for {e.by}",
    m.ModuleTakenOut: lambda e, _: (
        f"taken out of service: {e.why}" + _when(e.until, f" (until {show_time(e.until)})")
    ),
    m.ModulePutBack: lambda e, _: "back in service",
    m.LocationTaught: lambda e, _: (
        f"taught {local(e.station)}{_when(e.labware_type, f' for {e.labware_type}')} (version {e.version})"
        + f" by {e.by}{_when(e.why, f': {e.why}')}"
    ),
    m.ModuleCalibrated: lambda e, _: (
        f"calibrated{_when(e.what, f' ({e.what})')} by {e.by}"
        + _when(e.certificate, f", certificate {e.certificate}")
        + f"{_when(e.until, f', valid until {e.until}')}{_when(e.why, f': {e.why}')}"
    ),
    m.EmergencyStopped: lambda e, _: f"stopped in an emergency by {e.by or 'somebody'}",
    m.StopReported: lambda e, _: (
        f"{e.by or 'somebody'} stopped {('everything' if e.target == '*' else e.target)} in an "
        f"emergency: {len(e.stopped)} modules confirm it"
        + (f", unknown for {', '.join(map(local, e.silent))}" if e.silent else "")
    ),
    s.LevelSet: lambda e, _: (
        f"{e.resource} set to {e.level:g} of {e.capacity:g}{_when(e.lot, f' (lot {e.lot})')}"
    ),
    s.ResourceReplenished: lambda e, _: (
        f"{e.amount:g} of {e.resource} put in{' instead' if e.instead else ''}"
        + _when(e.lot, f" (lot {e.lot})")
        + _when(e.expires, f", good until {e.expires}")
    ),
    s.ResourceConsumed: lambda e, _: (
        f"{e.amount:g} of {e.resource} used{_when(e.run, f' by {e.run}')}{_when(e.lot, f' (lot {e.lot})')}"
    ),
    i.InterventionRequested: lambda e, _: (
        f"a person is asked: {e.text} Choices: {', '.join(choice.name for choice in e.choices)}."
    ),
    i.InterventionResolved: lambda e, _: (
        ("withdrawn" if e.choice == "withdrawn" else f"{e.by} chose {e.choice!r}")
        + _when(e.note, f" ({e.note})")
    ),
    i.InterventionOverdue: lambda e, _: f"not confirmed by {show_time(e.due_at)}, when it was due",
    c.CampaignSubmitted: lambda e, _: (
        f"{e.user} submitted the campaign {e.name!r}: {e.workflow} for {e.rows} rows"
        + _when(e.cloned_from, f", once more after {e.cloned_from}")
        + ("" if e.visibility == "lab" else f" ({e.visibility})")
    ),
    c.CampaignPaused: lambda e, _: f"paused{_when(e.why, f': {e.why}')}",
    c.CampaignResumed: lambda e, _: "resumed",
    c.CampaignAmended: lambda e, _: "continues with other terms",
    c.CampaignRowRefused: lambda e, _: f"row {e.row + 1} cannot be carried out: {e.why}",
    c.CampaignStopped: lambda e, _: f"stopped: {e.why}",
    c.CampaignCancelled: lambda e, _: f"cancelled{_when(e.why, f': {e.why}')}",
    c.CampaignArchived: lambda e, _: "archived",
    c.CampaignUnarchived: lambda e, _: "is shown in lists again",
    c.CampaignCompleted: lambda e, _: (
        f"completed: {e.completed} runs completed, {e.failed} failed, {e.cancelled} cancelled"
        + _when(e.refused, f"; {e.refused} rows were refused")
        + _when(e.left, f"; {e.left} rows were left")
    ),
    q.SharesApplied: lambda e, _: (
        f"weights and quotas of {len(e.groups)} groups and {len(e.users)} users are valid from now on"
    ),
    OrderSuggested: lambda e, _: _describe_suggestion(e),
    RunSigned: lambda e, _: f"{e.by} signed {e.run}: {e.meaning}{_when(e.why, f': {e.why}')}",
    RecordsSigned: lambda e, _: (
        f"{e.by} signed the {e.kind} {e.subject} with {e.runs} run{'' if e.runs == 1 else 's'}: "
        f"{e.meaning}{_when(e.why, f': {e.why}')}"
    ),
    ErasureAsked: lambda e, _: (
        f"{e.by} asks to erase {_words_of(e)} ({e.because}); a second person has to agree ({e.erasure})"
    ),
    ErasureRefused: lambda e, _: f"{e.by} did not agree to {e.erasure}: no words are erased",
    WordsErased: lambda e, _: (
        f"{e.by} erased {_words_of(e)} ({e.because}; {len(e.digests)} texts)"
        f"{_when(e.approved_by, f'; {e.approved_by} agreed')}"
    ),
    PolicyApplied: lambda e, _: "a new policy decides which submissions wait for an approval",
    ApprovalRequested: lambda e, _: (
        f"{'its change ' if e.kind == 'amendment' else ''}waits for approval: "
        + "; ".join(why.text for why in e.why)
    ),
    ApprovalGiven: lambda e, _: f"approved by {e.by} ({e.digest[:12]}){_when(e.comment, f': {e.comment}')}",
    ApprovalRefused: lambda e, _: f"{e.by} did not approve it{_when(e.comment, f': {e.comment}')}",
    RunApproved: lambda e, _: f"approved by {e.by}, as a second person",
    u.UserAdded: lambda e, _: f"{e.user} may use the lab ({e.kind})",
    u.UserDisabled: lambda e, _: f"{e.user} is disabled",
    u.UserEnabled: lambda e, _: f"{e.user} is enabled again",
    u.UserErased: lambda e, _: f"the personal data of {e.user} was erased",
    u.GroupAdded: lambda e, _: f"the group {e.group} was added",
    u.GroupRemoved: lambda e, _: f"the group {e.group} was removed",
    u.MemberAdded: lambda e, _: f"{e.user} is in the group {e.group}",
    u.MemberRemoved: lambda e, _: f"{e.user} is no longer in the group {e.group}",
    u.RoleGranted: lambda e, _: f"{owner_name(e.subject)} now has the role {e.role} {_name_place(e.scope)}",
    u.RoleRevoked: lambda e, _: f"{owner_name(e.subject)} no longer has a role {_name_place(e.scope)}",
    k.BookingMade: lambda e, _: f"{e.by} booked {_describe_booking(e)}",
    k.BookingChanged: lambda e, _: f"{e.by} changed it: {_describe_booking(e)}",
    k.BookingCancelled: lambda e, _: f"{e.by} cancelled it{_when(e.why, f': {e.why}')}",
    k.BookingSkipped: lambda e, _: (
        f"{e.by} left out the time from {show_time(e.begins)}{_when(e.why, f': {e.why}')}"
    ),
    k.BookingNeared: lambda e, _: f"begins at {show_time(e.begins)}",
    k.BookingBegan: lambda e, _: f"has begun, until {show_time(e.ends)}",
    k.BookingEnded: lambda e, _: "is over" + _when(e.over, ", and is not repeated"),
    x.ExperimentStarted: lambda e, _: f"{e.user} started the experiment {e.name!r}",
    x.ExperimentCancelled: lambda e, _: f"{e.why}: it takes no more runs",
    x.ExperimentClosing: lambda e, _: f"closing: {e.why}",
    x.ExperimentEnded: lambda e, _: "ended" + _when(e.why not in ("", "ended"), f": {e.why}"),
    x.ExperimentResumed: lambda e, _: "its application was started again and continues",
    x.ExperimentNoted: lambda e, _: (
        f"{e.kind.replace('_', ' ')} {e.name!r}" + _when(e.facts, f": {shorten_value(e.facts)}")
    ),
}
"""The sentence for each type of event, without its subject."""
