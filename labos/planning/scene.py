"""The workcell in a rehearsal: which steps are in flight, where labware stands, and what each run holds.

The rules are those for starting a step (``core.rules``), as far as they concern time and room: modules,
hands, stations, decks, doors, zones, setpoints and holds of plans.
"""

from __future__ import annotations

import heapq
from typing import Any

from labos.core.actions import ActionStatus
from labos.core.algebra import check_effect, compute_settings_after
from labos.core.binding import is_same
from labos.core.effects import (
    AnyEffect,
    Carrying,
    Claims,
    Consumes,
    Effect,
    Needs,
    Requires,
    changes_labware,
    name_hand,
    rename_places,
)
from labos.core.ids import ModuleName, Owner, RunId, StationName, find_owning_run, run_owner, workcell_of
from labos.core.model import PlanStep
from labos.core.runs import DONE, SETTLED, RunState
from labos.core.state import LabState
from labos.core.waits import list_party
from labos.core.zones import find_zones
from labos.planning.forecast import find_setup_in_progress, find_usual_time
from labos.planning.layout import is_down
from labos.planning.player import FAR, NOBODY, Player, Step, Who


class Scene:
    """A workcell at one time: which steps are in flight, where labware stands, and what each run holds."""

    def __init__(self, state: LabState, cell: str, now: int) -> None:
        self.state, self.cell, self.now = state, cell, now
        self.busy: dict[ModuleName, Who] = {}
        self.reached: dict[ModuleName, dict[Who, bool]] = {}
        self.zones: dict[str, dict[Who, ModuleName]] = {}
        self.standing: dict[StationName, list[tuple[Owner, Who]]] = {}
        self.held: dict[ModuleName, dict[str, int | None]] = {}
        self.values: dict[tuple[ModuleName, str], tuple[Any, Who]] = {}
        self.setpoints: dict[tuple[ModuleName, str], dict[str, tuple[Any, int | None]]] = {}
        self.flying: list[tuple[int, int, Step, PlanStep, tuple[AnyEffect, ...]]] = []
        self.drawn: dict[StationName, int] = {}
        self.lent: dict[str, tuple[tuple[StationName, Owner], ...]] = {}
        self.inside = {str(name) for name in state.runs.active}
        bench = state.bench
        for place, station in bench.stations.items():
            for labware in station.labware if not station.spec.hotel else ():
                item = bench.labware[labware]
                self.standing.setdefault(place, []).append((item.owner, (find_owning_run(item.owner), None)))
                if item.lender:
                    self._lend(find_owning_run(item.owner), place, item.lender)
        for name in state.runs.holders:
            self.held[name] = {str(run): None for run in state.runs.list_holders(name)}
        for name, module in state.modules.by_name.items():
            if workcell_of(name) == cell:
                for variable, known in module.variables.items():
                    self.values[name, variable] = known.value, (known.by, None)
                for setpoint, now_set in module.setpoints.items():
                    self.setpoints[name, setpoint] = {str(r): (now_set.value, None) for r in now_set.holders}
        for action in state.actions.open.values():
            run = state.runs.active.get(action.run)
            if run is None or workcell_of(action.module) != cell:
                continue
            step = state.runs.plan_of(run).steps[action.step]
            end = max(
                now,
                action.requested_at + find_usual_time(state, step) + find_setup_in_progress(state, action),
            )
            effects = tuple(rename_places(e, bench.find_planned_place) for e in action.effects)
            end = FAR if action.status == ActionStatus.UNKNOWN else end
            self.take(run, action.step, step, effects, end)

    def copy(self) -> Scene:
        other = Scene.__new__(Scene)
        other.state, other.cell, other.now = self.state, self.cell, self.now
        other.busy, other.values, other.flying = dict(self.busy), dict(self.values), list(self.flying)
        other.inside, other.drawn, other.lent = set(self.inside), dict(self.drawn), dict(self.lent)
        other.reached = {name: dict(who) for name, who in self.reached.items()}
        other.zones = {name: dict(who) for name, who in self.zones.items()}
        other.standing = {name: list(who) for name, who in self.standing.items()}
        other.held = {name: dict(who) for name, who in self.held.items()}
        other.setpoints = {name: dict(who) for name, who in self.setpoints.items()}
        return other

    def with_run_alone(self, run: RunState) -> Scene:
        """A copy of the scene without other runs. Labware that the run may use stays, and doors and lids that
        other runs have moved are at rest."""
        other, mine = self.copy(), (str(run.id), "")
        other.flying = [item for item in self.flying if item[2][0] in mine]
        other.busy = {name: who for name, who in self.busy.items() if who[0] in mine}
        other.reached = {n: {w: True for w in who if w[0] in mine} for n, who in self.reached.items()}
        other.zones = {n: {w: at for w, at in who.items() if w[0] in mine} for n, who in self.zones.items()}
        owners = list_party(run)
        other.standing = {n: [i for i in items if i[0] in owners] for n, items in self.standing.items()}
        other.held = {n: {w: at for w, at in who.items() if w in mine} for n, who in self.held.items()}
        other.setpoints = {
            n: {w: at for w, at in who.items() if w in mine} for n, who in self.setpoints.items()
        }
        for key, (value, by) in self.values.items():
            rest = self.state.modules.by_name[key[0]].spec.rest
            other.values[key] = (value if by[0] in mine else rest.get(key[1], value)), by
        return other

    def list_ends(self) -> dict[str, dict[int, int]]:
        """The ends of the steps in flight (UTC ns), by run and step."""
        ends: dict[str, dict[int, int]] = {}
        for end, _, (name, index), *_ in self.flying:
            ends.setdefault(name, {})[index] = end
        return ends

    # -- what is in the way ----------------------------------------------------------------------

    def find_in_the_way(self, player: Player, index: int) -> Who | None:
        """The run or step that keeps a step from starting, by the rules. None if the step may start.
        ``NOBODY`` if no run could make way for it."""
        step = player.plan.steps[index]
        if is_down(self.state, step.module, recovered=step.recovers):
            return NOBODY
        if step.exclusive:
            found = self._find_user_of_module(player, step)
            if found is not None:
                return found
        for hold in player.plan.holds:
            if hold.first == index:
                holder = self.find_holder(player, hold.module)
                if holder is not None:
                    return holder
        step_scene = StepScene(self, player, step)
        for effect in step.effects:
            found = check_effect(step_scene, effect)
            if found is not None:
                return found
        return None

    def _find_user_of_module(self, player: Player, step: PlanStep) -> Who | None:
        if step.module in self.busy:
            return self.busy[step.module]
        holder = None if step.recovers else self.find_holder(player, step.module)
        if holder is not None:
            return holder
        reaching = self.reached.get(step.module)
        if reaching:
            return next(iter(reaching))
        for zone in find_zones(self.state, step.module, step.effects):
            for who, module in self.zones.get(zone, {}).items():
                if module != step.module:
                    return who
        return None

    def find_holder(self, player: Player, name: ModuleName) -> Who | None:
        """The run or step that keeps a module from a player: by labware of another owner, by a hold, or by a
        door or lid. None if the module is not kept."""
        stations = self.state.bench.stations
        for place in self.state.bench.by_module.get(name, ()):
            if stations[place].spec.claim:
                for owner, by in self.standing.get(place, ()):
                    if owner not in player.party:
                        return by
        return self.find_keeper(player, name)

    def find_keeper(self, player: Player, name: ModuleName) -> Who | None:
        """The run or step that keeps a module from a player by a hold, or by a door or lid that is not at
        rest. None if the module is not kept."""
        for holder, at in self.held.get(name, {}).items():
            if holder != player.name:
                return holder, at
        module = self.state.modules.by_name[name]
        for variable, rest in module.spec.rest.items():
            value, by = self.values.get((name, variable), (rest, NOBODY))
            if value != rest and by[0] in self.inside and by[0] != player.name:
                return by
        return None

    # -- changes -----------------------------------------------------------------------------------

    def take(
        self, run: RunState, index: int, step: PlanStep, effects: tuple[AnyEffect, ...], end: int
    ) -> None:
        """Start a step that ends at ``end`` (UTC ns). From now on it has all that it needs."""
        stations, who = self.state.bench.stations, (str(run.id), index)
        self.inside.add(who[0])
        if step.exclusive:
            self.busy[step.module] = who
            for zone in find_zones(self.state, step.module, effects):
                self.zones.setdefault(zone, {})[who] = step.module
        for effect in effects:
            owner = run_owner(run.id)
            if isinstance(effect, Carrying):
                owner = owner if effect.stock else self._find_owner_at(run, effect.source)
                for place in effect.entered:
                    spec = stations[place].spec if place in stations else None
                    if spec is not None and spec.module and not spec.stands_apart:
                        self.reached.setdefault(spec.module, {})[who] = True
                if effect.stock:
                    self.drawn[effect.stock] = self.drawn.get(effect.stock, 0) + 1
            elif isinstance(effect, Needs):
                self._borrow(run, step, effect, who, keeps=changes_labware(effects))
            for place in effect.room:
                if stations[place].spec.kind != "waste":
                    self.standing.setdefault(place, []).append((owner, who))
        for setpoint, value in compute_settings_after(effects).claims.items():
            self.setpoints.setdefault((step.module, setpoint), {})[who[0]] = value, index
        for hold in self.state.runs.plan_of(run).holds:
            if hold.first == index:
                self.held.setdefault(hold.module, {})[who[0]] = index
        heapq.heappush(self.flying, (end, len(self.flying) + index, who, step, effects))

    def list_places(self, step: PlanStep, needs: Needs) -> list[StationName]:
        """The stations where the labware that a step needs may stand."""
        return [needs.station] if needs.station else self.state.bench.by_module.get(step.module, [])

    def list_owners_within_reach(self, place: StationName) -> list[Owner]:
        """The owners of the labware that a step can work on at a place. On a stack this is only the topmost
        piece."""
        owners = [owner for owner, _ in self.standing.get(place, ())]
        return owners[-1:] if self.state.bench.stations[place].spec.kind == "stack" else owners

    def _borrow(self, run: RunState, step: PlanStep, needs: Needs, who: Who, *, keeps: bool) -> None:
        """Lend the labware on which a step works to its run until the run ends. If the step changes it
        (``keeps``), the run owns it from now on."""
        owners, places = list_party(run), self.list_places(step, needs)
        found = [
            (owners.index(o), p) for p in places for o in self.list_owners_within_reach(p) if o in owners
        ]
        if not found:
            return
        rank, place = min(found, key=lambda pair: pair[0])
        there = self.standing[place]
        number = max(i for i, (owner, _) in enumerate(there) if owner == owners[rank])
        there[number] = run_owner(run.id), who
        if keeps:
            self.lent[run.id] = tuple(loan for loan in self.lent.get(run.id, ()) if loan[0] != place)
        elif rank:
            self._lend(run.id, place, owners[rank])

    def _lend(self, name: str, place: StationName, owner: Owner) -> None:
        self.lent[name] = (*self.lent.get(name, ()), (place, owner))

    def _find_owner_at(self, run: RunState, place: StationName) -> Owner:
        """The owner of the labware that a run carries away from a place."""
        there = [owner for owner, _ in self.standing.get(place, ())]
        return next((owner for owner in list_party(run) if owner in there), run_owner(run.id))

    def release(self, player: Player | None, run: RunState, who: Step, step: PlanStep, effects: Any) -> None:
        """End a step: other steps may use what it took and what it leaves. The last step of a player ends its
        run. ``player`` is None for a run that is not a player."""
        if self.busy.get(step.module) == who:
            del self.busy[step.module]
        for hands in self.reached.values():
            hands.pop(who, None)
        for arms in self.zones.values():
            arms.pop(who, None)
        for effect in effects:
            for place in effect.cleared:
                self._remove(run, place)
        after = compute_settings_after(effects)
        for variable, value in after.variables.items():
            self.values[step.module, variable] = value, who
        for setpoint in after.releases:
            self.setpoints.get((step.module, setpoint), {}).pop(who[0], None)
        for hold in self.state.runs.plan_of(run).holds:
            if hold.last == who[1]:
                self.held.get(hold.module, {}).pop(who[0], None)
        if player is not None:
            player.steps[who[1]] = DONE
            if all(status in SETTLED for status in player.steps):
                self._leave(player.name)

    def _remove(self, run: RunState, place: StationName) -> None:
        there, mine = self.standing.get(place, []), list_party(run)
        for owner in mine:
            found = next((item for item in there if item[0] == owner), None)
            if found is not None:
                there.remove(found)
                return

    def _leave(self, name: str) -> None:
        """End a run: it releases all that it held, and gives back what was lent to it."""
        mine = run_owner(RunId(name))
        for place, lender in self.lent.pop(name, ()):
            there = self.standing.get(place, [])
            number = next((i for i, (owner, _) in enumerate(there) if owner == mine), None)
            if number is not None:
                there[number] = lender, NOBODY
        for holders in self.held.values():
            holders.pop(name, None)
        for setters in self.setpoints.values():
            setters.pop(name, None)
        for key, (value, by) in list(self.values.items()):
            if by[0] == name:
                self.values[key] = value, NOBODY


class StepScene:
    """The scene as a store for the checks of one step (see ``core.algebra``). Each check returns the run or
    step in the way; ``NOBODY`` if no run could make way."""

    def __init__(self, scene: Scene, player: Player, step: PlanStep) -> None:
        self.scene, self.player, self.step = scene, player, step
        self.stations = scene.state.bench.stations
        self._arriving: dict[StationName, int] = {}
        self._leaving: dict[StationName, int] = {}

    def stock(self, what: Carrying, stack: StationName) -> Who | None:
        there = self.scene.standing.get(stack)
        if there:
            return there[-1][1]
        number = self._leaving[stack] = self._leaving.get(stack, 0) + 1
        left = len(self.stations[stack].stock) - self.scene.drawn.get(stack, 0)
        return None if left >= number else NOBODY

    def check_presence(self, what: Carrying, place: StationName) -> Who | None:
        there = self.scene.standing.get(place, [])
        number = self._leaving.get(place, 0) + 1
        if place == what.emptied:
            self._leaving[place] = number
        within = there[-number:] if self.stations[place].spec.kind == "stack" else there
        if sum(owner in self.player.party for owner, _ in within) >= number:
            return None
        return NOBODY  # it is not known when it will stand there

    def check_fits(self, what: Carrying) -> Who | None:
        return None

    def check_hand(self, what: Carrying) -> Who | None:
        hand = name_hand(self.step.module)
        there = self.scene.standing.get(hand) if what.source != hand else None
        return there[-1][1] if there else None

    def check_entry(self, what: Carrying, place: StationName) -> Who | None:
        spec = self.stations[place].spec
        if not spec.module or spec.stands_apart:
            return None
        if spec.module in self.scene.busy:
            return self.scene.busy[spec.module]
        for variable, wanted in spec.access.items():
            value, by = self.scene.values.get((spec.module, variable), (None, NOBODY))
            if not is_same(value, wanted):
                return by
        if spec.claim:
            return self.scene.find_holder(self.player, spec.module)
        return self.scene.find_keeper(self.player, spec.module) if spec.access else None

    def check_room(self, what: Effect, place: StationName) -> Who | None:
        station = self.stations[place]
        self._arriving[place] = self._arriving.get(place, 0) + 1
        if station.spec.kind == "waste":
            return NOBODY if station.count + self._arriving[place] > station.spec.capacity else None
        there = self.scene.standing.get(place, [])
        taken = len(station.stock) - self.scene.drawn.get(place, 0) + len(there)
        if station.spec.capacity - taken >= self._arriving[place]:
            return None
        return there[0][1] if there else NOBODY

    def check_labware(self, needs: Needs) -> Who | None:
        places = self.scene.list_places(self.step, needs)
        there = [owner for place in places for owner in self.scene.list_owners_within_reach(place)]
        return None if any(owner in self.player.party for owner in there) else NOBODY

    def check_value(self, requires: Requires) -> Who | None:
        if requires.of != "module":
            return None
        value, by = self.scene.values.get((self.step.module, requires.variable), (None, NOBODY))
        return None if is_same(value, requires.value) else by

    def check_setpoint(self, claims: Claims) -> Who | None:
        holders = self.scene.setpoints.get((self.step.module, claims.setpoint), {})
        for name, (value, at) in holders.items():
            if name != self.player.name and (value is None or value != claims.value):
                return name, at
        return None

    def check_amount(self, consumes: Consumes) -> Who | None:
        return None
