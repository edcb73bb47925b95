"""The obstacle of a run that deadlock avoidance does not let start: a cause in words.

Deadlock avoidance reports only that it found no way out. Here all other actors that can reach their ends do
so first, on a floor. Then the run makes its motions. The first motion that is not possible is the cause.
"""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.algebra import check_carrying, check_rooms
from labos.core.binding import is_same
from labos.core.ids import ModuleName, StationName, local
from labos.core.reasons import NoWayOut
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.floor import Actor, Floor
from labos.planning.held import door_key, find_kept_module, hold_key
from labos.planning.layout import lay_out
from labos.planning.moves import Mover, find_usable_place, may_move, move
from labos.planning.paths import Motion
from labos.planning.safety import Safety, View, view_actor
from labos.planning.witness import copy_actor, finish_one_by_one


def explain_wait(safety: Safety, state: LabState, run: RunState, wait: Wait) -> str:
    """The reason of a wait, with the cause if deadlock avoidance found no way out."""
    text = wait.reason.sentence
    cause = find_obstacle(safety, state, run) if isinstance(wait.reason, NoWayOut) else ""
    return f"{text}: {cause}" if cause else text


def find_obstacle(safety: Safety, state: LabState, run: RunState) -> str:
    """The first obstacle of a run, in words. Empty if no single motion is impossible in any view."""
    plan = state.runs.plan_of(run)
    actors = safety.list_actors(state, plan.workcell)
    mover = next((actor for actor in actors if actor.name == run.id), None)
    if mover is None:
        *actors, mover = safety.with_newcomer(state, run, actors)
    others = [actor for actor in actors if actor is not mover]
    cell = plan.workcell
    for view in (View(cell), View(cell, hopeful=True), View(cell, hopeful=True, closing=True)):
        found = _find_obstacle(state, run, mover, others, view)
        if found:
            return found
    return ""


def _find_obstacle(state: LabState, run: RunState, mover: Actor, others: Sequence[Actor], view: View) -> str:
    """The first obstacle of a run in one view, after all other actors that can reach their ends have done so.
    The closing workflow that waits for the run is checked after it. Empty if there is no obstacle."""
    plan = state.runs.plan_of(run)
    others = [view_actor(actor, view) for actor in others]
    mover = view_actor(mover, view)
    floor = lay_out(state, view.cell, [*others, mover], hopeful=view.hopeful)
    gone = [copy_actor(actor) for actor in others if not actor.stuck]
    finish_one_by_one(floor, gone, [])
    closings = [actor for actor in gone if actor.name == mover.home and not actor.done]
    for walker in (copy_actor(mover), *closings):
        for motion in walker.motions:
            if not may_move(floor, walker, motion):
                key = plan.steps[motion.step].key if isinstance(motion.step, int) else "the closing workflow"
                return f"{key!r} {_explain_obstacle(state, floor, walker, motion, gone)}"
            move(floor, walker, motion)
    return ""


def _explain_obstacle(
    state: LabState, floor: Floor, walker: Actor, motion: Motion, others: Sequence[Actor]
) -> str:
    for key, value in motion.wants:
        if not is_same(floor.values.get(key), value):
            return f"needs {local(key)} = {value}, which no step will have set"
    mover = ExplainedMover(floor, walker, state, others)
    if not motion.target:
        full = check_rooms(mover, motion)
        if full is not None:
            return full
        for places in motion.needs:
            if not find_usable_place(floor, walker, places):
                return f"finds nothing that it may use at {' or '.join(map(local, places))}"
        used = [motion.uses] if motion.uses else []
        grabbed = [key for key, _ in motion.grabs]
        used += [find_kept_module(key) for key in grabbed if find_kept_module(key)]
        return f"has to wait: {_describe_holders(state, floor, walker, used, grabbed, others)}"
    return check_carrying(mover, motion) or mover.describe_keeper(motion, [motion.uses])


class ExplainedMover:
    """An actor on a floor: a store (see ``core.algebra``) that says in words what prevents a motion."""

    def __init__(self, floor: Floor, actor: Actor, state: LabState, others: Sequence[Actor]) -> None:
        self.mover = Mover(floor, actor)
        self.floor, self.actor, self.state, self.others = floor, actor, state, others

    def stock(self, what: Motion, stack: StationName) -> str | None:
        if not self.mover.stock(what, stack):
            return None
        if self.floor.stock.get(stack, 0) <= 0:
            return f"takes from the stack {local(stack)}, which is empty by then"
        return self._describe_buried(stack)

    def check_presence(self, what: Motion, place: StationName) -> str | None:
        if not self.mover.check_presence(what, place):
            return None
        owners = [self.floor.pools.get(owner, {}) for owner in self.actor.inputs]
        if not any(places.get(place) for places in (self.actor.own, *owners)):
            return f"finds nothing at {local(place)}"
        return (
            self._describe_buried(place)
            if self.floor.piles.get(place)
            else f"finds too little at {local(place)}"
        )

    def check_hand(self, what: Motion) -> str | None:
        if not self.mover.check_hand(what):
            return None
        return (
            f"needs the hand of {local(what.uses)}, {_describe_occupants(self.state, what.hand, self.others)}"
        )

    def check_entry(self, what: Motion, place: StationName) -> str | None:
        return (
            self.describe_keeper(what, [self.floor.behind[place]])
            if self.mover.check_entry(what, place)
            else None
        )

    def check_room(self, what: Motion, place: StationName) -> str | None:
        if not self.mover.check_room(what, place):
            return None
        where = local(place)
        if place in self.floor.endless:
            return f"needs room in the waste {where}, which is full by then (labos unload {where} --all)"
        return f"needs room at {where}, {_describe_occupants(self.state, place, self.others)}"

    def describe_keeper(self, what: Motion, modules: Sequence[ModuleName]) -> str:
        """A motion in words, and what keeps these modules from it."""
        who = _describe_holders(self.state, self.floor, self.actor, modules, [], self.others)
        return f"goes from {local(what.source)} to {local(what.target)}, but {who}"

    def _describe_buried(self, stack: StationName) -> str:
        top = self.floor.piles[stack][-1].replace(":", " ")
        return f"takes from the stack {local(stack)}, on which something of {top} lies"


def _describe_occupants(state: LabState, place: StationName, others: Sequence[Actor]) -> str:
    """The labware at a place, or the actors whose labware will be there after the others have ended."""
    station = state.bench.stations[place]
    owners = {name: state.bench.labware[name].owner.replace(":", " ") for name in station.labware}
    standing = [f"{name} of {owner or 'nobody'}" for name, owner in owners.items()]
    coming = [actor.name for actor in others if actor.own.get(place) and actor.done]
    if standing:
        return f"where {' and '.join(standing)} {'stands' if len(standing) == 1 else 'stand'}"
    if coming:
        return f"where labware of {' and '.join(coming)} comes to rest"
    return "which is full" if station.count else "which has none"


def _describe_holders(
    state: LabState,
    floor: Floor,
    walker: Actor,
    modules: Sequence[ModuleName],
    keys: Sequence[str],
    others: Sequence[Actor],
) -> str:
    """What keeps modules or setpoints from the walker: actors with a hold or an open door, or labware."""
    wanted = [*keys, *(key(module) for module in modules for key in (hold_key, door_key))]
    who = [name for key in wanted for name in floor.held.get(key, {}) if name != walker.name]
    for place, claim in floor.claims.items():
        if claim in modules:
            who += [f"{name} at {local(place)}" for name in state.bench.stations[place].labware]
            who += [actor.name for actor in others if actor.own.get(place)]
    names = ", ".join(local(module) for module in modules) or "it"
    return f"{names} is held by {' and '.join(dict.fromkeys(who)) or 'others'}"
