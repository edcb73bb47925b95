"""Whether runs can still reach their ends after some steps have started, one after the other. Also, whether
they can if no run moves between two steps of which the second has to follow in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labos.core.ids import RunId
from labos.core.state import LabState
from labos.planning.floor import Actor, Floor
from labos.planning.forecast import is_pending
from labos.planning.layout import lay_out
from labos.planning.moves import may_move, move
from labos.planning.paths import END
from labos.planning.player import Step
from labos.planning.safety import Safety, View, view_actor
from labos.planning.witness import Trail, copy_actor, finish_one_by_one, go_on, take_all_back

SEARCH_LIMIT = 100
"""The most interleavings that are tried before a search is given up."""


def find_first_trap(
    state: LabState, cell: str, starts: Sequence[Step], safety: Safety
) -> tuple[Step, tuple[str, ...]] | None:
    """The first of these starts after which some runs could not reach their ends although they can now, and
    the names of these runs. None if there is no such start. None also if the way of an actor forks: then
    planning checks each start when its turn comes."""
    here = _view_actors(state, cell, [name for name, _ in starts], safety)
    if any(actor.forks for actor in here):
        return None
    moving = {(actor.name, motion.step) for actor in here for motion in actor.motions}
    starts = [start for start in starts if start in moving]
    if not starts:
        return None
    ground = lay_out(state, cell, here, hopeful=True)
    low, high = 0, len(starts)
    lost = {actor.name for actor in here} - _find_ending_runs(ground, here, starts, safety)
    if not lost:
        return None
    lost &= _find_ending_runs(ground, here, (), safety)
    if not lost:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        if lost <= _find_ending_runs(ground, here, starts[:middle], safety):
            low = middle
        else:
            high = middle
    return starts[high - 1], tuple(sorted(lost))


def find_late_step(state: LabState, cell: str, starts: Sequence[Step], safety: Safety) -> Step | None:
    """A step that could not follow in time after these starts, whichever run goes first: other runs would
    have to move while its clock runs. None if there is no such step, or if this cannot be known."""
    here = _view_actors(state, cell, [name for name, _ in starts], safety)
    if any(actor.forks for actor in here):
        return None
    floor = lay_out(state, cell, here, hopeful=True)
    cast = {actor.name: actor for actor in here}
    for name, step in starts:
        if name not in cast or not _carry_out(floor, cast[name], step):
            return None
    left = finish_one_by_one(floor, here, [])
    ties = {actor.name: _list_ties(state, actor, starts) for actor in left}
    tied = next((actor for actor in left if any(ties[actor.name])), None)
    if tied is None or _come_to_ends(floor, left, ties):
        return None
    return tied.name, max(ties[tied.name])


def _list_ties(state: LabState, actor: Actor, begun: Sequence[Step]) -> list[int]:
    """For each motion of an actor, the windowed step because of which the next motion has to follow at once
    (0: it may wait)."""
    run = state.runs.get(RunId(actor.name))
    if run is None:
        return [0] * len(actor.motions)
    spans = [
        (window.anchor, index)
        for index in state.runs.plans[run.plan].windowed
        if is_pending(run, index) and not run.is_breached(index)
        for window in state.runs.plan_of(run).steps[index].windows
        if window.within_s is not None and window.anchor is not None
        if is_pending(run, window.anchor) and (actor.name, window.anchor) not in begun
    ]
    spans = _join_spans(spans)
    steps = [motion.step for motion in actor.motions]
    return [
        max((last for first, last in spans if first <= here and there <= last), default=0)
        if isinstance(here, int) and isinstance(there, int)
        else 0
        for here, there in zip(steps, [*steps[1:], END], strict=True)
    ]


def _join_spans(spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The spans of windows; two are joined if one starts with the step with which the other ends."""
    found: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        before = next((number for number, span in enumerate(found) if span[1] == first), None)
        if before is None:
            found.append((first, last))
        else:
            found[before] = (found[before][0], last)
    return found


def _come_to_ends(floor: Floor, actors: Sequence[Actor], ties: Mapping[str, Sequence[int]]) -> bool:
    """Whether actors reach their ends in an order in which tied motions follow at once. False also if the
    search is given up."""
    seen: set[tuple[int, ...]] = set()

    def deeper() -> bool:
        for actor in actors:
            trail: Trail = []
            if not _go_on(floor, actor, ties[actor.name], trail):
                continue
            where = tuple(other.done for other in actors)
            if where not in seen and len(seen) < SEARCH_LIMIT:
                seen.add(where)
                behind: Trail = []
                if not finish_one_by_one(floor, [a for a in actors if a.done < a.length], behind):
                    return True
                take_all_back(floor, behind)
                if deeper():
                    return True
            take_all_back(floor, trail)
        return False

    return deeper()


def _go_on(floor: Floor, actor: Actor, ties: Sequence[int], trail: Trail) -> bool:
    """Carry out an actor's next motion and those that are tied to it. If one is not possible, undo them and
    return False."""
    tied = True
    while tied:
        if actor.done >= len(actor.motions) or not go_on(floor, actor, trail):
            take_all_back(floor, trail)
            return False
        tied = bool(ties[actor.done - 1])
    return True


def _view_actors(state: LabState, cell: str, names: Sequence[str], safety: Safety) -> list[Actor]:
    """The actors inside, and those of the named runs that would be admitted. They are seen as if no actor
    were stuck and all experiments closed."""
    view = View(cell, hopeful=True, closing=True)
    actors = safety.list_actors(state, cell)
    inside = {actor.name for actor in actors}
    for name in dict.fromkeys(names):
        queued = state.runs.queued.get(RunId(name))
        if queued is not None and name not in inside:
            actors = safety.with_newcomer(state, queued, actors)
    return [view_actor(actor, view) for actor in actors]


def _find_ending_runs(
    floor: Floor, actors: Sequence[Actor], starts: Sequence[Step], safety: Safety
) -> set[str]:
    """The actors that reach their ends after these starts; empty if one of the starts is not possible.
    Changes neither floor nor actors."""
    mark, cast = len(floor.changes), {actor.name: copy_actor(actor) for actor in actors}
    is_possible = all(_carry_out(floor, cast[name], step) for name, step in starts)
    ends = safety.find(floor, list(cast.values()), set(cast))[1] if is_possible else set()
    floor.take_back(mark)
    return ends


def _carry_out(floor: Floor, mover: Actor, step: int) -> bool:
    """Carry out the motions of a step on the floor; return whether all are possible. If one is not, those
    before it stay on the floor."""
    for motion in [motion for motion in mover.motions if motion.step == step]:
        if not may_move(floor, mover, motion):
            return False
        move(floor, mover, motion)
    mover.begin(step)
    return True
