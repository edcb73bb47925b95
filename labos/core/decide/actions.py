"""From a step that may start to the end of its action, with a known or an unknown outcome."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from itertools import chain
from typing import Any

import msgspec

from labos.core.actions import (
    Action,
    ActionAccepted,
    ActionEvidence,
    ActionFailed,
    ActionRejected,
    ActionReported,
    ActionRequested,
    ActionStatus,
    ActionSucceeded,
    EffectsDone,
    FailureKind,
)
from labos.core.bench import split_item
from labos.core.decide._base import Decision, InnerCommand, Rejection, Report, check_recordable, decides
from labos.core.decide.barcodes import record_barcodes
from labos.core.decide.choices import bind
from labos.core.decide.endings import give_up
from labos.core.decide.inputs import fill_inputs, name_returned_files
from labos.core.decide.lookups import decides_about, find_action, find_attempt
from labos.core.decide.outcomes import (
    find_shown_outcome,
    limit_result,
    list_effect_events,
    put_back_in_place,
    settle,
)
from labos.core.decide.steps import doubt
from labos.core.decide.work import ask_for_work, find_work
from labos.core.effects import (
    AnyEffect,
    Draws,
    Move,
    Needs,
    Take,
    Transfers,
    find_labware_changed,
    find_labware_used,
    list_carried,
    list_moved,
)
from labos.core.ids import ActionId, LabwareId, RunId, StationName, local, run_owner, workcell_of
from labos.core.labware import LabwareHandedOver
from labos.core.model import LABWARE_TYPE, PLATE_TYPE, Plan, PlanStep
from labos.core.modules import ModuleStatus, NodeStateChanged, find_unproven
from labos.core.registry import Event
from labos.core.rules import examine, find_end_by
from labos.core.runs import RunStarted, RunState, RunStatus, find_results
from labos.core.shelves import expand_hotels
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import LateResult
from labos.core.waits import Wait
from labos.core.watching import list_watched
from labos.core.wells import find_misfit


class StartStep(InnerCommand, frozen=True):
    """Request a step's action. ``action`` is its permanent id. If a run has several plans to choose from, its
    first step binds it to ``plan``."""

    run: RunId
    step: int
    action: ActionId
    now: int
    plan: str = ""


class AttemptReport(Report, frozen=True):
    action: ActionId
    attempt: int


class AcceptAction(AttemptReport, frozen=True):
    """The node reports that it carries the attempt out."""

    now: int


class RefuseAction(AttemptReport, frozen=True):
    """The node reports that it did not and will not carry the attempt out."""

    why: str
    final: bool = True


class FinishAction(AttemptReport, frozen=True):
    """The node reports how the attempt ended, and when by its own clock (``ended_ns``, 0: unknown).
    ``collided``: something was hit, dropped or jammed. ``journal`` is the journal from which the report
    comes; for an open action it has to be the one for which the request was meant. If ``journal`` is empty,
    the report does not come from a node."""

    succeeded: bool
    effects: EffectsDone
    result: Any = None
    error: str = ""
    ended_ns: int = 0
    collided: bool = False
    journal: str = ""


class ResendAction(AttemptReport, frozen=True):
    """The attempt can never run: make the next attempt."""

    journal: str


class DoubtAction(Report, frozen=True):
    """It cannot be found out whether the attempt was carried out."""

    action: ActionId
    why: str


@decides(StartStep)
def request_action(
    state: LabState, command: StartStep, others: Collection[RunId] = (), together: tuple[ActionId, ...] = ()
) -> Decision:
    """The events of a start. With ``together``, the device carries it out at once with other actions, for the
    runs ``others``."""
    run = state.runs.get(command.run)
    if run is None:
        return Rejection("no_run", f"There is no run {command.run} that has not ended.")
    chooses = bool(run.choices) and not run.has_started
    if chooses:
        if command.plan not in run.choices:
            return Rejection(
                "unbound", f"{run.id} has several plans, and the request does not say which one it follows."
            )
        run = msgspec.structs.replace(run, plan=command.plan)
    found = examine(state, run, command.step, command.now, others)
    if isinstance(found, Wait):
        return Rejection(
            found.code, f"Step {command.step} of {run.id} cannot start: {' '.join(found.names)}."
        )
    plan = state.runs.plan_of(run)
    step = plan.steps[command.step]
    events: list[Event] = [bind(state, run)] if chooses else []
    events += [RunStarted(run.id)] if not run.has_started else []
    results = find_results(plan, run)
    args = fill_inputs(plan, results, step.args)
    if isinstance(args, str):
        return _fail_start(state, run, step, args)
    given = name_returned_files(plan, step, args)
    if isinstance(given, str):
        return _fail_start(state, run, step, given)
    args, files = given
    effects = _complete_effects(state, plan, results, found)
    if fault := _find_liquid_fault(state, effects):
        return _fail_start(state, run, step, fault)
    args = expand_hotels(step.effects, effects, _fill_in_from_labware(state, args, effects))
    if found:
        events += _hand_labware_to_run(state, run, found)
    module = state.modules.by_name[step.module]
    args = _add_labware_types(state, args, effects)
    if "slow" in args and find_unproven(module, effects, args):
        args = {**args, "slow": True}
    events.append(
        ActionRequested(
            action=command.action,
            run=run.id,
            step=command.step,
            module=step.module,
            attempt=1,
            epoch=state.lab.epoch,
            journal=module.journal,
            name=step.action,
            args=args,
            effects=effects,
            exclusive=step.exclusive,
            files=files,
            together=together,
        )
    )
    if step.by_person:
        events.append(ask_for_work(state, run, step, command.action, args, effects, command.now))
    unfit = check_recordable(events)
    if isinstance(unfit, Rejection):  # results of earlier steps were too large for it
        return _fail_start(state, run, step, unfit.message)
    return events


def _hand_labware_to_run(
    state: LabState, run: RunState, effects: tuple[AnyEffect, ...]
) -> Iterator[LabwareHandedOver]:
    """Labware that a step touches gets the run as owner. If the step only needs the labware, the run borrows
    it until it ends."""
    owner, stays, labware = run_owner(run.id), find_labware_changed(effects), state.bench.labware
    names = find_labware_used(effects)
    lids = {labware[name].lid: name for name in names if labware[name].lid}
    for name in dict.fromkeys((*names, *lids)):
        item, lent = labware[name], stays.isdisjoint((name, lids.get(name, name)))
        if item.owner != owner or (item.lender and not lent):
            yield LabwareHandedOver(name, run.id, owner, lent=lent)


def _fail_start(state: LabState, run: RunState, step: PlanStep, why: str) -> Iterator[Event]:
    return give_up(state, run, f"step {step.key!r} cannot be filled in: {why}")


def _fill_in_from_labware(
    state: LabState, args: dict[str, Any], effects: tuple[AnyEffect, ...]
) -> dict[str, Any]:
    """Replace arguments ``{labware.slot}`` by the samples' values of the labware that the step works on;
    empty if there is no value."""
    if not args:
        return args
    subject = next((e.labware for e in effects if isinstance(e, Move | Needs) and e.labware), None)
    values = state.bench.labware[subject].variables if subject else {}
    return {
        name: values.get(value[len("{labware.") : -1]) or ""
        if isinstance(value, str) and value.startswith("{labware.") and value.endswith("}")
        else value
        for name, value in args.items()
    }


def _add_labware_types(
    state: LabState, args: dict[str, Any], effects: tuple[AnyEffect, ...]
) -> dict[str, Any]:
    """Add the types of the carried labware to the arguments, if the action accepts them and the step does not
    set them."""
    if args.get(LABWARE_TYPE) != "" and args.get(PLATE_TYPE) != "":
        return args
    new_args = dict(args)
    for effect in list_carried(effects):
        if effect.stock:
            types = {LABWARE_TYPE: split_item(state.bench.stations[effect.stock].stock[-1])[0]}
        elif effect.labware in state.bench.labware:
            types = {LABWARE_TYPE: state.bench.labware[effect.labware].type}
            if effect.plate in state.bench.labware:
                types[PLATE_TYPE] = state.bench.labware[effect.plate].type
        else:
            continue
        new_args |= {name: kind for name, kind in types.items() if new_args.get(name) == ""}
    return new_args


def _complete_effects(
    state: LabState, plan: Plan, results: dict[int, Any], effects: tuple[AnyEffect, ...]
) -> tuple[AnyEffect, ...]:
    """Replace references to results by the lists of wells and volumes from an earlier step, and give ids to
    labware that is taken from a stack."""
    named = state.bench.named
    out: list[AnyEffect] = []
    for effect in effects:
        if isinstance(effect, Transfers | Draws):
            lists = {"wells": effect.wells, "volumes_ul": effect.volumes_ul}
            known = fill_inputs(plan, results, lists)
            effect = effect if isinstance(known, str) else msgspec.structs.replace(effect, **known)
        elif isinstance(effect, Take):
            named += 1
            effect = msgspec.structs.replace(effect, labware=LabwareId(f"P{named}"))
        out.append(effect)
    return tuple(out)


def _find_liquid_fault(state: LabState, effects: tuple[AnyEffect, ...]) -> str:
    """The fault of the liquids that an action would put into wells or draw; empty if there is none."""
    if not effects:
        return ""
    fed = next((e.labware for e in effects if isinstance(e, Transfers | Draws) and e.labware), None)
    if fed is None:
        return find_misfit(effects, None, {}, "the labware")
    item = state.bench.labware[fed]
    known = state.lab.labware.get(workcell_of(item.station), {}) if item.station else {}
    return find_misfit(effects, known.get(item.type), item.volumes_ul, str(item.id))


@decides_about(AcceptAction, find_attempt)
def accept_action(state: LabState, command: AcceptAction, action: Action) -> Decision:
    accepted = make_from(ActionAccepted, action, action=action.id)
    if action.status == ActionStatus.UNKNOWN and not action.looks:
        # Its node was away and is back. A question because of a late end stays open.
        due = find_end_by(state, action)
        return [] if due is not None and command.now > due else [accepted]
    return [accepted] if action.status == ActionStatus.REQUESTED else []


@decides_about(RefuseAction, find_attempt)
def refuse_action(state: LabState, command: RefuseAction, action: Action) -> Decision:
    if state.shorter.since and action.status == ActionStatus.UNKNOWN and not command.final:
        # Another attempt may have been made in the lost end of the log: a person reports how it ended.
        return []
    # A recovery waits for no change of the module's status: it would be tried again without end.
    final = command.final or _is_recovery(state, action)
    events: list[Event] = [
        make_from(ActionRejected, action, action=action.id, why=command.why, final=final),
        *put_back_in_place(state, action),
    ]
    if not final and state.modules.by_name[action.module].status == ModuleStatus.IDLE:
        # The module is not idle, although its state said so: wait until it reports idle again.
        events.append(NodeStateChanged(action.module, "BUSY", command.why))
    return events


def _is_recovery(state: LabState, action: Action) -> bool:
    """Whether the action resets its module after an error."""
    run = state.runs.active.get(action.run)
    return run is not None and state.runs.plan_of(run).steps[action.step].recovers


@decides(FinishAction)
def finish_action(state: LabState, command: FinishAction) -> Decision:
    command = msgspec.structs.replace(command, result=limit_result(command.result))
    action = state.actions.open.get(command.action)
    if action is None:
        return _keep_evidence(state, command)
    if not 0 < command.attempt <= action.attempt:
        return Rejection(
            "no_attempt",
            f"Attempt {command.attempt} of {action.id} was never sent; the last one is {action.attempt}.",
        )
    if command.journal and command.journal != action.journal:
        return Rejection(
            "other_journal",
            f"{action.id} was sent to journal {action.journal}, but its outcome comes from journal "
            f"{command.journal}.",
        )
    if action.looks:
        return []  # the result is known, and is being confirmed by an observer, or a person is asked
    places = list_watched(state, action) if command.succeeded else ()
    if places:
        return [_report(action, command, places)]
    return finish(state, action, command)


def _report(action: Action, command: FinishAction, places: tuple[StationName, ...]) -> ActionReported:
    ended_ns = command.ended_ns if command.ended_ns >= action.requested_at else 0
    ids = (action.id, action.run, action.step, action.module, command.attempt)
    return ActionReported(*ids, places, command.result, ended_ns)


def finish(state: LabState, action: Action, command: FinishAction) -> Iterator[Event]:
    """The events of an action's end, and of its effects on the bench."""
    ids = (action.id, action.run, action.step, action.module, command.attempt)
    kind: FailureKind = "operational" if command.collided else "software"
    if not command.succeeded:
        yield ActionFailed(*ids, command.error, command.effects, kind)
        why = f"{local(action.module)} could not {action.name!r}: {command.error}"
        yield from list_effect_events(state, action, command.effects, why, command.result)
        return
    ended_ns = command.ended_ns if command.ended_ns >= action.requested_at else 0
    was_in_error = state.modules.by_name[action.module].status == ModuleStatus.ERROR
    recovered = was_in_error and _is_recovery(state, action)
    yield ActionSucceeded(*ids, command.result, ended_ns)
    yield from list_effect_events(state, action, "all", "", command.result)
    yield from record_barcodes(state, action, command.result)
    if recovered:
        yield NodeStateChanged(action.module, "IDLE")


def _keep_evidence(state: LabState, command: FinishAction) -> Decision:
    """A late result for an action that the log has settled: it is kept as evidence, and a contradiction opens
    a question to a person."""
    settled = state.actions.settled.get(command.action)
    if settled is None:
        return []
    effects: EffectsDone = "all" if command.succeeded else command.effects
    events: list[Event] = [
        make_from(
            ActionEvidence,
            command,
            run=RunId(""),
            step=0,
            module=settled.module,
            effects=effects,
            settled_as=settled.effects,
        )
    ]
    if effects != settled.effects:
        name = local(settled.module)
        events.append(
            state.interventions.ask(
                LateResult(action=command.action, module=settled.module),
                f"{name} now reports the effects of an action as {effects!r}; they were recorded as "
                f"{settled.effects!r}. Labware may stand elsewhere than recorded.",
            )
        )
    return events


@decides_about(ResendAction, find_attempt)
def resend_action(state: LabState, command: ResendAction, action: Action) -> Decision:
    if action.status != ActionStatus.REQUESTED:
        return []
    if state.shorter.since and not _is_recovery(state, action):
        # A later attempt may have been made in the lost end of the log. Nothing may move on a bench whose
        # state is unknown.
        return doubt(state, action, "its node never began this attempt, and the log has lost its end")
    run = state.runs.active.get(action.run)
    if run is not None and run.status == RunStatus.CANCELLING:
        why = "the run was being cancelled and the attempt had not begun"
        return [make_from(ActionRejected, action, action=action.id, why=why, final=False)]
    attempt = {"attempt": action.attempt + 1, "epoch": state.lab.epoch, "journal": command.journal}
    return [make_from(ActionRequested, action, action=action.id, **attempt)]


@decides_about(DoubtAction, find_action)
def doubt_action(state: LabState, command: DoubtAction, action: Action) -> Decision:
    if action.looks or find_work(state, action) is not None:
        return []  # its device has reported success, or a person knows the outcome
    if action.status == ActionStatus.UNKNOWN:
        return _settle_by_sight(state, action)
    return doubt(state, action, command.why)


def _settle_by_sight(state: LabState, action: Action) -> Iterable[Event]:
    """Settle an action by observations: its node is back without a result, but its labware was observed
    meanwhile."""
    question = state.interventions.find_about(action.id)
    name = next((move.labware for move in list_moved(action.effects)), None)
    item = state.bench.labware.get(name) if name is not None else None
    choice = find_shown_outcome(state, action, item.station) if item is not None else ""
    if question is None or not choice:
        return []
    seen = question.withdraw("observed at its place meanwhile")
    return chain([seen], settle(state, action, choice, "labos"))
