"""The consequences of an action's end, with a known or unknown outcome, for the bench and for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from labos.core.actions import Action, ActionReconciled, EffectsDone
from labos.core.bench import add_arrival, compute_a1_after, remove_labware, split_item
from labos.core.canonical import encode_canonical
from labos.core.decide.barcodes import record_barcodes
from labos.core.effects import (
    AnyEffect,
    Claims,
    Consumes,
    Draws,
    Move,
    Releases,
    Replaces,
    Sets,
    Take,
    Transfers,
    list_carried,
    list_moved,
    list_places,
    name_hand,
    resolve_value,
)
from labos.core.ids import NOBODY, SHARED, LabwareId, ModuleName, Owner, StationName, local, run_owner
from labos.core.interventions import InterventionRequested
from labos.core.labware import (
    GONE,
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
from labos.core.resources import ResourceConsumed, ResourceReplenished, list_charges
from labos.core.rules import may_still_act
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.topics import LostLabware, UnknownAction
from labos.core.wells import list_doses

LARGEST_RESULT = 48 * 1024
"""The most bytes of JSON that a result may have in the log."""


def mark_uncertain(action: Action, effect: Move, why: str) -> LabwareUncertain:
    """The labware of a motion with an unknown end may be at its source, in the hand, at the regrip station,
    or at its target."""
    places = [effect.source, name_hand(action.module), effect.target]
    if effect.via:
        places.insert(2, effect.via)
    return LabwareUncertain(effect.labware, action.run, tuple(places), why, action.id, effect.plate)


def make_question(
    state: LabState, action: Action, why: str, maybe: Sequence[LabwareUncertain]
) -> InterventionRequested:
    """The question to a person about an action with an unknown outcome. ``maybe`` lists the possible places
    of its labware."""
    name = local(action.module)
    text = f"{name}: {action.name!r} ended unknown ({why})."
    if maybe:
        places = ", ".join(local(p) or "nowhere on the bench" for p in maybe[0].places)
        text = f"{text} {maybe[0].labware} may be at: {places}."
    moves = list_moved(action.effects)
    topic = UnknownAction(run=action.run, module=action.module, action=action.id)
    if moves:
        topic = msgspec.structs.replace(topic, source=moves[0].source, target=moves[0].target)
    return state.interventions.ask(topic, text)


def limit_result(result: Any) -> Any:
    """The result, or a note that it was too large for the log or cannot be written there. Nodes keep to the
    limits; if a result does not, the lab must not stop because of it."""
    if result is None:
        return None
    try:
        size = len(encode_canonical([result])) - len("[]")  # in its event it is nested one level deeper
    except (ValueError, TypeError) as error:
        return {"$unreadable": str(error)[:200]}
    return result if size <= LARGEST_RESULT else {"$too_large": size}


def is_read_later(state: LabState, action: Action) -> bool:
    """Whether later steps of its run read the result of an action."""
    run = state.runs.active.get(action.run)
    reported = bool(action.looks)  # its device has already reported the result
    return run is not None and not reported and action.step in state.runs.plan_of(run).feeds


def find_shown_outcome(state: LabState, action: Action, place: StationName | None) -> str:
    """The answer about an unknown action that the place of its labware shows; empty if it shows none. Labware
    in the hand or at the regrip station shows nothing: a person has to put it down first."""
    motions = list_carried(action.effects)
    move = motions[0] if len(motions) == 1 else None
    if move is None or move.stock or may_still_act(state, action):
        return ""
    if place == move.source:
        return "not_done"
    return "done" if place == move.target and not is_read_later(state, action) else ""


def settle(state: LabState, action: Action, choice: str, by: str, result: Any = None) -> Iterator[Event]:
    """The events that follow from an answer about an unknown action."""
    if choice == "done" and result is None and action.looks:
        result = action.result
    done: EffectsDone = {"done": "all", "not_done": "none"}.get(choice, "partial")  # type: ignore[assignment]
    yield make_from(ActionReconciled, action, action=action.id, effects=done, by=by, result=result)
    if choice == "done":
        yield from list_effect_events(state, action, "all", "", result, looked=True)
        yield from record_barcodes(state, action, result, by)
        return
    for effect in action.effects:
        match effect:
            case Move() if choice == "not_done":
                yield _find_at(state, effect, effect.source, action.run, by, action.id)
            case Move() if choice == "gone" and effect.labware in state.bench.labware:
                why = f"taken away ({by})"
                yield from remove_labware(state.bench, effect.labware, action.run, GONE, why, action.id)
            case Take() if choice == "gone":
                yield from _take_away(state, action.run, effect, by)
            case Consumes() if choice == "gone":
                yield from record_usage(state, action, effect)
            case _:
                pass


def list_effect_events(
    state: LabState, action: Action, done: EffectsDone, why: str, result: Any = None, *, looked: bool = False
) -> Iterator[Event]:
    """The effects of an ended action on the bench, as events. Each event is computed from the state after the
    ones before. Decisions of the device, such as a slot, are read from its result. The report of a person who
    has ``looked`` overrides earlier observations; the report of a device does not."""
    if not action.effects:
        return
    if done == "none":
        yield from put_back_in_place(state, action)
        return
    seen = {} if looked else find_carried_off(state, action)
    # The lots of a liquid are read before the liquid is used up.
    for effect in sorted(action.effects, key=lambda effect: not isinstance(effect, Transfers)):
        match effect:
            case Move() if effect.labware in seen:
                pass
            case Move() if done == "all":
                yield from _move(state, action, effect)
                yield from _turn(state, action, effect)
            case Move():
                yield mark_uncertain(action, effect, why)
            case Take() if done == "all":
                owner = run_owner(action.run) if action.run in state.runs.active else SHARED
                yield from take_from_stack(state, effect, owner, action.run, action.id)
            case Sets(of="module"):
                value = resolve_value(effect.value, result) if done == "all" else None
                yield VariableSet(action.module, effect.variable, value, action.run)
            case Sets() if effect.labware in state.bench.labware:
                value = resolve_value(effect.value, result) if done == "all" else None
                yield LabwareChanged(effect.labware, action.run, effect.variable, value, action.id)
            case Claims() if action.run in state.runs.active:
                value = effect.value if done == "all" else None
                yield SetpointClaimed(action.module, effect.setpoint, value, action.run)
            case Releases() if done == "all":
                yield SetpointReleased(action.module, effect.setpoint, action.run)
            case Transfers() | Draws() if effect.labware:
                yield from _list_liquid_events(state, action, effect, certain=done == "all")
            case Consumes():
                # The amount that a failed action has used is not known. The safe assumption is all of it.
                yield from record_usage(state, action, effect)
            case Replaces() if done == "all":
                yield from _replace_pack(state, effect)
            case _:
                pass
    lost = tuple(e for e in list_carried(action.effects) if e.labware not in seen)
    if done != "all" and lost:
        yield _ask_where(state, action, lost, why)


def record_usage(state: LabState, action: Action, effect: Consumes) -> list[Event]:
    """The amounts that an action used, one event for each lot."""
    if not effect.amount:
        return []
    parts = list_charges(state.resources, action.module, effect.resource, float(effect.amount))
    return [
        ResourceConsumed(action.module, effect.resource, amount, action.run, action.id, lot)
        for lot, amount in parts
    ]


def _replace_pack(state: LabState, effect: Replaces) -> list[Event]:
    """The events of a new full pack; none if the module's capacity was never declared."""
    module = ModuleName(effect.module)
    level = state.resources.find(module, effect.resource)
    if level is None:
        return []
    put_in = (level.capacity, effect.lot, effect.expires)
    return [ResourceReplenished(module, effect.resource, *put_in, instead=True)]


def _list_liquid_events(
    state: LabState, action: Action, effect: Transfers | Draws, *, certain: bool
) -> list[Event]:
    """The liquid that a pipette put into wells or drew from them; nothing if the effect has no lists of wells
    and volumes."""
    try:
        doses = [(well, volume) for well, volume in list_doses(effect) if volume]
    except ValueError:
        return []  # such a request is refused before it is sent; an older LabOS did not check this
    if not doses or effect.labware not in state.bench.labware:
        return []
    names, amounts = zip(*doses, strict=True)
    about = (effect.labware, action.run, action.module)
    if isinstance(effect, Draws):
        return [LiquidDrawn(*about, names, amounts, certain, action.id)]
    charges = []
    if effect.resource:
        charges = list_charges(state.resources, action.module, effect.resource, sum(amounts))
    lots = tuple(lot for lot, _ in charges if lot)
    return [LiquidTransferred(*about, effect.liquid, names, amounts, lots, certain, action.id)]


def find_carried_off(state: LabState, action: Action) -> dict[LabwareId, StationName]:
    """The places at which a person has seen labware of a motion after its outcome became unknown, if these
    are not places of the motion. This observation is later than the device's report."""
    own = {GONE, name_hand(action.module), *list_places(action.effects)}
    items = [state.bench.labware[e.labware] for e in list_moved(action.effects)]
    displaced = state.shorter.displaced  # a later action may have carried it further
    return {item.id: item.station for item in items if item.station not in own or item.id in displaced}


def _move(state: LabState, action: Action, effect: Move) -> list[Event]:
    if state.bench.stations[effect.target].spec.kind == "waste":
        return remove_labware(state.bench, effect.labware, action.run, effect.target, "discarded", action.id)
    labware = state.bench.labware[effect.labware]
    if labware.maybe:
        return [LabwareObserved(effect.labware, action.run, effect.target, local(action.module))]
    plate = effect.plate if effect.lid == "on" else LabwareId("")
    source = labware.station or effect.source
    return [LabwareMoved(effect.labware, action.run, source, effect.target, action.id, plate)]


def _find_at(
    state: LabState, effect: Move, place: StationName, run: str, by: str, action: str = ""
) -> LabwareObserved | LabwareMoved:
    """Labware of a motion is at its source or its target. A lid that was seen off its plate meanwhile lies on
    it again."""
    item = state.bench.labware[effect.labware]
    plate = effect.plate if place == effect.plate_at else LabwareId("")
    if plate and item.on != plate:
        return LabwareMoved(item.id, run, item.station or place, place, action, plate)
    return LabwareObserved(item.id, run, place, by)


def _turn(state: LabState, action: Action, effect: Move) -> list[Event]:
    if effect.lid or state.bench.stations[effect.target].spec.kind == "waste":
        return []
    labware = state.bench.labware[effect.labware]
    way = compute_a1_after(state.bench, effect, labware)
    if way == (labware.variables.get("a1") or 0):
        return []
    return [LabwareChanged(labware.id, action.run, "a1", way, action.id)]


def take_from_stack(
    state: LabState, effect: Take, owner: Owner, run: str = "", action: str = ""
) -> Iterator[Event]:
    """The topmost item of a stack becomes labware with an id, together with its lid, if it has one."""
    item, lot = find_topmost(state, effect)
    kind, lid = split_item(item)
    plate = LabwarePlaced(effect.labware, run, kind, effect.target, owner, effect.stack, action, lot)
    return add_arrival(state.bench, plate, lid)


def put_back_in_place(state: LabState, action: Action) -> list[Event]:
    return [
        LabwareObserved(effect.labware, action.run, effect.source, local(action.module))
        for effect in list_moved(action.effects)
        if _is_in_doubt(state, effect)
    ]


def _is_in_doubt(state: LabState, effect: Move) -> bool:
    """Whether labware is uncertain because of this motion."""
    return bool(state.bench.labware[effect.labware].maybe) and effect.labware not in state.shorter.displaced


def find_topmost(state: LabState, effect: Take) -> tuple[str, str]:
    """The type and the lot of the item that is taken off a stack."""
    stack = state.bench.stations[effect.stack]
    return stack.stock[-1], stack.lots[-1]


def _take_away(state: LabState, run: str, effect: Take, by: str) -> list[Event]:
    """A person took away an item that had come off a stack. It gets its id at the stack, because other
    labware may stand at its target by now."""
    item, lot = find_topmost(state, effect)
    return [
        LabwarePlaced(effect.labware, run, split_item(item)[0], effect.stack, NOBODY, effect.stack, lot=lot),
        LabwareRemoved(effect.labware, run, GONE, f"taken away ({by})"),
    ]


def _ask_where(
    state: LabState, action: Action, motions: tuple[Move | Take, ...], why: str
) -> InterventionRequested:
    """A motion failed half-way: a person has to report where the labware is."""
    topic = LostLabware(run=action.run, module=action.module, action=action.id, motions=motions)
    return state.interventions.ask(
        topic, f"{why.rstrip('.')}. Where is {', '.join(e.labware for e in motions)} now?"
    )


def settle_found(state: LabState, motions: tuple[AnyEffect, ...], choice: str, by: str) -> Iterator[Event]:
    """The events that follow when a person reports where lost labware is."""
    for effect in motions:
        match effect, choice:
            case Move(), _ if effect.labware not in state.bench.labware:
                pass  # it has left the bench since the question was asked
            case Move(), "gone":
                why = f"taken away ({by})"
                yield from remove_labware(state.bench, effect.labware, "", GONE, why)
            case Move(), _:
                place = effect.source if choice == "source" else effect.target
                if state.bench.stations[place].spec.kind == "waste":
                    yield from remove_labware(state.bench, effect.labware, "", place, f"discarded ({by})")
                else:
                    yield _find_at(state, effect, place, "", by)
            case Take(), "gone":
                yield from _take_away(state, "", effect, by)
            case Take(), "target":
                yield from take_from_stack(state, effect, SHARED)
            case _:
                pass
