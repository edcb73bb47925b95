"""A device reports success, and an observer confirms or contradicts it.

If all observers confirm, the action has succeeded. If labware stands where it stood before, nothing was done.
If labware is not at its target, it is lost: an *operational* failure that only the observer reports. If the
observers cannot decide, the outcome of the action is unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Literal

import msgspec

from labos.core.actions import Action, ActionFailed, ActionStatus, EffectsDone
from labos.core.bench import StationState
from labos.core.decide._base import Decision, Report
from labos.core.decide.actions import FinishAction, finish
from labos.core.decide.lookups import decides_about, find_action
from labos.core.decide.outcomes import list_effect_events, mark_uncertain
from labos.core.decide.steps import doubt
from labos.core.effects import Carrying, list_carried, list_moved
from labos.core.ids import ActionId, StationName, local, workcell_of
from labos.core.labware import GONE, LabwareUncertain, StationObserved
from labos.core.registry import Event
from labos.core.runs import RunStatus
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.watching import list_end_stations

Verdict = Literal["done", "not_done", "lost", "unclear"]

Sights = dict[StationName, StationObserved]
"""What observers saw, by station."""


class VerifyAction(Report, frozen=True):
    """Report the observations at the stations where an action should have had its effect. ``unseen`` says why
    some station could not be observed."""

    action: ActionId
    seen: tuple[StationObserved, ...] = ()
    unseen: str = ""


@decides_about(VerifyAction, find_action)
def verify_action(state: LabState, command: VerifyAction, action: Action) -> Decision:
    if action.status != ActionStatus.REPORTED or is_disturbed(state, action):
        return []
    sights = {seen.station: seen for seen in command.seen if seen.station in action.looks}
    events: list[Event] = [*sights.values()]
    verdicts = [
        _judge_motion(state, action, effect, sights)
        for effect in list_carried(action.effects)
        if {*list_end_stations((effect,))} & {*action.looks}
    ]
    what = _describe_sights(sights.values()) or command.unseen
    why = f"{local(action.module)} reports {action.name!r} as done; {what}"
    if "lost" in verdicts or {"done", "not_done"} <= {*verdicts}:
        return chain(events, _refute(state, action, "unknown", why, sights))
    if "not_done" in verdicts:
        return chain(events, _refute(state, action, "none", why, sights))
    if "unclear" in verdicts:
        why = f"{why}{f'; {command.unseen}' if command.unseen and sights else ''}"
        return [*events, *doubt(state, action, why, _find_whereabouts(state, action, why, sights))]
    end = FinishAction(action.id, action.attempt, True, "all", action.result, ended_ns=action.ended_ns)
    return chain(events, finish(state, action, end))


def is_disturbed(state: LabState, action: Action) -> bool:
    """Whether another action is changing the stations where this one is observed. Then an observation has no
    meaning."""
    return any(
        other.id != action.id
        and other.status in (ActionStatus.REQUESTED, ActionStatus.ACCEPTED)
        and {*list_end_stations(other.effects)} & {*action.looks}
        for other in state.actions.list_in_cell(workcell_of(action.module))
    )


def _judge_motion(state: LabState, action: Action, effect: Carrying, sights: Sights) -> Verdict:
    """The verdict on one motion. A station that did not have to be observed does not count against it."""
    source, target = effect.emptied, effect.filled
    there = _was_seen_at(state, action, effect, target, sights)
    here = _was_seen_at(state, action, effect, source, sights)
    if there is True:
        return "done"
    if here is True and (there is False or target not in action.looks):
        return "not_done"
    if there is False:
        return "lost"
    left = here is False and target not in action.looks
    return "done" if left else "unclear"


def _was_seen_at(
    state: LabState, action: Action, effect: Carrying, place: StationName, sights: Sights
) -> bool | None:
    """Whether the labware of a motion was seen at a place; None if that cannot be decided."""
    seen, station = sights.get(place), state.bench.stations.get(place)
    if seen is None or station is None:
        return None
    if seen.labware:
        if seen.labware == effect.labware:
            return True
        return False if station.spec.capacity == 1 else None
    least, most = _count_others(state, action, effect, station)
    if seen.count is None:
        return True if not most else None
    if seen.count > most:
        return True
    return False if seen.count <= least else None


def _count_others(
    state: LabState, action: Action, effect: Carrying, station: StationState
) -> tuple[int, int]:
    """The number of other pieces at a station, at least and at most. Labware that may be there, and pieces
    that other modules report to have brought or taken, count only for the maximum or the minimum."""
    place, bench = station.spec.name, state.bench
    known = len(station.labware) + len(station.stock)
    known -= effect.labware in station.labware
    known -= effect.stock == place
    least = most = known
    item = bench.labware.get(effect.labware)
    most += bench.uncertain_at.get(place, 0) - bool(item is not None and place in item.maybe)
    for other in state.actions.list_in_cell(workcell_of(action.module)):
        for motion in list_carried(other.effects) if other.id != action.id else ():
            # The labware of a move with an unknown outcome is uncertain already; an item from a stack is not.
            if motion.stock or other.status == ActionStatus.REPORTED:
                least -= motion.emptied == place
                most += motion.filled == place
    return max(least, 0), max(most, 0)


def _refute(state: LabState, action: Action, done: EffectsDone, why: str, sights: Sights) -> Iterator[Event]:
    """The events that follow when an observer saw that the action was not done, or not done correctly."""
    run = state.runs.active.get(action.run)
    maybe = _find_whereabouts(state, action, why, sights)
    if run is not None and done != "none" and run.status != RunStatus.CANCELLING:
        policy = state.runs.plan_of(run).steps[action.step].on_error
        if policy is not None and policy.do == "ask":
            yield from doubt(state, action, why, maybe)
            return
    narrow = {event.labware: event for event in maybe}
    yield make_from(ActionFailed, action, action=action.id, error=why, effects=done, kind="operational")
    for event in list_effect_events(state, action, done, why):
        yield narrow.get(event.labware, event) if isinstance(event, LabwareUncertain) else event


def _find_whereabouts(state: LabState, action: Action, why: str, sights: Sights) -> list[LabwareUncertain]:
    """The possible places of labware that did not arrive as its module reports. These are the places where it
    was seen. If there are none, it may be off the bench, or at any place that was not observed without it."""
    found: list[LabwareUncertain] = []
    for effect in list_moved(action.effects):
        event = mark_uncertain(action, effect, why)
        stands = {place: _was_seen_at(state, action, effect, place, sights) for place in event.places}
        certain = [place for place, is_there in stands.items() if is_there]
        left = certain or [*(place for place in event.places if stands[place] is not False), GONE]
        found.append(msgspec.structs.replace(event, places=tuple(left)))
    return found


def _describe_sights(sights: Iterable[StationObserved]) -> str:
    """The observations, as text for people."""
    texts = []
    for seen in sights:
        what = seen.labware or ("something" if seen.count is None else f"{seen.count or 'nothing'}")
        texts.append(f"{seen.by} saw {what} at {local(seen.station)}")
    return ", ".join(texts)
