"""A workcell as a rehearsal has it: who is at work, what stands where, and who holds what.

The rules are those by which steps start (``core.rules``), as far as they have to do with time and room:
modules, hands, stations, decks, doors, zones, setpoints and what plans hold.
"""

from __future__ import annotations

import heapq
from typing import Any

import msgspec

from labos.core.binding import same
from labos.core.effects import (
    AnyEffect,
    Claims,
    Move,
    Needs,
    Releases,
    Requires,
    Sets,
    Take,
    emptied,
    filled,
    hand_of,
)
from labos.core.ids import ModuleName, Owner, StationName, run_owner
from labos.core.model import PlanStep
from labos.core.rules import lab_ns
from labos.core.runs import DONE, SETTLED, RunState
from labos.core.state import LabState
from labos.core.waits import party
from labos.core.zones import zones_of
from labos.planning.floor import down
from labos.planning.player import FAR, NOBODY, Player, Who


class Scene:
    """A workcell at one time: what is in flight, what stands where, and who holds what."""

    def __init__(self, state: LabState, cell: str, now: int) -> None:
        self.state, self.cell, self.now = state, cell, now
        self.busy: dict[ModuleName, Who] = {}
        self.reached: dict[ModuleName, dict[Who, bool]] = {}
        self.zones: dict[str, dict[Who, ModuleName]] = {}
        self.standing: dict[StationName, list[tuple[Owner, Who]]] = {}
        self.held: dict[ModuleName, dict[str, int]] = {}
        self.values: dict[tuple[ModuleName, str], tuple[Any, Who]] = {}
        self.setpoints: dict[tuple[ModuleName, str], dict[str, tuple[Any, int]]] = {}
        self.flying: list[tuple[int, int, Who, PlanStep, tuple[AnyEffect, ...]]] = []
        self.inside = {str(name) for name in state.runs.active}
        bench = state.bench
        for place, station in bench.stations.items():
            for labware in station.labware if not station.spec.hotel else ():
                item = bench.labware[labware]
                self.standing.setdefault(place, []).append((item.owner, (_run_of(item.owner), -1)))
        for name in state.runs.holders:
            self.held[name] = {str(run): -1 for run in state.runs.holding(name)}
        for name, module in state.modules.by_name.items():
            if name.startswith(f"{cell}/"):
                for variable, value in module.variables.items():
                    self.values[name, variable] = value, (module.set_by.get(variable, ""), -1)
                for setpoint, now_set in module.setpoints.items():
                    holders = {str(run): (now_set.value, -1) for run in now_set.holders}
                    self.setpoints[name, setpoint] = holders
        for action in state.actions.open.values():
            run = state.runs.active.get(action.run)
            if run is None or not action.module.startswith(f"{cell}/"):
                continue
            step = state.runs.plan_of(run).steps[action.step]
            end = max(now, action.requested_at + lab_ns(state, step.duration_s))
            effects = tuple(_as_planned(state, effect) for effect in action.effects)
            end = FAR if action.status == "unknown" else end
            self.take(run, action.step, step, effects, end)

    def copy(self) -> Scene:
        other = Scene.__new__(Scene)
        other.state, other.cell, other.now = self.state, self.cell, self.now
        other.busy, other.values, other.flying = dict(self.busy), dict(self.values), list(self.flying)
        other.inside = set(self.inside)
        other.reached = {name: dict(who) for name, who in self.reached.items()}
        other.zones = {name: dict(who) for name, who in self.zones.items()}
        other.standing = {name: list(who) for name, who in self.standing.items()}
        other.held = {name: dict(who) for name, who in self.held.items()}
        other.setpoints = {name: dict(who) for name, who in self.setpoints.items()}
        return other

    def alone(self, run: RunState) -> Scene:
        """The same, if nobody else were there."""
        other, mine = self.copy(), (str(run.id), "")
        other.flying = [item for item in self.flying if item[2][0] in mine]
        other.busy = {name: who for name, who in self.busy.items() if who[0] in mine}
        other.reached = {n: {w: True for w in who if w[0] in mine} for n, who in self.reached.items()}
        other.zones = {n: {w: at for w, at in who.items() if w[0] in mine} for n, who in self.zones.items()}
        owners = party(run)
        other.standing = {n: [i for i in items if i[0] in owners] for n, items in self.standing.items()}
        other.held = {n: {w: at for w, at in who.items() if w in mine} for n, who in self.held.items()}
        other.setpoints = {
            n: {w: at for w, at in who.items() if w in mine} for n, who in self.setpoints.items()
        }
        for key, (value, by) in self.values.items():
            rest = self.state.modules.by_name[key[0]].spec.rest
            other.values[key] = (value if by[0] in mine else rest.get(key[1], value)), by
        return other

    # -- who is in the way -----------------------------------------------------------------------

    def in_the_way(self, player: Player, index: int) -> Who | None:
        """Who keeps a step from starting, by the rules; None if nobody does."""
        step = player.plan.steps[index]
        if down(self.state, step.module, recovered=step.recovers):
            return NOBODY
        if step.exclusive:
            found = self._not_free(player, step)
            if found is not None:
                return found
        for hold in player.plan.holds:
            if hold.first == index:
                holder = self._holder(player, hold.module)
                if holder is not None:
                    return holder
        arriving: dict[StationName, int] = {}
        for effect in step.effects:
            found = None
            if isinstance(effect, Move | Take):
                found = self._no_way(player, step, effect, arriving)
            elif isinstance(effect, Needs):
                found = None if self._has_labware(player, step, effect) else NOBODY
            elif isinstance(effect, Requires) and effect.of == "module":
                value, by = self.values.get((step.module, effect.variable), (None, NOBODY))
                found = None if same(value, effect.value) else by
            elif isinstance(effect, Claims):
                for holder_name, (value, at) in self.setpoints.get(
                    (step.module, effect.setpoint), {}
                ).items():
                    if holder_name != player.name and (value is None or value != effect.value):
                        found = (holder_name, at)
            if found is not None:
                return found
        return None

    def _has_labware(self, player: Player, step: PlanStep, effect: Needs) -> bool:
        places = [effect.station] if effect.station else self.state.bench.by_module.get(step.module, [])
        there = [owner for place in places for owner, _ in self.standing.get(place, ())]
        return any(owner in player.party for owner in there)

    def _not_free(self, player: Player, step: PlanStep) -> Who | None:
        if step.module in self.busy:
            return self.busy[step.module]
        holder = None if step.recovers else self._holder(player, step.module)
        if holder is not None:
            return holder
        reaching = self.reached.get(step.module)
        if reaching:
            return next(iter(reaching))
        for zone in zones_of(self.state, step.module, step.effects):
            for who, module in self.zones.get(zone, {}).items():
                if module != step.module:
                    return who
        return None

    def _holder(self, player: Player, name: ModuleName) -> Who | None:
        """Who holds a module against a player: by labware, by a plan's word, by a door or lid."""
        stations = self.state.bench.stations
        for place in self.state.bench.by_module.get(name, ()):
            if stations[place].spec.claim:
                for owner, by in self.standing.get(place, ()):
                    if owner not in player.party:
                        return by
        for holder, at in self.held.get(name, {}).items():
            if holder != player.name:
                return holder, at
        module = self.state.modules.by_name[name]
        for variable, rest in module.spec.rest.items():
            value, by = self.values.get((name, variable), (rest, NOBODY))
            if value != rest and by[0] in self.inside and by[0] != player.name:
                return by
        return None

    def _no_way(
        self, player: Player, step: PlanStep, effect: Move | Take, arriving: dict[StationName, int]
    ) -> Who | None:
        """Who keeps labware from being carried."""
        stations = self.state.bench.stations
        hand = hand_of(step.module)
        source = effect.source if isinstance(effect, Move) else effect.stack
        if isinstance(effect, Move) and not any(o in player.party for o, _ in self.standing.get(source, ())):
            return NOBODY  # nobody knows when something will stand there
        if hand in stations and self.standing.get(hand) and source != hand:
            return self.standing[hand][-1][1]
        target = filled(effect) if isinstance(effect, Move) else effect.target
        via = effect.via if isinstance(effect, Move) else StationName("")
        for place in (source, target):
            found = self._closed(player, place) if place in stations else None
            if found is not None:
                return found
        for place in (target, via):
            if not place or stations[place].spec.kind == "waste":
                continue
            there = self.standing.get(place, [])
            arriving[place] = arriving.get(place, 0) + 1
            room = stations[place].spec.capacity - len(stations[place].stock) - len(there)
            if room < arriving[place]:
                return there[0][1] if there else NOBODY
        return None

    def _closed(self, player: Player, place: StationName) -> Who | None:
        """Who keeps an arm from reaching into a station."""
        spec = self.state.bench.stations[place].spec
        if not spec.module or spec.stands_apart:
            return None
        if spec.module in self.busy:
            return self.busy[spec.module]
        for variable, wanted in spec.access.items():
            value, by = self.values.get((spec.module, variable), (None, NOBODY))
            if not same(value, wanted):
                return by
        return self._holder(player, spec.module) if spec.claim else None

    # -- what happens ------------------------------------------------------------------------------

    def take(
        self, run: RunState, index: int, step: PlanStep, effects: tuple[AnyEffect, ...], end: int
    ) -> None:
        """A step begins: it has from now on what it needs."""
        stations, who = self.state.bench.stations, (str(run.id), index)
        self.inside.add(who[0])
        if step.exclusive:
            self.busy[step.module] = who
            for zone in zones_of(self.state, step.module, effects):
                self.zones.setdefault(zone, {})[who] = step.module
        for effect in effects:
            if isinstance(effect, Move | Take):
                source = effect.source if isinstance(effect, Move) else effect.stack
                target = filled(effect) if isinstance(effect, Move) else effect.target
                via = effect.via if isinstance(effect, Move) else StationName("")
                owner = self._owner_at(run, source) if isinstance(effect, Move) else run_owner(run.id)
                for place in (source, target, via):
                    spec = stations[place].spec if place in stations else None
                    if spec is not None and spec.module and not spec.stands_apart:
                        self.reached.setdefault(spec.module, {})[who] = True
                for place in (target, via):
                    if place and stations[place].spec.kind != "waste":
                        self.standing.setdefault(place, []).append((owner, who))
            elif isinstance(effect, Claims):
                self.setpoints.setdefault((step.module, effect.setpoint), {})[who[0]] = effect.value, index
        for hold in self.state.runs.plan_of(run).holds:
            if hold.first == index:
                self.held.setdefault(hold.module, {})[who[0]] = index
        heapq.heappush(self.flying, (end, len(self.flying) + index, who, step, effects))

    def _owner_at(self, run: RunState, place: StationName) -> Owner:
        """Whose labware it is that a run carries away."""
        there = [owner for owner, _ in self.standing.get(place, ())]
        return next((owner for owner in party(run) if owner in there), run_owner(run.id))

    def let_go(self, player: Player | None, run: RunState, who: Who, step: PlanStep, effects: Any) -> None:
        """A step has ended: what it took and what it leaves is there for others."""
        if self.busy.get(step.module) == who:
            del self.busy[step.module]
        for hands in self.reached.values():
            hands.pop(who, None)
        for arms in self.zones.values():
            arms.pop(who, None)
        for effect in effects:
            if isinstance(effect, Move):
                self._remove(run, emptied(effect))
                if effect.via:
                    self._remove(run, effect.via)
            elif isinstance(effect, Sets) and effect.of == "module":
                self.values[step.module, effect.variable] = effect.value, who
            elif isinstance(effect, Releases):
                self.setpoints.get((step.module, effect.setpoint), {}).pop(who[0], None)
        for hold in self.state.runs.plan_of(run).holds:
            if hold.last == who[1]:
                self.held.get(hold.module, {}).pop(who[0], None)
        if player is not None:
            player.steps[who[1]] = DONE
            if all(status in SETTLED for status in player.steps):
                self._leave(player.name)

    def _remove(self, run: RunState, place: StationName) -> None:
        there, mine = self.standing.get(place, []), party(run)
        for owner in mine:
            found = next((item for item in there if item[0] == owner), None)
            if found is not None:
                there.remove(found)
                return

    def _leave(self, name: str) -> None:
        """The end of a run lets go of all that it held."""
        for holders in self.held.values():
            holders.pop(name, None)
        for setters in self.setpoints.values():
            setters.pop(name, None)
        for key, (value, by) in list(self.values.items()):
            if by[0] == name:
                self.values[key] = value, NOBODY


def _as_planned(state: LabState, effect: AnyEffect) -> AnyEffect:
    """An effect as its plan has it: hotels instead of their shelves."""
    bench = state.bench
    if isinstance(effect, Move):
        places = {name: bench.planned(getattr(effect, name)) for name in ("source", "target")}
        return msgspec.structs.replace(effect, **places)
    if isinstance(effect, Take):
        return msgspec.structs.replace(effect, target=bench.planned(effect.target))
    return effect


def _run_of(owner: str) -> str:
    """The run that owns labware; empty if none does."""
    return owner[4:] if owner.startswith("run:") else ""
