"""Safety: no start may take away anybody's way to the end.

A *witness* is one order of motions in which every actor that can still reach its end does so,
with everybody else standing where they stand. The witness's next motion is always allowed, so
there is always something that may move. Any other start is allowed only if a new witness is
found that brings the same actors to their ends: greedily (some actor who can finish alone, then
the next), and for those whom greed leaves behind by a bounded search of interleavings.

A start has to be safe in two views. In one, actors that are stuck (a dead module, a person is
asked, paused) are obstacles that stay where they are: nobody waits for them. In the other,
hopeful one nobody is stuck: so nobody's way is blocked for good while they were out.

Actors are the runs inside the cell, each followed by its experiment's closing workflow, and
experiments that have parked labware between runs. Everybody's labware beside is an obstacle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import msgspec

from labos.core.binding import unpromised
from labos.core.decide.windows import FAILED_STEP, questions_of
from labos.core.ids import SHARED, ExperimentId, Owner, experiment_owner, run_owner, user_owner
from labos.core.runs import IN_FLIGHT, SETTLED, UNKNOWN, RunState, at_first
from labos.core.state import LabState
from labos.core.zones import barred, zones_of
from labos.planning.floor import (
    CLOSING,
    Actor,
    Branch,
    Floor,
    down,
    lay_out,
    may_move,
    move,
    standing,
)
from labos.planning.forks import FORKED, futures, motions_of
from labos.planning.paths import Motion, Path, path_of
from labos.planning.witness import Trail, Witness, copy, fresh, greedy, holds, in_order, interleave, replay

SEARCH_LIMIT = 200
"""Interleavings looked at before an order is given up."""


class Known(msgspec.Struct, frozen=True):
    """What was found last in a workcell, and for which stuck actors it holds."""

    stuck: frozenset[str]
    witness: Witness
    ends: frozenset[str]


class Safety:
    """Judges starts in one state after the other. ``searches`` and ``interleavings`` count."""

    def __init__(self, limit: int = SEARCH_LIMIT) -> None:
        self._paths: dict[str, Path] = {}
        self._known: dict[tuple[str, bool], Known] = {}
        self._limit = limit
        self.searches = 0
        self.interleavings = 0

    def forget(self) -> None:
        """The bench is another than it was."""
        self._paths.clear()
        self._known.clear()

    def path(self, state: LabState, plan: str) -> Path:
        """The motions of a plan that the state knows."""
        found = self._paths.get(plan)
        if found is None:
            if len(self._paths) > 4096:
                self._paths = {name: path for name, path in self._paths.items() if name in state.runs.plans}
            claims = {name: s.spec.claim for name, s in state.bench.stations.items() if s.spec.claim}
            rests = {name: m.spec.rest for name, m in state.modules.by_name.items() if m.spec.rest}
            found = self._paths[plan] = path_of(state.runs.plans[plan].plan, claims, rests)
        return found

    def changes_anything(self, state: LabState, run: RunState, step: int) -> bool:
        """Whether labware stands elsewhere after a step, or somebody holds something else."""
        return any(
            motion.target or motion.grabs or motion.frees
            for motion in motions_of(self.path(state, run.plan), step)
        )

    def traps(self, state: LabState, run: RunState, step: int, *, only_asking: bool = False) -> list[str]:
        """Whose way to the end the start of a step would take away; empty if it is safe. A new
        run counts itself: it is let in only if it can come out. Unless the caller is only
        asking, a start that is found safe is taken as done."""
        cell = state.runs.plan_of(run).workcell
        actors = self.actors(state, cell)
        views = [True, False] if any(actor.stuck for actor in actors) else [True]
        found: dict[tuple[str, bool], Known] = {}
        for hopeful in views:
            here = [fresh(actor) for actor in actors]
            for actor in here:
                actor.stuck = actor.stuck and not hopeful
            ground = lay_out(state, cell, here, hopeful=hopeful)
            after = self._after(state, run, step, ground, here, (cell, hopeful))
            if isinstance(after, list):
                return after
            found[cell, hopeful] = after
        if not only_asking:
            self._known.update(found)
        return []

    def _after(
        self,
        state: LabState,
        run: RunState,
        step: int,
        ground: Floor,
        actors: list[Actor],
        view: tuple[str, bool],
    ) -> Known | list[str]:
        """What holds after the start, seen one way, or whom it would trap."""
        known = self._before(ground, actors, view)
        name = str(run.id)
        if known.witness and known.witness[0] == (name, step):
            return msgspec.structs.replace(known, witness=known.witness[1:])
        keep = set(known.ends)
        floor = ground
        if run.status == "queued":
            actors = self._with_newcomer(state, run, actors)
            keep = {actor for actor in keep if actor != experiment_owner(run.experiment)} | {name}
            if any(state.bench.owned(owner) for owner in actors[-1].owners):
                floor = lay_out(state, view[0], actors, hopeful=view[1])  # others' labware is its own now
        mover = next(actor for actor in actors if actor.name == name)
        path = self.path(state, run.plan)
        for motion in motions_of(path, step) if path.ways else [m for m in mover.motions if m.step == step]:
            if not may_move(floor, mover, motion):
                return [name]
            move(floor, mover, motion)
        if path.ways:
            plan = state.runs.plan_of(run)
            steps = list(run.steps or at_first(plan))
            steps[step] = IN_FLIGHT
            tail = self._tail(state, run, mover.owners)
            mover.motions, mover.forks = futures(path, plan, run, steps, tail)
            if known.witness and known.witness[0] == (name, FORKED):
                here = [fresh(actor) for actor in actors]
                order = replay(copy(floor), here, known.witness)
                if order is not None:
                    return Known(_stuck(actors), order, frozenset(keep))
        else:
            mover.motions = tuple(m for m in mover.motions if m.step != step)
        witness, ends = self.find(floor, actors, keep)
        lost = sorted(keep - ends)
        return lost or Known(_stuck(actors), witness, frozenset(ends))

    def _before(self, ground: Floor, actors: list[Actor], view: tuple[str, bool]) -> Known:
        """What holds before the start: what was found last, or what is found now when somebody
        has got stuck or free since, or has a motion to do again."""
        names = {actor.name for actor in actors}
        stuck = _stuck(actors)
        known = self._known.get(view)
        if known is not None and known.stuck == stuck and known.ends >= names - stuck:
            # Steps that changed nothing were done without asking.
            left = {(actor.name, motion.step) for actor in actors for motion in actor.motions}
            left |= {(actor.name, FORKED) for actor in actors}
            known = msgspec.structs.replace(known, witness=tuple(w for w in known.witness if w in left))
            ahead = Counter(name for name, _ in known.witness)
            complete = all(ahead[a.name] == a.length for a in actors if a.name not in stuck)
            if complete and holds(copy(ground), [fresh(actor) for actor in actors], known.witness):
                return msgspec.structs.replace(known, ends=known.ends & names)
            if any(step == FORKED for _, step in known.witness):  # somebody's branch is decided
                order = replay(copy(ground), [fresh(a) for a in actors if not a.stuck], known.witness)
                if order is not None:
                    known = self._known[view] = Known(stuck, order, known.ends & names)
                    return known
        witness, ends = self.find(copy(ground), [fresh(actor) for actor in actors], names - stuck)
        known = self._known[view] = Known(stuck, witness, frozenset(ends))
        return known

    def _with_newcomer(self, state: LabState, run: RunState, actors: list[Actor]) -> list[Actor]:
        """The actors with a run that is not inside yet; it takes over its experiment's closing."""
        closing = experiment_owner(run.experiment)
        tail = all(run.experiment != other.experiment for other in state.runs.active.values())
        others = [actor for actor in actors if not (tail and actor.name == closing)]
        return [*others, self.actor(state, run, tail=tail)]

    # -- actors ------------------------------------------------------------------------------

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
            if experiment.id in tailed or not experiment.closing or not state.bench.owned(owner):
                continue
            path = self.path(state, experiment.closing)
            if state.runs.plans[experiment.closing].plan.workcell == cell:
                own, lost = standing(state, (owner,))
                dead = any(down(state, module) for _, module in path.modules)
                actors.append(Actor(owner, (owner,), _closing(path), own, stuck=lost or dead))
        return actors

    def actor(self, state: LabState, run: RunState, *, tail: bool) -> Actor:
        """A run as an actor: what is left of its way, its experiment's closing way behind it."""
        path = self.path(state, run.plan)
        steps = state.runs.plan_of(run).steps
        states = run.steps or at_first(state.runs.plan_of(run))
        over = {i for i, status in enumerate(states) if status in (*SETTLED, IN_FLIGHT)}
        done = {i for i, status in enumerate(states) if status in SETTLED}
        left = [(index, module) for index, module in path.modules if index not in done]
        recovered = {module for index, module in left if steps[index].recovers}
        dead = any(down(state, module, recovered=module in recovered) for _, module in left)
        dead = dead or self._barred(state, run, [index for index, _ in left])
        owners = [run_owner(run.id)]
        experiment = state.campaigns.experiments.get(run.experiment)
        if experiment is not None and tail:
            owners.append(experiment_owner(experiment.id))
        behind = self._tail(state, run, owners)
        forks: tuple[Branch, ...] = ()
        motions = (*(motion for motion in path.motions if motion.step not in over), *behind)
        if path.ways:
            motions, forks = futures(path, state.runs.plan_of(run), run, states, behind)
        own, lost = standing(state, owners)
        inputs = (user_owner(run.user), SHARED)
        dry = any(
            index not in over and (unpromised(state, module, resource) or 0.0) < amount
            for index, module, resource, amount in state.runs.plans[run.plan].uses_up
            if state.resources.of(module, resource) is not None
        )
        asked = bool(questions_of(state, run.id, FAILED_STEP))
        stuck = lost or dead or dry or run.paused or asked or UNKNOWN in run.steps
        return Actor(str(run.id), tuple(owners), motions, own, inputs, stuck=stuck, forks=forks)

    def _tail(self, state: LabState, run: RunState, owners: Sequence[Owner]) -> tuple[Motion, ...]:
        """The closing workflow behind a run that takes its experiment's labware along."""
        experiment = state.campaigns.experiments.get(run.experiment)
        if experiment is None or experiment_owner(experiment.id) not in owners:
            return ()
        clears = bool(experiment.closing) and not run.closing
        return _closing(self.path(state, experiment.closing)) if clears else ()

    @staticmethod
    def _barred(state: LabState, run: RunState, left: Sequence[int]) -> bool:
        """Whether a run has to pass a zone in which another arm stands still."""
        zones = barred(state)
        steps = state.runs.plan_of(run).steps
        return bool(zones) and any(
            zones.get(zone, step.module) != step.module
            for step in map(steps.__getitem__, left)
            if step.exclusive and not step.recovers
            for zone in zones_of(state, step.module, step.effects)
        )

    # -- searching ---------------------------------------------------------------------------

    def find(self, floor: Floor, actors: Sequence[Actor], keep: set[str]) -> tuple[Witness, set[str]]:
        """A witness and the actors it brings to their ends; tries harder if somebody of ``keep``
        is missing. Changes floor and actors."""
        self.searches += 1
        waiting = [actor for actor in actors if not actor.stuck]
        ground, all_over = copy(floor), [fresh(actor) for actor in waiting if actor.name in keep]
        trail: Trail = []
        waiting = greedy(floor, waiting, trail)
        order = in_order(trail)
        ends = {actor.name for actor in actors if not actor.stuck} - {actor.name for actor in waiting}
        missing = [actor for actor in waiting if actor.name in keep]
        if missing and len(missing) == len(keep - ends):
            self.interleavings += 1
            found = interleave(floor, missing, self._limit)
            if found is not None:
                order += found
                ends |= {actor.name for actor in missing}
            elif len(all_over) > len(missing):
                # Whoever went first may have come to rest in the others' way.
                found = interleave(ground, all_over, self._limit)
                if found is not None:
                    order, ends = found, {actor.name for actor in all_over}
        return tuple(order), ends


def _stuck(actors: Sequence[Actor]) -> frozenset[str]:
    return frozenset(actor.name for actor in actors if actor.stuck)


def _closing(path: Path) -> tuple[Motion, ...]:
    return tuple(msgspec.structs.replace(motion, step=CLOSING) for motion in path.motions)
