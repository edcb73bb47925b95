"""What an action's end, known or not, means for the bench and for the people in the room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.core.actions import (
    Action,
    ActionReconciled,
    EffectsDone,
)
from labos.core.bench import a1_after, parts, removal
from labos.core.canonical import canonical
from labos.core.decide.barcodes import readings
from labos.core.decide.endings import Placement, conclude
from labos.core.effects import (
    AnyEffect,
    Claims,
    Consumes,
    Draws,
    Move,
    Releases,
    Relid,
    Replaces,
    Sets,
    Take,
    Transfers,
    Unlid,
    hand_of,
    places,
    reported,
)
from labos.core.ids import NOBODY, SHARED, LabwareId, ModuleName, Owner, StationName, local, run_owner
from labos.core.interventions import UNNUMBERED, Choice, InterventionRequested
from labos.core.labware import (
    LabwareChanged,
    LabwareMoved,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    LabwareUncertain,
    LiquidDrawn,
    LiquidTransferred,
)
from labos.core.modules import SetpointClaimed, SetpointReleased, VariableSet
from labos.core.registry import Event
from labos.core.resources import ResourceConsumed, ResourceReplenished, charges
from labos.core.rules import may_still_act
from labos.core.runs import DONE, FAILED, PENDING
from labos.core.state import LabState
from labos.core.wells import doses_of

LARGEST_RESULT = 48 * 1024
"""Bytes of JSON that a result may take in the log."""


Placements = tuple[Placement, ...]


def uncertain(action: Action, effect: Move, why: str) -> LabwareUncertain:
    """The labware of a motion that nobody saw end: at its start, in the hand, on the way, at its
    target."""
    places = [effect.source, hand_of(action.module), effect.target]
    if effect.via:
        places.insert(2, effect.via)
    plate = effect.plate if isinstance(effect, Unlid | Relid) else LabwareId("")
    return LabwareUncertain(effect.labware, action.run, tuple(places), why, action.id, plate)


def question_about(action: Action, why: str, maybe: Sequence[LabwareUncertain]) -> InterventionRequested:
    """What a person is asked about an action whose outcome nobody knows; ``maybe`` is where its labware
    may be."""
    name = local(action.module)
    text = f"{name}: {action.name!r} ended unknown ({why})."
    if maybe:
        places = ", ".join(local(p) or "nowhere on the bench" for p in maybe[0].places)
        text = f"{text} {maybe[0].labware} may be at: {places}."
    moves = [e for e in action.effects if isinstance(e, Move)]
    if moves:
        choices = (
            Choice("done", f"It stands at {local(moves[0].target)}: the step counts as done."),
            Choice("not_done", f"It stands at {local(moves[0].source)}: the step is done again."),
            Choice("gone", "It was taken off the bench: the run ends."),
        )
    else:
        choices = (
            Choice("done", "It was done: the run goes on."),
            Choice("not_done", "It was not done: the step is done again."),
            Choice("gone", "It was spoilt: the run ends."),
        )
    return InterventionRequested(
        UNNUMBERED,
        "unknown_action",
        action.id,
        text,
        choices,
        run=action.run,
        module=action.module,
    )


def kept(result: Any) -> Any:
    """A result, or the note that it was too large for the log or cannot be written there: nodes keep to the
    limits, and a result that does not is not worth a stopped lab."""
    try:
        size = len(canonical([result])) - len("[]")  # in its event it stands one level deeper
    except (ValueError, TypeError) as error:
        return {"$unreadable": str(error)[:200]}
    return result if size <= LARGEST_RESULT else {"$too_large": size}


def read_later(state: LabState, action: Action) -> bool:
    """Whether later steps of its run read what an action results in."""
    run = state.runs.active.get(action.run)
    told = bool(action.looks)  # its device has said what it results in
    return run is not None and not told and action.step in state.runs.plan_of(run).feeds


def shown_by(state: LabState, action: Action, place: StationName | None) -> str:
    """The answer about an unknown action that the place of its labware gives; empty if it gives none. What is
    in the hand, or on the way, shows nothing: somebody has to put it down first."""
    motions = [e for e in action.effects if isinstance(e, Move | Take)]
    move = motions[0] if len(motions) == 1 else None
    if not isinstance(move, Move) or may_still_act(state, action):
        return ""
    if place == move.source:
        return "not_done"
    return "done" if place == move.target and not read_later(state, action) else ""


def settle(state: LabState, action: Action, choice: str, by: str, result: Any = None) -> list[Event]:
    """The events that follow from an answer about an unknown action."""
    if choice == "done" and result is None and action.looks:
        result = action.result
    done: EffectsDone = {"done": "all", "not_done": "none"}.get(choice, "partial")  # type: ignore[assignment]
    events: list[Event] = [
        ActionReconciled(action.id, action.run, action.step, action.module, action.attempt, done, by, result)
    ]
    extra: Placements = ()
    if choice == "gone":
        for effect in action.effects:
            if isinstance(effect, Move):
                where = StationName("")
                why = f"taken away ({by})"
                events += removal(state.bench, effect.labware, action.run, where, why, action.id)
                extra = (*extra, Placement(effect.labware, gone=True))
            elif isinstance(effect, Take):
                events += _taken_away(state, action.run, effect, by)
            elif isinstance(effect, Consumes):
                events += used_up(state, action, effect, events)
    elif choice == "not_done":
        for effect in action.effects:
            if isinstance(effect, Move):
                events.append(_found(state, effect, effect.source, action.run, by, action.id))
        extra = _at_its_start(action.effects)
    else:
        took_place, extra = effect_events(state, action, "all", "", result, looked=True)
        read, doubted = readings(state, action, result, by)
        events += [*took_place, *read]
        extra = (*extra, *doubted)
    run = state.runs.active.get(action.run)
    if run is not None:
        outcome = {"done": DONE, "not_done": PENDING}.get(choice, FAILED)
        why = f"{action.name!r} on {local(action.module)} was spoilt ({by})"
        events += conclude(state, run, action.step, outcome, why, extra, result=result)
    return events


def effect_events(
    state: LabState, action: Action, done: EffectsDone, why: str, result: Any = None, *, looked: bool = False
) -> tuple[list[Event], Placements]:
    """What an ended action did to the bench, as events; and where labware stands after them. What
    the device decided itself, such as a slot, is read from its result. Somebody who has ``looked`` is
    believed, whatever was seen before; a device is not."""
    if done == "none":
        return back_in_place(state, action), put_back(state, action)
    events: list[Event] = []
    extra: list[Placement] = []
    seen = {} if looked else carried_off(state, action)
    for effect in action.effects:
        match effect:
            case Move() if effect.labware in seen:
                extra.append(Placement(effect.labware, seen[effect.labware]))
            case Move() if done == "all":
                events += _moved(state, action, effect)
                events += _turned(state, action, effect)
                waste = state.bench.stations[effect.target].spec.kind == "waste"
                extra.append(Placement(effect.labware, "" if waste else effect.target, gone=waste))
            case Move():
                events.append(uncertain(action, effect, why))
                extra.append(Placement(effect.labware))
            case Take() if done == "all":
                item, lot = topmost(state, effect)
                owner = run_owner(action.run) if action.run in state.runs.active else SHARED
                events += unstacked(state, effect, item, lot, owner, action.run, action.id, len(events))
                extra.append(Placement(effect.labware, effect.target))
            case Sets(of="module"):
                value = reported(effect.value, result) if done == "all" else None
                events.append(VariableSet(action.module, effect.variable, value, action.run))
            case Sets() if effect.labware and Placement(effect.labware, gone=True) not in extra:
                value = reported(effect.value, result) if done == "all" else None
                events.append(LabwareChanged(effect.labware, action.run, effect.variable, value, action.id))
            case Claims():
                value = effect.value if done == "all" else None
                if action.run in state.runs.active:
                    events.append(SetpointClaimed(action.module, effect.setpoint, value, action.run))
            case Releases() if done == "all":
                events.append(SetpointReleased(action.module, effect.setpoint, action.run))
            case Transfers() if effect.labware:
                events += _transferred(state, action, effect, certain=done == "all")
            case Draws() if effect.labware:
                events += _drawn(state, action, effect, certain=done == "all")
            case Consumes():
                # Of a failed action it is not known how much was used: all is the safe answer.
                events += used_up(state, action, effect, events)
            case Replaces() if done == "all":
                events += _replaced(state, effect)
            case _:
                pass
    lost = tuple(e for e in action.effects if isinstance(e, Move | Take) and e.labware not in seen)
    if done != "all" and lost:
        events.append(_lost_track(action, lost, why))
    return events, tuple(extra)


def used_up(state: LabState, action: Action, effect: Consumes, before: list[Event]) -> list[Event]:
    """What an action used, one event for each lot; ``before`` are the events that come first."""
    already = sum(
        e.amount for e in before if isinstance(e, ResourceConsumed) and e.resource == effect.resource
    )
    if not effect.amount:
        return []
    parts = charges(state.resources, action.module, effect.resource, float(effect.amount), already)
    return [
        ResourceConsumed(action.module, effect.resource, amount, action.run, action.id, lot)
        for lot, amount in parts
    ]


def _replaced(state: LabState, effect: Replaces) -> list[Event]:
    """A full pack is in; nothing where nobody ever said how much the module holds."""
    module = ModuleName(effect.module)
    level = state.resources.of(module, effect.resource)
    if level is None:
        return []
    put_in = (level.capacity, effect.lot, effect.expires)
    return [ResourceReplenished(module, effect.resource, *put_in, instead=True)]


def _transferred(state: LabState, action: Action, effect: Transfers, *, certain: bool) -> list[Event]:
    """What a pipette put into wells; nothing where there are no lists of them."""
    pairs = _doses(state, effect)
    if not pairs:
        return []
    amount = sum(volume for _, volume in pairs)
    parts = charges(state.resources, action.module, effect.resource, amount) if effect.resource else []
    names, amounts = zip(*pairs, strict=True)
    lots = tuple(lot for lot, _ in parts if lot)
    about = (effect.labware, action.run, action.module, effect.liquid)
    return [LiquidTransferred(*about, names, amounts, lots, certain, action.id)]


def _drawn(state: LabState, action: Action, effect: Draws, *, certain: bool) -> list[Event]:
    """What a pipette drew out of wells; nothing where there are no lists of them."""
    pairs = _doses(state, effect)
    if not pairs:
        return []
    names, amounts = zip(*pairs, strict=True)
    return [LiquidDrawn(effect.labware, action.run, action.module, names, amounts, certain, action.id)]


def _doses(state: LabState, effect: Transfers | Draws) -> list[tuple[str, float]]:
    try:
        doses = doses_of(effect)
    except ValueError:
        return []  # it was refused before it was asked for; an older LabOS did not look
    return [(w, volume) for w, volume in doses if volume] if effect.labware in state.bench.labware else []


def carried_off(state: LabState, action: Action) -> dict[LabwareId, StationName]:
    """Where somebody has seen labware of a motion since nobody knew how that ended, if that is on none of
    its places: that is later than what the device tells now."""
    own = {StationName(""), hand_of(action.module), *places(action.effects)}
    moved = [state.bench.labware[e.labware] for e in action.effects if isinstance(e, Move)]
    astray = state.shorter.astray  # an action that came after this one may have taken it further
    return {item.id: item.station for item in moved if item.station not in own or item.id in astray}


def _moved(state: LabState, action: Action, effect: Move) -> list[Event]:
    if state.bench.stations[effect.target].spec.kind == "waste":
        return removal(state.bench, effect.labware, action.run, effect.target, "discarded", action.id)
    labware = state.bench.labware[effect.labware]
    if labware.maybe:
        return [LabwareObserved(effect.labware, action.run, effect.target, local(action.module))]
    plate = effect.plate if isinstance(effect, Relid) else LabwareId("")
    source = labware.station or effect.source
    return [LabwareMoved(effect.labware, action.run, source, effect.target, action.id, plate)]


def _found(
    state: LabState, effect: Move, place: StationName, run: str, by: str, action: str = ""
) -> LabwareObserved | LabwareMoved:
    """Labware of a motion is at its start or its target. A lid that was seen off its plate meanwhile lies
    on it again."""
    item = state.bench.labware[effect.labware]
    on_plate = effect.source if isinstance(effect, Unlid) else effect.target
    plate = effect.plate if isinstance(effect, Unlid | Relid) and place == on_plate else LabwareId("")
    if plate and item.on != plate:
        return LabwareMoved(item.id, run, item.station or place, place, action, plate)
    return LabwareObserved(item.id, run, place, by)


def _turned(state: LabState, action: Action, effect: Move) -> list[Event]:
    if isinstance(effect, Unlid | Relid) or state.bench.stations[effect.target].spec.kind == "waste":
        return []
    labware = state.bench.labware[effect.labware]
    way = a1_after(state.bench, effect, labware)
    if way == (labware.variables.get("a1") or 0):
        return []
    return [LabwareChanged(labware.id, action.run, "a1", way, action.id)]


def unstacked(
    state: LabState,
    effect: Take,
    item: str,
    lot: str,
    owner: Owner,
    run: str,
    action: str = "",
    ahead: int = 0,
) -> list[Event]:
    """An item of a stack as labware of its own, and its lid, if it has one. ``ahead`` keeps the
    names of several lids in one batch apart."""
    kind, lid = parts(item)
    name = effect.labware
    events: list[Event] = [LabwarePlaced(name, run, kind, effect.target, owner, effect.stack, action, lot)]
    if lid:
        fresh = LabwareId(f"P{state.bench.named + 1 + ahead}")
        events.append(LabwarePlaced(fresh, run, lid, effect.target, owner, action=action, on=name))
    return events


def back_in_place(state: LabState, action: Action) -> list[Event]:
    return [
        LabwareObserved(effect.labware, action.run, effect.source, local(action.module))
        for effect in action.effects
        if isinstance(effect, Move) and _in_doubt(state, effect)
    ]


def _in_doubt(state: LabState, effect: Move) -> bool:
    """Whether it is this motion that labware is uncertain by."""
    return bool(state.bench.labware[effect.labware].maybe) and effect.labware not in state.shorter.astray


def put_back(state: LabState, action: Action) -> Placements:
    """Where ``back_in_place`` leaves labware."""
    lost = [e for e in action.effects if isinstance(e, Move) and _in_doubt(state, e)]
    return _at_its_start(lost)


def _at_its_start(effects: Sequence[AnyEffect]) -> Placements:
    """What was not moved stands where it was; a lid, on its plate."""
    moves = [e for e in effects if isinstance(e, Move) and not isinstance(e, Unlid)]
    return tuple(Placement(effect.labware, effect.source) for effect in moves)


def topmost(state: LabState, effect: Take) -> tuple[str, str]:
    """The type and the lot of what is taken off a stack."""
    stack = state.bench.stations[effect.stack]
    return stack.stock[-1], stack.lots[-1]


def _taken_away(state: LabState, run: str, effect: Take, by: str) -> list[Event]:
    """A person took away what had come off a stack. It gets its name there: where it was to stand others
    may stand by now."""
    item, lot = topmost(state, effect)
    return [
        LabwarePlaced(effect.labware, run, parts(item)[0], effect.stack, NOBODY, effect.stack, lot=lot),
        LabwareRemoved(effect.labware, run, StationName(""), f"taken away ({by})"),
    ]


def _lost_track(action: Action, motions: tuple[Move | Take, ...], why: str) -> InterventionRequested:
    """A motion failed half-way: a person has to say where the labware is now."""
    choices = [Choice("gone", "It was taken off the bench.")]
    for effect in motions:
        start = effect.source if isinstance(effect, Move) else effect.stack
        choices.append(Choice("source", f"It stands at {local(start)}."))
        choices.append(Choice("target", f"It stands at {local(effect.target)}."))
    return InterventionRequested(
        UNNUMBERED,
        "lost_labware",
        action.id,
        f"{why.rstrip('.')}. Where is {', '.join(e.labware for e in motions)} now?",
        tuple(choices),
        run=action.run,
        module=action.module,
        motions=motions,
    )


def found_again(state: LabState, motions: tuple[AnyEffect, ...], choice: str, by: str) -> list[Event]:
    """The events that follow when a person says where lost labware is."""
    events: list[Event] = []
    for effect in motions:
        match effect, choice:
            case Move(), _ if effect.labware not in state.bench.labware:
                pass  # it has left the bench since the question was asked
            case Move(), "gone":
                why = f"taken away ({by})"
                events += removal(state.bench, effect.labware, "", StationName(""), why)
            case Move(), _:
                place = effect.source if choice == "source" else effect.target
                if state.bench.stations[place].spec.kind == "waste":
                    events += removal(state.bench, effect.labware, "", place, f"discarded ({by})")
                else:
                    events.append(_found(state, effect, place, "", by))
            case Take(), "gone":
                events += _taken_away(state, "", effect, by)
            case Take(), "target":
                item, lot = topmost(state, effect)
                events += unstacked(state, effect, item, lot, SHARED, "")
            case _:
                pass
    return events
