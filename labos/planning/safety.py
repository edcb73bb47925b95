"""Safety: no start may take away anybody's way to the end.

``reachable_ends`` finds the actors that can still reach their declared end, one after the other,
with everybody else standing where they stand. A start is safe if afterwards nobody is missing
from that set who was in it before. The search is greedy (some actor who can finish alone, then
the next), and where greed loses somebody, a bounded search of interleavings looks for an order
that does not. What was found is kept as a *witness*: its next motion is always allowed, so there
is always something that may move.

Actors are the runs inside the cell, each followed by its experiment's closing workflow, and
experiments that have parked labware between runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from labos.core.bench import Bench, Labware
from labos.core.effects import Move, Take
from labos.core.ids import (
    SHARED,
    ActionId,
    ExperimentId,
    ModuleName,
    Owner,
    RunId,
    StationName,
    experiment_owner,
    run_owner,
    user_owner,
)
from labos.core.runs import DONE, IN_FLIGHT, UNKNOWN, RunState
from labos.core.state import LabState
from labos.planning.paths import Motion, Path, path_of

SEARCH_LIMIT = 400
"""Interleavings looked at before an order is given up."""

CLOSING = -1
"""The step number of a closing workflow's motions behind a run."""

OTHERS = "others"
"""Holder of what belongs to no actor."""


class Actor(msgspec.Struct):
    """Somebody with labware and a way to go. ``stuck``: cannot reach its end whatever the others
    do (paused, needs a dead module, has uncertain labware)."""

    name: str
    owners: tuple[Owner, ...]
    motions: tuple[Motion, ...]
    own: dict[StationName, int]
    inputs: dict[StationName, int]
    stuck: bool = False


class Floor(msgspec.Struct):
    """How full the stations are, how much the stacks hold, who claims which deck."""

    count: dict[StationName, int]
    capacity: dict[StationName, int]
    stock: dict[StationName, int]
    claims: dict[StationName, str]
    claimed: dict[str, dict[str, int]]
    endless: set[StationName]


class Safety:
    """Judges starts in one state after the other; keeps plans' paths between calls."""

    def __init__(self) -> None:
        self._paths: dict[str, Path] = {}
        self.searches = 0
        self.interleavings = 0

    def path(self, state: LabState, plan: str) -> Path:
        """The motions of a plan that the state knows."""
        found = self._paths.get(plan)
        if found is None:
            if len(self._paths) > 4096:
                self._paths = {name: path for name, path in self._paths.items() if name in state.runs.plans}
            found = self._paths[plan] = path_of(state.runs.plans[plan].plan)
        return found

    def moves_anything(self, state: LabState, run: RunState, step: int) -> bool:
        return any(motion.step == step for motion in self.path(state, run.plan).motions)

    def traps(self, state: LabState, run: RunState, step: int) -> list[str]:
        """Whose way to the end the start of a step would take away; empty if it is safe. A new
        run counts itself: it is let in only if it can come out."""
        cell = state.runs.plan_of(run).workcell
        actors = self.actors(state, cell)
        floor = lay_out(state, cell, actors)
        before = self.ends(floor, actors, keep=())
        name = actor_name(run)
        mover = next((actor for actor in actors if actor.name == name), None)
        if mover is None or (run.status == "queued" and mover.name != str(run.id)):
            actors = self._with_newcomer(state, run, actors, mover)
            floor = lay_out(state, cell, actors)
            mover = next(actor for actor in actors if actor.name == name)
            before = {*before, name}
        for motion in [m for m in mover.motions if m.step == step]:
            if not may_move(floor, mover, motion):
                return [name]
            move(floor, mover, motion)
        mover.motions = tuple(m for m in mover.motions if m.step != step)
        after = self.ends(floor, actors, keep=before)
        return sorted(before - after)

    def _with_newcomer(
        self, state: LabState, run: RunState, actors: list[Actor], mover: Actor | None
    ) -> list[Actor]:
        others = [actor for actor in actors if actor is not mover]
        return [*others, self.actor(state, run, tail=True)]

    def actors(self, state: LabState, cell: str) -> list[Actor]:
        """Everybody who has something on the bench of a workcell or is on the way to it."""
        actors: list[Actor] = []
        tailed: set[ExperimentId] = set()
        for run in state.runs.active.values():
            if state.runs.plans[run.plan].plan.workcell == cell:
                tail = bool(run.experiment) and run.experiment not in tailed
                tailed.add(run.experiment)
                actors.append(self.actor(state, run, tail=tail))
        for experiment in state.campaigns.experiments.values():
            owner = experiment_owner(experiment.id)
            if experiment.id in tailed or not state.bench.owned(owner) or not experiment.closing:
                continue
            path = self.path(state, experiment.closing)
            if state.runs.plans[experiment.closing].plan.workcell == cell:
                own, lost = standing(state, (owner,))
                dead = any(down(state, module) for _, module in path.modules)
                actors.append(Actor(owner, (owner,), path.motions, own, {}, stuck=lost or dead))
        return actors

    def actor(self, state: LabState, run: RunState, *, tail: bool) -> Actor:
        """A run as an actor: what is left of its way, its experiment's closing way behind it."""
        path = self.path(state, run.plan)
        left = [
            index for index, _ in path.modules if not run.steps or run.steps[index] not in (DONE, IN_FLIGHT)
        ]
        motions = [motion for motion in path.motions if motion.step in left]
        dead = any(down(state, module) for index, module in path.modules if index in left)
        owners = [run_owner(run.id)]
        experiment = state.campaigns.experiments.get(run.experiment)
        if experiment is not None and tail:
            owners.append(experiment_owner(experiment.id))
            if experiment.closing and not run.closing:
                closing = self.path(state, experiment.closing)
                motions += [msgspec.structs.replace(motion, step=CLOSING) for motion in closing.motions]
        own, lost = standing(state, owners)
        inputs, _ = standing(state, (user_owner(run.user), SHARED))
        stuck = lost or dead or run.paused
        return Actor(actor_name(run), tuple(owners), tuple(motions), own, inputs, stuck=stuck)

    def ends(self, floor: Floor, actors: Sequence[Actor], keep: Iterable[str]) -> set[str]:
        """The actors that reach their end in one order; tries harder for those in ``keep``."""
        self.searches += 1
        found = greedy(copy(floor), [a for a in actors if not a.stuck])
        missing = set(keep) - found
        if missing and not any(actor.stuck and actor.name in missing for actor in actors):
            self.interleavings += 1
            wanted = set(keep)
            movers = [a for a in actors if a.name in wanted and not a.stuck]
            if interleave(floor, movers, SEARCH_LIMIT):
                return found | wanted
        return found


def actor_name(run: RunState) -> str:
    return str(run.id)


def down(state: LabState, module: ModuleName) -> bool:
    """Whether a module needs a person or its device to come back before anybody can use it."""
    known = state.modules.by_name.get(module)
    return known is None or bool(known.out_of_service) or known.status in ("GONE", "ERROR")


def standing(state: LabState, owners: Iterable[Owner]) -> tuple[dict[StationName, int], bool]:
    """Where the owners' labware will stand once what is in flight has ended, and whether some of
    it is lost."""
    places: dict[StationName, int] = {}
    lost = False
    for owner in owners:
        for item in state.bench.owned(owner):
            lost = lost or bool(item.maybe)
            place = destination(state.bench, item)
            if place:
                places[place] = places.get(place, 0) + 1
        if owner.startswith("run:"):
            for target in arriving(state, RunId(owner[4:])):
                places[target] = places.get(target, 0) + 1
    return places, lost


def destination(bench: Bench, item: Labware) -> StationName:
    """Where labware will stand when the action that carries it has ended; empty if nowhere."""
    place = item.station
    for effect in bench.reserved.get(ActionId(item.moving), ()) if item.moving else ():
        if isinstance(effect, Move) and effect.labware == item.id:
            place = effect.target
    return StationName("") if place and bench.stations[place].spec.kind == "waste" else place


def arriving(state: LabState, run: RunId) -> list[StationName]:
    """Stations at which labware will appear that a run is taking off a stack right now."""
    active = state.runs.active.get(run)
    if active is None or not (IN_FLIGHT in active.steps or UNKNOWN in active.steps):
        return []
    return [
        effect.target
        for action in state.actions.open.values()
        if action.run == run
        for effect in action.effects
        if isinstance(effect, Take)
    ]


def lay_out(state: LabState, cell: str, actors: Sequence[Actor]) -> Floor:
    """The floor of a workcell once everything in flight has ended."""
    bench = state.bench
    prefix = f"{cell}/"
    floor = Floor({}, {}, {}, {}, {}, set())
    for name, station in bench.stations.items():
        if not name.startswith(prefix):
            continue
        spec = station.spec
        floor.capacity[name] = spec.capacity
        floor.count[name] = len(station.stock) + bench.haunted.get(name, 0)
        if spec.kind == "stack":
            floor.stock[name] = len(station.stock)
        elif spec.kind == "waste":
            floor.endless.add(name)
            floor.count[name] = station.level + station.expected
        if spec.claim:
            floor.claims[name] = spec.claim
    holders = {owner: actor.name for actor in actors for owner in actor.owners}
    for item in bench.labware.values():
        place = destination(bench, item)
        if place.startswith(prefix):
            floor.count[place] = floor.count.get(place, 0) + 1
            _claim(floor, place, holders.get(item.owner, OTHERS), 1)
    for action in state.actions.open.values():
        for effect in action.effects:
            if isinstance(effect, Take) and effect.stack in floor.stock:
                floor.stock[effect.stack] -= 1
                floor.count[effect.stack] -= 1
                floor.count[effect.target] += 1
                _claim(floor, effect.target, str(action.run), 1)
    return floor


def copy(floor: Floor) -> Floor:
    return Floor(
        dict(floor.count),
        floor.capacity,
        dict(floor.stock),
        floor.claims,
        {claim: dict(holders) for claim, holders in floor.claimed.items()},
        floor.endless,
    )


def may_move(floor: Floor, actor: Actor, motion: Motion) -> bool:
    """Whether the motion is possible on this floor."""
    target = motion.target
    if motion.new:
        if floor.stock.get(motion.source, 0) <= 0:
            return False
    elif not actor.own.get(motion.source) and not actor.inputs.get(motion.source):
        return motion.step == CLOSING  # nothing to clear away there
    if floor.count.get(target, 0) >= floor.capacity.get(target, 0):
        return False
    if motion.via and floor.count.get(motion.via, 0) > 0:
        return False
    claim = floor.claims.get(target)
    return not claim or not any(n for who, n in floor.claimed.get(claim, {}).items() if who != actor.name)


def move(floor: Floor, actor: Actor, motion: Motion) -> None:
    """Carry a motion out on the floor."""
    source, target = motion.source, motion.target
    if motion.new:
        floor.stock[source] -= 1
        floor.count[source] -= 1
    elif actor.own.get(source):
        actor.own[source] -= 1
        floor.count[source] -= 1
        _claim(floor, source, actor.name, -1)
    elif actor.inputs.get(source):
        actor.inputs[source] -= 1
        floor.count[source] -= 1
        _claim(floor, source, OTHERS, -1)
    else:
        return
    floor.count[target] = floor.count.get(target, 0) + 1
    if target not in floor.endless:
        actor.own[target] = actor.own.get(target, 0) + 1
        _claim(floor, target, actor.name, 1)


def _claim(floor: Floor, station: StationName, who: str, change: int) -> None:
    claim = floor.claims.get(station)
    if claim:
        holders = floor.claimed.setdefault(claim, {})
        holders[who] = holders.get(who, 0) + change


def greedy(floor: Floor, actors: Sequence[Actor]) -> set[str]:
    """Let one actor after the other go to its end, as long as one can; changes the floor."""
    finished: set[str] = set()
    waiting = list(actors)
    progress = True
    while waiting and progress:
        progress = False
        for actor in list(waiting):
            trial, walker = copy(floor), _fresh(actor)
            if walk(trial, walker):
                _become(floor, trial)
                finished.add(actor.name)
                waiting.remove(actor)
                progress = True
    return finished


def walk(floor: Floor, actor: Actor) -> bool:
    """Carry out all of an actor's motions; False if one is not possible."""
    for motion in actor.motions:
        if not may_move(floor, actor, motion):
            return False
        move(floor, actor, motion)
    return True


def interleave(floor: Floor, actors: Sequence[Actor], limit: int) -> bool:
    """Whether some interleaving of single motions brings every actor to its end; looks at no
    more than ``limit`` of them."""
    seen: set[tuple[int, ...]] = set()
    stack = [(copy(floor), [_fresh(actor) for actor in actors], tuple(0 for _ in actors))]
    while stack and limit:
        limit -= 1
        ground, walkers, done = stack.pop()
        rest = [_remaining(walker, position) for walker, position in zip(walkers, done, strict=True)]
        if greedy(copy(ground), rest) >= {actor.name for actor in actors}:
            return True
        for index, walker in enumerate(walkers):
            position = done[index]
            if position >= len(walker.motions):
                continue
            step = (*done[:index], position + 1, *done[index + 1 :])
            motion = walker.motions[position]
            if step in seen or not may_move(ground, walker, motion):
                continue
            seen.add(step)
            next_ground, next_walkers = copy(ground), [_fresh(w) for w in walkers]
            move(next_ground, next_walkers[index], motion)
            stack.append((next_ground, next_walkers, step))
    return False


def _remaining(actor: Actor, done: int) -> Actor:
    fresh = _fresh(actor)
    fresh.motions = actor.motions[done:]
    return fresh


def _fresh(actor: Actor) -> Actor:
    own, inputs = dict(actor.own), dict(actor.inputs)
    return Actor(actor.name, actor.owners, actor.motions, own, inputs, actor.stuck)


def _become(floor: Floor, other: Floor) -> None:
    floor.count, floor.stock, floor.claimed = other.count, other.stock, other.claimed
