"""The waiting room: the runs that wait for admission, in bundles of runs that wait for the same.

Runs of one *class* differ only in age: they have the same priority, shape, user, experiment, campaign, due
date and so on (``queue_key``). Classes of one *bundle* may start under the same conditions: they have the
same priority and shape, the same running clocks and the same bookings. A user with a quota, or with labware
where it makes a difference, has separate bundles. So has an experiment that has anything on the bench.

One check is enough for a whole bundle. Only if one of its runs may start does it matter which one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from labos.core.bench import Bench, Labware
from labos.core.effects import Carrying, Needs, list_places
from labos.core.ids import (
    ExperimentId,
    ModuleName,
    Owner,
    RunId,
    StationName,
    experiment_owner,
    split_key,
    user_owner,
    workcell_of,
)
from labos.core.model import Plan
from labos.core.plans import PlanState
from labos.core.resources import sum_by_supply
from labos.core.runs import RunState, find_holds, list_clocks, list_options, queue_key
from labos.core.state import LabState
from labos.planning.layout import find_destination, list_labware_in
from labos.planning.supplies import SupplyNeeds

PATIENCE = 8
"""The oldest run of a bundle is protected after this many younger runs were admitted before it: no other run
is admitted that uses one of its modules."""

PRIORITY_WEIGHT = 10
"""This many admitted runs of a higher priority, or of an urgent campaign, count as one: they go before older
runs, but not without limit."""


class Kind(msgspec.Struct, frozen=True):
    """What decides whether the first steps of a bundle's runs are possible: ``starts``. Where supplies may be
    too low, also ``needs``: what a run uses up in all with each of its plans."""

    starts: tuple[Any, ...]
    needs: tuple[SupplyNeeds, ...] = ()


class Bundle(msgspec.Struct):
    """Classes that wait in one workcell. ``oldest`` is the position and the class of the oldest run; without
    a class, that run is not known."""

    cell: str
    kind: Kind
    classes: dict[str, bool] = {}
    oldest: tuple[int, str] = (0, "")


class WaitingRoom:
    """The bundles by name, and how often the oldest run of each was overtaken. All but these counts can be
    computed again from the state. All runs of a bundle wait in one workcell."""

    def __init__(self) -> None:
        self._bundles: dict[str, Bundle] = {}
        self._bundle_of: dict[str, str] = {}
        self._in_cell: dict[str, dict[str, bool]] = {}
        self._of_owner: dict[Owner, dict[str, dict[str, bool]]] = {}
        self._present: dict[str, dict[Owner, frozenset[StationName]]] = {}
        self._somewhere: Counter[Owner] = Counter()
        self._interests: dict[str, frozenset[StationName]] = {}
        self._overtakings: dict[str, dict[RunId, float]] = {}
        self._gone: list[str] = []

    # -- which runs wait ---------------------------------------------------------------------

    def fill(self, state: LabState) -> None:
        """Enter all waiting runs into the empty room."""
        for cell in state.lab.workcells:
            self._see(state, cell)
        for group in state.runs.queue:
            self._enter(state, group)

    def refill(self, state: LabState, cell: str) -> None:
        """Enter all runs that wait in a workcell again, because its bench or its bookings have changed."""
        self._interests.clear()
        self._see(state, cell)
        for bundle in self.list_in_cell(cell):
            for group in list(self._bundles[bundle].classes):
                self._leave(group)
                if group in state.runs.queue:
                    self._enter(state, group)

    def note(self, state: LabState, run: RunState) -> str:
        """Enter a waiting run. Returns its bundle if the bundle is new, else an empty string."""
        group = queue_key(state.runs.find_shape(run), run)
        if group in self._bundle_of:
            return ""
        bundle = self._enter(state, group)
        return bundle if len(self._bundles[bundle].classes) == 1 else ""

    def find_bundle(self, state: LabState, run: RunState) -> str:
        """The bundle of a waiting run; empty if it has none."""
        return self._bundle_of.get(queue_key(state.runs.find_shape(run), run), "")

    def find_cell(self, bundle: str) -> str:
        """The workcell in which a bundle waits; empty if the bundle does not exist any more."""
        return self._bundles[bundle].cell if bundle in self._bundles else ""

    def follow(self, state: LabState, cells: Iterable[str]) -> list[str]:
        """Note whose labware is at other places in these workcells than before. Returns the bundles that have
        the classes of these users and experiments now."""
        groups: dict[str, bool] = {}
        for cell in cells:
            before = self._present.get(cell, {})
            known = {owner: self._somewhere[owner] > 0 for owner in before}
            present = self._see(state, cell)
            if before == present:
                continue
            for owner in [o for o in before | present if before.get(o) != present.get(o)]:
                of_owner = self._of_owner.get(owner, {})
                # Whether an experiment has anything on the bench makes a difference in every workcell.
                everywhere = known.get(owner, self._somewhere[owner] > 1) != (self._somewhere[owner] > 0)
                for where in list(of_owner) if everywhere else [cell]:
                    groups.update(of_owner.get(where, {}))
        bundles: dict[str, bool] = {}
        for group in groups:
            self._leave(group)
            if group in state.runs.queue:
                bundles[self._enter(state, group)] = True
        return list(bundles)

    def _see(self, state: LabState, cell: str) -> dict[Owner, frozenset[StationName]]:
        """Note which users and experiments have labware in a workcell; returns the places of each."""
        before, present = self._present.get(cell, {}), _find_present(state, cell)
        if present != before:
            self._somewhere.subtract(before.keys())
            self._somewhere.update(present.keys())
        self._present[cell] = present
        return present

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._bundles))

    def take_emptied(self) -> list[str]:
        """The bundles that have become empty since the last call."""
        gone, self._gone = self._gone, []
        return [bundle for bundle in gone if bundle not in self._bundles]

    def list_in_cell(self, cell: str) -> list[str]:
        """The bundles of a workcell."""
        return list(self._in_cell.get(cell, ()))

    def __contains__(self, bundle: str) -> bool:
        return bundle in self._bundles

    def find_kind(self, bundle: str) -> Kind:
        """The kind of a bundle. Bundles of one kind wait for the same as long as nothing happens."""
        return self._bundles[bundle].kind

    # -- which run is next -------------------------------------------------------------------

    def find_any_run(self, state: LabState, bundle: str) -> RunState | None:
        """Some run of a bundle; None if it has none. All runs of a bundle wait for the same."""
        for group in self._list_classes(bundle):
            if group in state.runs.queue:
                return find_head(state, group)
            self._leave(group)
        return None

    def list_heads(self, state: LabState, bundle: str) -> list[RunState]:
        """The oldest run of each class of a bundle."""
        queue, queued = state.runs.queue, state.runs.queued
        groups = self._list_classes(bundle)
        heads = [queued[next(iter(queue[group]))] for group in groups if group in queue]
        if len(heads) < len(groups):
            for group in [group for group in groups if group not in queue]:
                self._leave(group)
        return heads

    def find_oldest(self, state: LabState, bundle: str) -> RunState | None:
        """The oldest run of a bundle; None if it has none."""
        known = self._bundles.get(bundle)
        if known is None:
            return None
        position, group = known.oldest
        if group in state.runs.queue and self._bundle_of.get(group) == bundle:
            head = find_head(state, group)
            if head.position == position:
                return head
        oldest = min(self.list_heads(state, bundle), key=lambda run: run.position, default=None)
        if oldest is not None:
            known.oldest = oldest.position, queue_key(state.runs.find_shape(oldest), oldest)
        return oldest

    def _list_classes(self, bundle: str) -> list[str]:
        return list(self._bundles[bundle].classes) if bundle in self._bundles else []

    # -- runs that were overtaken ------------------------------------------------------------

    def count_admission(self, state: LabState, run: RunState, *, urgent: bool = False) -> None:
        """Count the admission of a run for the oldest run of every bundle of the workcell. It counts if that
        run is older and needs one of the same modules. It counts as ``1 / PRIORITY_WEIGHT`` if the admitted
        run has a higher priority or is ``urgent``."""
        cell = state.runs.plan_of(run).workcell
        mine = {step.module for step in state.runs.plan_of(run).steps}
        self.forget(run.id, cell)
        for bundle in self.list_in_cell(cell):
            elder = self.find_oldest(state, bundle)
            if elder is None or elder.position >= run.position:
                continue
            if not mine.isdisjoint(list_modules(state, elder)):
                goes_first = urgent or run.priority > elder.priority
                self.overtake(state, elder, 1 / PRIORITY_WEIGHT if goes_first else 1)

    def overtake(self, state: LabState, elder: RunState, times: float = 1) -> None:
        """Note that a younger run of the workcell was admitted before a waiting run. It counts ``times``."""
        counts = self._overtakings.setdefault(state.runs.plan_of(elder).workcell, {})
        counts[elder.id] = counts.get(elder.id, 0) + times

    def count_overtakings(self, cell: str, run: RunId) -> float:
        """How often a waiting run was overtaken in a workcell, with the weights of the younger runs."""
        return self._overtakings.get(cell, {}).get(run, 0)

    def list_overtaken(self, state: LabState, cell: str) -> list[RunState]:
        """The waiting runs that were overtaken too often in a workcell."""
        counts = self._overtakings.get(cell)
        if not counts:
            return []
        for name in [name for name in counts if name not in state.runs.queued]:
            del counts[name]
        return [state.runs.queued[name] for name, count in counts.items() if round(count, 6) >= PATIENCE]

    def is_overtaken(self, state: LabState, run: RunState) -> bool:
        """Whether a waiting run was overtaken too often."""
        overtaken = self.list_overtaken(state, state.runs.plan_of(run).workcell)
        return any(other.id == run.id for other in overtaken)  # the caller's run may have another plan

    def forget(self, run: RunId, cell: str) -> None:
        """Forget a run that does not wait any more."""
        self._overtakings.get(cell, {}).pop(run, None)

    # -- bundles -----------------------------------------------------------------------------

    def _enter(self, state: LabState, group: str) -> str:
        run = find_head(state, group)
        cell = state.runs.plan_of(run).workcell
        present = self._present.get(cell, {})
        user, experiment = user_owner(run.user), experiment_owner(run.experiment)
        owners = [user, experiment] if run.experiment else [user]
        home = state.experiments.open.get(run.experiment)
        closing = home.closing if home is not None else ""
        shape, plans = state.runs.find_shape(run), [state.runs.plans[p] for p in run.choices or (run.plan,)]
        interest = frozenset[StationName]()
        for what in plans:
            interest |= self._list_stations(state, what.shape, what.plan)
        if closing:
            interest |= self._list_stations(state, closing, state.runs.plans[closing].plan)
        stake = [owner for owner in owners if interest & present.get(owner, frozenset())]
        booked = _list_booked(state, run, cell) if state.bookings.open else ""
        if booked:
            stake.append(Owner(f"booked:{booked}"))
        if state.shares.list_limits(run.user):
            stake.append(Owner(f"quota:{run.user}"))
        if run.experiment and not self._somewhere[experiment]:
            # Experiments that have nothing on the bench differ only in their closing workflows.
            stake.append(Owner(f"closing:{closing}:{run.closing}"))
        elif run.experiment and experiment not in stake:
            stake.append(experiment)
        clocks = list_clocks(run)
        is_booked = bool(state.bookings.list_in_cell(cell))
        bundle = "\x1f".join((shape, str(run.priority), str(find_holds(run)), str(clocks), *stake))
        kind = Kind(
            (*(_encode_starts(what, is_booked) for what in plans), find_holds(run), *clocks, *stake),
            tuple(tuple(sum_by_supply(what.uses_up).items()) for what in plans),
        )
        known = self._bundles.setdefault(bundle, Bundle(cell, kind))
        known.classes[group], known.kind, known.oldest = True, kind, (0, "")
        self._in_cell.setdefault(cell, {})[bundle] = True
        self._bundle_of[group] = bundle
        for owner in owners:
            self._of_owner.setdefault(owner, {}).setdefault(cell, {})[group] = True
        return bundle

    def _list_stations(self, state: LabState, shape: str, plan: Plan) -> frozenset[StationName]:
        """The stations at which the owner of the labware makes a difference to runs of a shape."""
        found = self._interests.get(shape)
        if found is None:
            found = self._interests[shape] = _list_stations(state, plan)
        return found

    def _leave(self, group: str) -> None:
        bundle = self._bundle_of.pop(group)
        known = self._bundles[bundle]
        cell = known.cell
        del known.classes[group]
        if not known.classes:
            del self._bundles[bundle]
            del self._in_cell[cell][bundle]
            self._gone.append(bundle)
        _, _, user, experiment, _, _ = group.split("\x1f")
        for owner in (user_owner(user), experiment_owner(ExperimentId(experiment))):
            cells = self._of_owner.get(owner, {})
            groups = cells.get(cell, {})
            groups.pop(group, None)
            if not groups:
                cells.pop(cell, None)
            if not cells:
                self._of_owner.pop(owner, None)


def list_modules(state: LabState, run: RunState) -> set[ModuleName]:
    """The modules that a run uses or, while it waits, may use."""
    return {step.module for option in list_options(run) for step in state.runs.plan_of(option).steps}


def find_head(state: LabState, group: str) -> RunState:
    """The oldest run of a waiting class."""
    return state.runs.queued[next(iter(state.runs.queue[group]))]


def _list_booked(state: LabState, run: RunState, cell: str) -> str:
    """The ids of the bookings in a workcell that are for a run's user."""
    group = state.shares.group_of.get(run.user, "")
    return ",".join(b.id for b in state.bookings.list_in_cell(cell) if b.is_for(run.user, group))


def _encode_starts(plan: PlanState, is_booked: bool) -> bytes:
    """The first steps of a plan as text. Apart from the supplies for all steps, they decide whether a run
    with this plan may start: before a booking, a short step may, and a long one may not."""
    steps = [plan.plan.steps[index] for index in plan.starts]
    first = [(s.module, s.effects, s.exclusive, s.windows, s.recovers) for s in steps]
    lengths = [s.duration_s for s in steps] if is_booked else []
    return msgspec.json.encode([first, lengths])


def _list_stations(state: LabState, plan: Plan) -> frozenset[StationName]:
    bench = state.bench
    found: set[StationName] = set()
    claims: set[str] = set()
    for step in plan.steps:
        claims.add(step.module)
        for place in list_places(step.effects):
            claims.add(bench.stations[place].spec.claim)
            claims.add(bench.stations[place].spec.module)
        for effect in step.effects:
            if isinstance(effect, Carrying):
                found.update(effect.stands)
            elif isinstance(effect, Needs):
                found.update([effect.station] if effect.station else bench.by_module.get(step.module, ()))
    for name in bench.in_cell.get(plan.workcell, ()):
        claim = bench.stations[name].spec.claim
        if claim and claim in claims:
            found.add(name)
    return frozenset(found)


def _find_present(state: LabState, cell: str) -> dict[Owner, frozenset[StationName]]:
    """The places in a workcell at which users and experiments have labware, or may have it after a motion. An
    experiment with a run inside is included even without labware."""
    found: dict[Owner, set[StationName]] = {}
    for item in list_labware_in(state, cell):
        if split_key(item.owner)[0] in ("user", "experiment"):
            places = [p for p in _list_places(state.bench, item) if workcell_of(p) == cell]
            if places:
                found.setdefault(item.owner, set()).update(places)
    for run in state.runs.list_inside(cell):
        if run.experiment:
            found.setdefault(experiment_owner(run.experiment), set())
    return {owner: frozenset(places) for owner, places in found.items()}


def _list_places(bench: Bench, item: Labware) -> list[StationName]:
    if not item.moving and not item.maybe:
        return [bench.find_planned_place(item.station)]
    return [
        bench.find_planned_place(item.station),
        find_destination(bench, item),
        *map(bench.find_planned_place, item.maybe),
    ]
