"""Deadlock avoidance: after each start, every run that could reach its end still can.

A *witness* is one order of motions in which every actor that can still reach its end does so. All other
labware stays where it is. The next motion of the witness is always allowed, so something can always move.
Any other start is allowed only if a new witness brings the same actors to their ends. The search for it is
greedy: one actor that can finish alone goes to its end, then the next. For the actors that are left, a
bounded search of interleavings follows.

A start has to be safe in several views. In one view, stuck actors are obstacles that stay where they are, so
no run waits for them. An actor is stuck if a module is down, a person is asked, or its run is paused, for
example. In the hopeful views no actor is stuck, so no start blocks the way of a stuck run permanently. Only
the application of an open experiment knows when the experiment closes. So in one hopeful view its parked
labware stays, and no run inside waits for the closing. In the other one the experiment closes, so that the
closing workflow can always be run.

Actors are the runs inside the workcell, and the closing workflows of experiments that have runs inside or
parked labware. A closing workflow waits for all runs of its experiment, and clears away what they leave.
Where no labware stands, it does nothing. A run may use what its experiment has parked, its user's labware and
shared labware. All other labware is an obstacle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import msgspec

from labos.core.booked import find_begun
from labos.core.ids import (
    SHARED,
    ExperimentId,
    Owner,
    experiment_owner,
    run_owner,
    user_owner,
)
from labos.core.open_experiments import ExperimentStatus
from labos.core.runs import IN_FLIGHT, SETTLED, UNKNOWN, RunState, RunStatus, list_statuses
from labos.core.state import LabState
from labos.planning.floor import Actor, Branch, Floor, is_closing
from labos.planning.forks import find_branches, find_kept, list_motions
from labos.planning.layout import (
    find_joint,
    find_standing,
    hold_back_closing,
    is_down,
    keep_after_failure,
    lay_out,
)
from labos.planning.leaving import find_way_out
from labos.planning.moves import may_move, move
from labos.planning.orders import put_in_order
from labos.planning.paths import (
    END,
    FORKED,
    CellRules,
    ClosingStep,
    Motion,
    Path,
    make_path,
    name_leftover_owner,
)
from labos.planning.stuck import find_block, reaches_into
from labos.planning.suggested_way import follow_order
from labos.planning.witness import (
    Trail,
    Witness,
    copy_actor,
    finish_one_by_one,
    interleave,
    list_order,
    replay,
)

OVER = (*SETTLED, IN_FLIGHT)
"""The statuses of steps that have nothing left to do. A step in flight counts as done."""

SEARCH_LIMIT = 200
"""The most interleavings that a search looks at before it gives up."""

THOROUGH = 20
"""The factor by which the limit is larger if the actors inside have no known order, for example after a start
of the kernel. Nothing protects an actor that is missing in the witness of this search."""


class View(msgspec.Struct, frozen=True):
    """A view of a workcell. ``hopeful``: no actor is stuck. ``closing``: open experiments close."""

    cell: str
    hopeful: bool = False
    closing: bool = False


class LastResult(msgspec.Struct, frozen=True):
    """The last result in a view: a witness, the actors that it brings to their ends (``ends``), and the stuck
    actors for which it holds."""

    stuck: frozenset[str]
    witness: Witness
    ends: frozenset[str]


class Safety:
    """Checks starts, in one state after the other. ``searches`` is the number of searches for a witness,
    ``interleavings`` the number of those that tried interleavings."""

    def __init__(self, limit: int = SEARCH_LIMIT) -> None:
        self._paths: dict[str, Path] = {}
        self._known: dict[View, LastResult] = {}
        self._failed_searches: dict[View, tuple[set[str], frozenset[str]]] = {}
        self._limit = limit
        self.searches = 0
        self.interleavings = 0

    def forget(self, state: LabState, cell: str) -> None:
        """Forget what is known of a workcell, because its bench has changed."""
        plans = state.runs.plans
        self._paths = {n: p for n, p in self._paths.items() if n in plans and plans[n].plan.workcell != cell}
        self._known = {view: known for view, known in self._known.items() if view.cell != cell}
        self._failed_searches = {
            view: known for view, known in self._failed_searches.items() if view.cell != cell
        }

    def find_path(self, state: LabState, plan: str) -> Path:
        """The path, with the motions, of a plan that the state has."""
        found = self._paths.get(plan)
        if found is None:
            if len(self._paths) > max(4096, 2 * len(state.runs.plans)):
                self._paths = {name: path for name, path in self._paths.items() if name in state.runs.plans}
            known = state.runs.plans[plan].plan
            found = self._paths[plan] = make_path(known, _make_rules(state, known.workcell))
        return found

    def _list_motions(self, state: LabState, run: RunState, step: int) -> Sequence[Motion]:
        """The motions of a step, on any way of its plan; of a leaving run, on its way out."""
        if run.status == RunStatus.LEAVING:
            rules = _make_rules(state, state.runs.plan_of(run).workcell)
            return [motion for motion in find_way_out(state, run, rules) if motion.step == step]
        return list_motions(self.find_path(state, run.plan), step)

    def changes_anything(self, state: LabState, run: RunState, step: int) -> bool:
        """Whether a step changes where labware stands or whose it is, what a run holds, or a module's
        variable."""
        path = self.find_path(state, run.plan)
        if run.status != RunStatus.LEAVING and not path.ways:
            return step in path.changing
        return any(motion.changes_anything for motion in self._list_motions(state, run, step))

    def can_reach_end(self, state: LabState, run: RunState) -> bool:
        """Whether a run inside can reach its end if no actor is stuck and open experiments close."""
        view = View(state.runs.plan_of(run).workcell, hopeful=True, closing=True)
        actors = [view_actor(actor, view) for actor in self.list_actors(state, view.cell)]
        ground = lay_out(state, view.cell, actors, hopeful=True)
        return run.id in self._check_before(ground, actors, view).ends

    def list_trapped(
        self,
        state: LabState,
        run: RunState,
        step: int,
        *,
        only_asking: bool = False,
        is_blocked: bool | None = None,
    ) -> list[str]:
        """The actors that could no longer reach their ends after the start of a step; empty if the start is
        safe. A new run counts as one of the actors: it is admitted only if it can reach its end. Unless
        ``only_asking``, a start that is safe is recorded as made. ``is_blocked``: whether ``find_block``
        finds a wait for the run (None: the caller does not know)."""
        cell = state.runs.plan_of(run).workcell
        if self._can_pass(state, run, cell, is_blocked):
            return []
        actors = self.list_actors(state, cell)
        found: dict[View, LastResult] = {}
        grounds: dict[bool, Floor] = {}
        for view in self._list_views(state, run, cell, actors):
            here = [view_actor(actor, view) for actor in actors]
            # The floors of two views differ only in labware whose place is not known.
            hopeful = view.hopeful or not state.bench.lost
            if hopeful not in grounds:
                grounds[hopeful] = lay_out(state, cell, actors, hopeful=hopeful)
            mark = len(grounds[hopeful].changes)
            after = self._check_after(state, run, step, grounds[hopeful], here, view)
            grounds[hopeful].take_back(mark)
            if isinstance(after, list):
                return after
            found[view] = after
        if not only_asking:
            self._known.update(found)
        return []

    def is_change_safe(self, state: LabState, run: RunState) -> bool:
        """Whether a run inside may go on with the plan that ``run`` has: it can reach its end, and so can all
        actors that could before."""
        name, cell = str(run.id), state.runs.plan_of(run).workcell
        old = self.list_actors(state, cell)
        new = [self.make_actor(state, run) if actor.name == name else actor for actor in old]
        for view in dict.fromkeys(
            (*self._list_views(state, run, cell, old), *self._list_views(state, run, cell, new))
        ):
            before = [view_actor(actor, view) for actor in old]
            known = self._check_before(lay_out(state, cell, before, hopeful=view.hopeful), before, view)
            after = [view_actor(actor, view) for actor in new]
            wanted = {*known.ends, name}
            _, ends = self.find(lay_out(state, cell, after, hopeful=view.hopeful), after, wanted)
            if not wanted <= ends:
                return False
        return True

    def _can_pass(self, state: LabState, run: RunState, cell: str, is_blocked: bool | None = None) -> bool:
        """Whether a new run only uses modules, and could use each of them now. Then it takes nothing from
        other runs, and can reach its end before them."""
        if run.has_started or run.experiment in state.experiments.open:
            return False
        path = self.find_path(state, run.plan)
        if path.ways or path.changing:
            return False
        newcomer = self.make_actor(state, run, is_blocked=is_blocked)
        floor = lay_out(state, cell, [newcomer], hopeful=False)
        return not newcomer.stuck and all(may_move(floor, newcomer, motion) for motion in path.motions)

    @staticmethod
    def _list_views(state: LabState, run: RunState, cell: str, actors: Sequence[Actor]) -> list[View]:
        """The views in which a start has to be safe. A view that equals another one is left out."""
        views = [View(cell, hopeful=True, closing=True)]
        joining = not run.has_started and run.experiment in state.experiments.open
        if joining or any(actor.parks for actor in actors):
            views.append(View(cell, hopeful=True))
        if any(actor.stuck for actor in actors):
            views.append(View(cell))
        return views

    def _check_after(
        self,
        state: LabState,
        run: RunState,
        step: int,
        ground: Floor,
        actors: list[Actor],
        view: View,
    ) -> LastResult | list[str]:
        """The result after the start, in one view; or the actors that could no longer reach their ends. The
        caller undoes the changes of the floor."""
        known = self._check_before(ground, actors, view)
        name = str(run.id)
        at_once = _count_motions_at_once(actors, name, step)
        if at_once and known.witness[:at_once] == ((name, step),) * at_once:
            return msgspec.structs.replace(known, witness=known.witness[at_once:])
        to_end = set(known.ends)
        floor = ground
        if not run.has_started:
            before = {actor.name for actor in actors}
            actors = [
                actor if actor.name in before else view_actor(actor, view)
                for actor in self.with_newcomer(state, run, actors)
            ]
            inside = {actor.name for actor in actors}
            coming = {actor.name for actor in actors if not actor.stuck} - before
            to_end = (to_end & inside) | coming | {name}
            hold_back_closing(floor, actors[-1])
        mover = next(actor for actor in actors if actor.name == name)
        path = self.find_path(state, run.plan)
        forks = bool(path.ways) and run.status != RunStatus.LEAVING
        for motion in list_motions(path, step) if forks else [m for m in mover.motions if m.step == step]:
            if not may_move(floor, mover, motion):
                return [name]
            move(floor, mover, motion)
        if forks:
            plan = state.runs.plan_of(run)
            steps = list_statuses(plan, run)
            steps[step] = IN_FLIGHT
            failing = self._list_motions_after_failure(state, run)
            failing = failing if view.closing or not mover.parks else _drop_closing(failing)
            mover.motions, mover.forks = find_branches(path, plan, run, steps, _end(mover.home), failing)
            keep_after_failure(
                floor, mover, [kept for kept in find_kept(path, plan, run, steps) if kept.step == step]
            )
            if known.witness and known.witness[0] == (name, FORKED):
                order = replay(floor, actors, known.witness)
                if order is not None:
                    return LastResult(_find_stuck(actors), order, frozenset(to_end))
        else:
            mover.begin(step)
        advised = follow_order(state, view.cell, floor, actors, to_end)
        if advised is not None:
            return LastResult(_find_stuck(actors), advised, frozenset(to_end))
        witness, ends = self.find(floor, actors, to_end)
        lost = sorted(to_end - ends)
        return lost or LastResult(_find_stuck(actors), witness, frozenset(ends))

    def _check_before(self, ground: Floor, actors: list[Actor], view: View) -> LastResult:
        """The result before the start: the last one, or a new one if that no longer holds. It no longer holds
        if an actor has become stuck or free since, or has to repeat a motion."""
        names = {actor.name for actor in actors}
        stuck = _find_stuck(actors)
        known = self._known.get(view)
        if known is not None:
            _put_in_order(actors, known.witness)
            known = _with_passers(known, actors)
        if known is not None and known.stuck == stuck and known.ends >= names - stuck:
            # Steps that change nothing start without this check, so the witness may name steps that are over.
            left = {(actor.name, motion.step) for actor in actors for motion in actor.motions}
            left |= {(actor.name, FORKED) for actor in actors}
            known = msgspec.structs.replace(known, witness=tuple(w for w in known.witness if w in left))
            ahead = Counter(name for name, _ in known.witness)
            complete = all(ahead[a.name] == a.length for a in actors if a.name not in stuck)
            if complete or any(step == FORKED for _, step in known.witness):  # a branch is decided
                order = replay(ground, [actor for actor in actors if not actor.stuck], known.witness)
                if order is not None:
                    found = LastResult(stuck, order, known.ends & names)
                    if not complete:
                        self._known[view] = found
                    return found
        free = names - stuck
        witness, ends = self.find(ground, actors, free)
        if not ends >= free and self._failed_searches.get(view) != (names, stuck):
            self._failed_searches[view] = (names, stuck)  # not again while the same actors are inside
            witness, ends = self.find(ground, actors, free, self._limit * THOROUGH)
        known = self._known[view] = LastResult(stuck, witness, frozenset(ends))
        return known

    def with_newcomer(self, state: LabState, run: RunState, actors: Sequence[Actor]) -> list[Actor]:
        """The actors, and a run that is not inside yet as the last one. The closing workflow of its
        experiment is added if it waits for the run. A closing run takes the place of that workflow."""
        home = experiment_owner(run.experiment)
        others = [actor for actor in actors if not (run.closing and actor.name == home)]
        if _has_waiting_close(state, run) and all(actor.name != home for actor in others):
            others.append(self._make_closing_actor(state, run.experiment))
        return [*others, self.make_actor(state, run)]

    # -- actors ------------------------------------------------------------------------------

    def list_actors(self, state: LabState, cell: str) -> list[Actor]:
        """The actors of a workcell: the runs inside, and the closing workflows that have not started, of
        experiments with runs inside or with labware."""
        inside = list(state.runs.list_inside(cell))
        actors = [self.make_actor(state, run) for run in inside]
        homes = {run.experiment for run in inside}
        closing = {run.experiment for run in inside if run.closing}
        stuck = {actor.home for actor in actors if actor.stuck}
        for name in state.runs.closings_in.get(cell, ()):
            owner = experiment_owner(name)
            if name not in closing and (name in homes or state.bench.list_owned(owner)):
                actor = self._make_closing_actor(state, name)
                actor.stuck = actor.stuck or owner in stuck
                actors.append(actor)
        return actors

    def _make_closing_actor(self, state: LabState, name: ExperimentId) -> Actor:
        """The closing workflow of an experiment as an actor."""
        experiment, owner = state.experiments.open[name], experiment_owner(name)
        path = self.find_path(state, experiment.closing)
        reached = [place for motion in path.motions for place in (motion.source, motion.target)]
        plan = state.runs.plans[experiment.closing].plan
        modules = {step.module for step in plan.steps}
        dead = any(is_down(state, m) or find_begun(state, experiment.user, m) for m in modules) or any(
            module.cut_off and reaches_into(state, module.spec.name, reached)
            for _, module in state.modules.list_in_cell(plan.workcell)
        )
        motions = _make_closing(path)
        waits = [Motion(motion.step, grabs=((owner, None),)) for motion in motions[:1]]
        return Actor(
            owner,
            (),
            (*waits, *motions),
            {},
            (owner, name_leftover_owner(owner)),
            stuck=dead or find_standing(state, owner)[1],
            parks=experiment.status == ExperimentStatus.OPEN,
        )

    def make_actor(self, state: LabState, run: RunState, *, is_blocked: bool | None = None) -> Actor:
        """A run as an actor, with the motions that it has left. If a closing workflow waits for its end, that
        workflow gets the labware that the run leaves. ``is_blocked``: see ``list_trapped``."""
        path, plan = self.find_path(state, run.plan), state.runs.plan_of(run)
        # A step of unknown outcome counts as done, as it does on the floor.
        states = [IN_FLIGHT if status == UNKNOWN else status for status in list_statuses(plan, run)]
        over = {i for i, status in enumerate(states) if status in OVER}
        experiment = state.experiments.open.get(run.experiment)
        owner = experiment_owner(run.experiment)
        home = owner if _has_waiting_close(state, run) else Owner("")
        end = _end(home)
        forks: tuple[Branch, ...] = ()
        kept: Sequence[Motion] = ()
        motions = (*(motion for motion in path.motions if motion.step not in over), *end)
        if run.status == RunStatus.LEAVING:
            motions = (*find_way_out(state, run, _make_rules(state, plan.workcell)), *end)
        elif path.ways:
            motions, forks = find_branches(
                path, plan, run, states, end, self._list_motions_after_failure(state, run)
            )
            kept = find_kept(path, plan, run, states)
        own, lost = find_standing(state, run_owner(run.id))
        return Actor(
            str(run.id),
            (run_owner(run.id),),
            motions,
            own,
            (*([owner] if experiment is not None else []), user_owner(run.user), SHARED),
            stuck=lost or (find_block(state, run) is not None if is_blocked is None else is_blocked),
            parks=bool(home) and experiment is not None and experiment.status == ExperimentStatus.OPEN,
            forks=forks,
            kept=tuple(kept),
            orders=path.orders if run.status != RunStatus.LEAVING else None,
            over=frozenset(over),
            home=home,
        )

    def _list_motions_after_failure(self, state: LabState, run: RunState) -> tuple[Motion, ...]:
        """The motions that follow if a run fails: the closing workflow has to be possible then, too. Empty if
        none waits for the run."""
        if not _has_waiting_close(state, run):
            return ()
        closing = self.find_path(state, state.experiments.open[run.experiment].closing)
        return (*_make_closing(closing), *_end(experiment_owner(run.experiment)))

    # -- searching ---------------------------------------------------------------------------

    def find(
        self, floor: Floor, actors: Sequence[Actor], keep: set[str], limit: int = 0
    ) -> tuple[Witness, set[str]]:
        """A witness, and the actors that it brings to their ends. If actors of ``keep`` are missing and none
        of these is stuck, interleavings are searched: at most ``limit`` in each search (0: the usual limit).
        Changes neither floor nor actors."""
        self.searches += 1
        limit = limit or self._limit
        mark, able = len(floor.changes), [actor for actor in actors if not actor.stuck]
        trail: Trail = []
        waiting = finish_one_by_one(floor, [copy_actor(actor) for actor in able], trail)
        order = list_order(trail)
        ends = {actor.name for actor in able} - {actor.name for actor in waiting}
        missing = [actor for actor in waiting if actor.name in keep]
        if missing and len(missing) == len(keep - ends):
            self.interleavings += 1
            all_over = [copy_actor(actor) for actor in able if actor.name in keep]
            found = interleave(floor, missing, limit)
            if found is not None:
                order += found
                ends |= {actor.name for actor in missing}
            elif len(all_over) > len(missing):
                # The labware of an actor that went first may be in the way of the others.
                floor.take_back(mark)
                found = interleave(floor, all_over, limit)
                if found is not None:
                    order, ends = found, {actor.name for actor in all_over}
        floor.take_back(mark)
        return tuple(order), ends


def _has_waiting_close(state: LabState, run: RunState) -> bool:
    """Whether a closing workflow in the same workcell waits for the end of a run."""
    cell = state.runs.plan_of(run).workcell
    return not run.closing and run.experiment in state.runs.closings_in.get(cell, ())


def _end(home: Owner) -> tuple[Motion, ...]:
    """The end of a run for which the closing workflow of ``home`` waits; empty without ``home``."""
    return (Motion(END, frees=(home,), heir=name_leftover_owner(home)),) if home else ()


def _make_rules(state: LabState, cell: str) -> CellRules:
    stations = state.bench.stations
    specs = [stations[name].spec for name in state.bench.in_cell.get(cell, ())]
    claims = {spec.name: spec.claim for spec in specs if spec.claim or spec.access or spec.kind == "gripper"}
    rests = {name: module.spec.rest for name, module in state.modules.list_in_cell(cell) if module.spec.rest}
    nests = {
        name: tuple(dict.fromkeys(map(state.bench.find_planned_place, state.bench.by_module.get(name, ()))))
        for name, _ in state.modules.list_in_cell(cell)
    }
    return CellRules(claims, rests, nests, find_joint(state, cell))


def _find_stuck(actors: Sequence[Actor]) -> frozenset[str]:
    return frozenset(actor.name for actor in actors if actor.stuck)


def _put_in_order(actors: Sequence[Actor], witness: Witness) -> None:
    """Give each actor whose steps have several possible orders the order of a witness."""
    for actor in actors:
        if actor.orders is not None:
            put_in_order(actor, list(dict.fromkeys(step for name, step in witness if name == actor.name)))


def _count_motions_at_once(actors: Sequence[Actor], name: str, step: int) -> int:
    """The number of motions of an actor's step; 0 if the actor is not inside, or the step is behind a
    fork."""
    return sum(motion.step == step for actor in actors if actor.name == name for motion in actor.motions)


def view_actor(actor: Actor, view: View) -> Actor:
    """A copy of an actor for trials, as it is in a view."""
    seen = copy_actor(actor)
    if view.hopeful:
        seen.stuck = False
    if actor.parks and not view.closing:
        seen.forks = tuple(Branch(_drop_closing(fork.motions), fork.fails) for fork in actor.forks)
        seen.stuck = seen.stuck or not actor.home  # the closing workflow has no home
    return seen


def _drop_closing(motions: Sequence[Motion]) -> tuple[Motion, ...]:
    return tuple(motion for motion in motions if not is_closing(motion))


def _with_passers(known: LastResult, actors: Sequence[Actor]) -> LastResult:
    """The known result, with the runs first that were admitted since and only use modules."""
    passers = [
        actor
        for actor in actors
        if actor.name not in known.ends
        and not (actor.stuck or actor.forks or actor.name in known.stuck)
        and not any(motion.changes_anything for motion in actor.motions)
    ]
    if not passers:
        return known
    ahead = tuple((actor.name, motion.step) for actor in passers for motion in actor.motions)
    ends = known.ends | {actor.name for actor in passers}
    return LastResult(known.stuck, ahead + known.witness, ends)


def _make_closing(path: Path) -> tuple[Motion, ...]:
    return tuple(msgspec.structs.replace(motion, step=ClosingStep(motion.step)) for motion in path.motions)
