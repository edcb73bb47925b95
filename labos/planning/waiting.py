"""The waiting room: runs that wait to be let in, in bundles of those that wait for the same.

Runs of one *class* (same priority, shape, user and experiment) differ in nothing but age. Classes
of one *bundle* may start under the same conditions: they have the same priority and shape, no
clock runs for one and not for the others, and neither their user nor their experiment has anything
on the bench where it would make a difference. So one look serves for a whole bundle, and only when
somebody of it may start does it matter who.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from labos.core.bench import Bench, Labware
from labos.core.effects import Move, Needs, Relid, places
from labos.core.ids import ExperimentId, Owner, RunId, StationName, experiment_owner, user_owner
from labos.core.model import Plan
from labos.core.plans import PlanState
from labos.core.runs import RunState, clocks_of, queue_key
from labos.core.state import LabState
from labos.planning.floor import destination

PATIENCE = 8
"""After so many younger runs were let in before it, the oldest run of a bundle is protected: no
other is let in that uses one of its modules."""

Kind = tuple[Any, ...]


class WaitingRoom:
    """Bundles by name, and how often the oldest of each was passed over. Keeps nothing that could
    not be worked out again from the state, but the counts."""

    def __init__(self) -> None:
        self._classes: dict[str, dict[str, bool]] = {}
        self._bundle_of: dict[str, str] = {}
        self._of_owner: dict[Owner, dict[str, bool]] = {}
        self._present: dict[Owner, frozenset[StationName]] = {}
        self._interests: dict[str, frozenset[StationName]] = {}
        self._oldest: dict[str, tuple[int, str]] = {}
        self._kinds: dict[str, Kind] = {}
        self._passed_over: dict[RunId, int] = {}

    # -- who is here -------------------------------------------------------------------------

    def fill(self, state: LabState) -> None:
        """Begin anew with everybody who waits."""
        for store in (
            self._classes,
            self._bundle_of,
            self._of_owner,
            self._interests,
            self._oldest,
            self._kinds,
        ):
            store.clear()
        self._present = _present(state)
        for group in state.runs.queue:
            self._enter(state, group)

    def note(self, state: LabState, run: RunState) -> str:
        """Somebody waits: the bundle, if it is one that nobody has looked at yet, else empty."""
        group = queue_key(state.runs.plans[run.plan].shape, run)
        if group in self._bundle_of:
            return ""
        bundle = self._enter(state, group)
        return bundle if len(self._classes[bundle]) == 1 else ""

    def follow(self, state: LabState) -> list[str]:
        """See whose labware stands elsewhere than before; returns the bundles in which their
        classes are now."""
        before, self._present = self._present, _present(state)
        if before == self._present:
            return []
        bundles: dict[str, bool] = {}
        for owner in [o for o in before | self._present if before.get(o) != self._present.get(o)]:
            for group in list(self._of_owner.get(owner, ())):
                self._leave(group)
                if group in state.runs.queue:
                    bundles[self._enter(state, group)] = True
        return list(bundles)

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._classes))

    def __contains__(self, bundle: str) -> bool:
        return bundle in self._classes

    def kind(self, bundle: str) -> Kind:
        """What decides whether the first steps of a bundle's runs are possible: bundles of one kind
        have the same answer as long as nothing happens."""
        return self._kinds[bundle]

    # -- who is next -------------------------------------------------------------------------

    def anybody(self, state: LabState, bundle: str) -> RunState | None:
        """Some run of a bundle: what one of them waits for, all of them wait for."""
        for group in list(self._classes.get(bundle, ())):
            if group in state.runs.queue:
                return head_of(state, group)
            self._leave(group)
        return None

    def heads(self, state: LabState, bundle: str) -> list[RunState]:
        """The oldest run of each class of a bundle."""
        queue, queued = state.runs.queue, state.runs.queued
        groups = self._classes.get(bundle, {})
        heads = [queued[next(iter(queue[group]))] for group in groups if group in queue]
        if len(heads) < len(groups):
            for group in [group for group in groups if group not in queue]:
                self._leave(group)
        return heads

    def first(self, state: LabState, bundle: str, used: Callable[[str], float]) -> RunState | None:
        """Whose turn it is in a bundle: the user who had least, then the oldest."""
        best, least = None, (0.0, 0)
        for run in self.heads(state, bundle):
            rank = (used(run.user), run.position)
            if best is None or rank < least:
                best, least = run, rank
        return best

    def oldest(self, state: LabState, bundle: str) -> RunState | None:
        """Who has waited longest in a bundle."""
        position, group = self._oldest.get(bundle, (0, ""))
        if group in state.runs.queue and self._bundle_of.get(group) == bundle:
            head = head_of(state, group)
            if head.position == position:
                return head
        oldest = min(self.heads(state, bundle), key=lambda run: run.position, default=None)
        if oldest is not None:
            group = queue_key(state.runs.plans[oldest.plan].shape, oldest)
            self._oldest[bundle] = (oldest.position, group)
        return oldest

    # -- who was passed over -----------------------------------------------------------------

    def let_in(self, state: LabState, run: RunState) -> None:
        """Count against the oldest of every bundle, if it is older than the run let in."""
        self._passed_over.pop(run.id, None)
        for bundle in self:
            elder = self.oldest(state, bundle)
            if elder is not None and elder.priority >= run.priority and elder.position < run.position:
                self._passed_over[elder.id] = self._passed_over.get(elder.id, 0) + 1

    def impatient(self, state: LabState) -> list[RunState]:
        """Who was passed over too often."""
        for name in [name for name in self._passed_over if name not in state.runs.queued]:
            del self._passed_over[name]
        return [state.runs.queued[name] for name, count in self._passed_over.items() if count >= PATIENCE]

    # -- inside ------------------------------------------------------------------------------

    def _enter(self, state: LabState, group: str) -> str:
        run = head_of(state, group)
        user, experiment = user_owner(run.user), experiment_owner(run.experiment)
        owners = [user, experiment] if run.experiment else [user]
        known = state.campaigns.experiments.get(run.experiment)
        closing = known.closing if known is not None else ""
        shape = state.runs.plans[run.plan].shape
        interest = self._interest(state, shape, state.runs.plan_of(run))
        if closing:
            interest |= self._interest(state, closing, state.runs.plans[closing].plan)
        stake = [owner for owner in owners if interest & self._present.get(owner, frozenset())]
        if run.experiment and experiment not in self._present:
            # Of experiments that have nothing on the bench only the way out differs.
            stake.append(Owner(f"closing:{closing}:{run.closing}"))
        elif run.experiment and experiment not in stake:
            stake.append(experiment)
        clocks = clocks_of(run)
        bundle = "\x1f".join((shape, str(run.priority), str(int(run.paused)), str(clocks), *stake))
        self._classes.setdefault(bundle, {})[group] = True
        self._oldest.pop(bundle, None)
        self._kinds[bundle] = (_starts(state.runs.plans[run.plan]), run.paused, *clocks, *stake)
        self._bundle_of[group] = bundle
        for owner in owners:
            self._of_owner.setdefault(owner, {})[group] = True
        return bundle

    def _interest(self, state: LabState, shape: str, plan: Plan) -> frozenset[StationName]:
        """Stations at which it makes a difference to runs of a shape whose labware stands there."""
        found = self._interests.get(shape)
        if found is None:
            found = self._interests[shape] = _interest(state, plan)
        return found

    def _leave(self, group: str) -> None:
        bundle = self._bundle_of.pop(group)
        del self._classes[bundle][group]
        if not self._classes[bundle]:
            del self._classes[bundle]
            self._oldest.pop(bundle, None)
            del self._kinds[bundle]
        _, _, user, experiment, _ = group.split("\x1f")
        for owner in (user_owner(user), experiment_owner(ExperimentId(experiment))):
            groups = self._of_owner.get(owner)
            if groups is not None:
                groups.pop(group, None)
                if not groups:
                    del self._of_owner[owner]


def head_of(state: LabState, group: str) -> RunState:
    """The oldest run of a waiting class."""
    return state.runs.queued[next(iter(state.runs.queue[group]))]


def _starts(plan: PlanState) -> bytes:
    steps = [plan.plan.steps[index] for index in plan.starts]
    return msgspec.json.encode([(s.module, s.effects, s.exclusive, s.windows, s.recovers) for s in steps])


def _interest(state: LabState, plan: Plan) -> frozenset[StationName]:
    bench = state.bench
    found: set[StationName] = set()
    claims: set[str] = set()
    for step in plan.steps:
        claims.add(step.module)
        for place in places(step.effects):
            claims.add(bench.stations[place].spec.claim)
            claims.add(bench.stations[place].spec.module)
        for effect in step.effects:
            if isinstance(effect, Move):
                found.add(effect.source)
                if isinstance(effect, Relid):
                    found.add(effect.target)
            elif isinstance(effect, Needs):
                found.update([effect.station] if effect.station else bench.by_module.get(step.module, ()))
    found.update(name for name, s in bench.stations.items() if s.spec.claim and s.spec.claim in claims)
    return frozenset(found)


def _present(state: LabState) -> dict[Owner, frozenset[StationName]]:
    """Where users and experiments have labware, or will have it; an experiment with a run inside
    is there too."""
    bench = state.bench
    present: dict[Owner, frozenset[StationName]] = {
        owner: frozenset(place for item in bench.owned(owner) for place in _whereabouts(bench, item))
        for owner in bench.by_owner
        if owner.startswith(("user:", "experiment:"))
    }
    for run in state.runs.active.values():
        if run.experiment:
            present.setdefault(experiment_owner(run.experiment), frozenset())
    return present


def _whereabouts(bench: Bench, item: Labware) -> list[StationName]:
    if not item.moving and not item.maybe:
        return [bench.planned(item.station)]
    return [bench.planned(item.station), destination(bench, item), *map(bench.planned, item.maybe)]
