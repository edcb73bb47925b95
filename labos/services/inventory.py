"""The remaining material on the bench and its lots, and the resource that will be used up first if all goes
as planned.

The runs that have not ended are simulated in the order in which they would continue: each step takes its
nominal duration and starts when its module is free. Real labs are slower, but the run that finds too little
is the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import msgspec

from labos.core.effects import list_carried
from labos.core.ids import ModuleName, RunId, StationName, split_level_key
from labos.core.runs import SETTLED, RunState, list_statuses
from labos.core.state import LabState
from labos.core.wells import well_key
from labos.planning.timetable import make_timetable

ENOUGH_RUNS = 500
"""At most so many runs are simulated; for later ones there is no forecast."""


class LotLeft(msgspec.Struct, frozen=True):
    """The rest of a lot; ``expired`` on the day of the query."""

    lot: str
    left: float
    expires: str = ""
    expired: bool = False


class Shortfall(msgspec.Struct, frozen=True):
    """The first run that finds too little, and when (UTC ns; by nominal durations)."""

    run: RunId
    workflow: str
    step: str
    at: int


class ResourceLeft(msgspec.Struct, frozen=True):
    """``promised`` is the amount that all runs that have not ended will still use up."""

    module: ModuleName
    resource: str
    level: float
    capacity: float
    unit: str
    lots: tuple[LotLeft, ...]
    promised: float
    runs_out: Shortfall | None = None


class Contents(msgspec.Struct, frozen=True):
    """A number of pieces of one type and lot, on top of each other."""

    type: str
    lot: str
    count: int


class StackLeft(msgspec.Struct, frozen=True):
    """A stack's pieces without ids, top to bottom; ``promised`` as for a resource."""

    station: StationName
    count: int
    capacity: int
    contents: tuple[Contents, ...]
    promised: int
    known: bool
    runs_out: Shortfall | None = None


class WasteLeft(msgspec.Struct, frozen=True):
    """The room in a waste; ``promised`` is the number of pieces that all runs that have not ended will still
    discard."""

    station: StationName
    room: int
    capacity: int
    promised: int
    runs_out: Shortfall | None = None


class Inventory(msgspec.Struct, frozen=True):
    resources: tuple[ResourceLeft, ...]
    stacks: tuple[StackLeft, ...]
    runs_looked_at: int
    wastes: tuple[WasteLeft, ...] = ()


class Ahead(msgspec.Struct, frozen=True):
    """The future of a run: when each of its remaining steps would start (UTC ns, by index), and its uses in
    order of time: the step's key, the time, the material and the amount."""

    run: RunState
    starts: dict[int, int]
    uses: list[tuple[str, int, str, float]]


def count_inventory(state: LabState, now: int, today: str) -> Inventory:
    """The remaining material at ``now`` (UTC ns); ``today`` is the date by which lots expire."""
    needs = _Needs()
    left: dict[str, float] = {name: level.level for name, level in state.resources.levels.items()}
    for place, station in state.bench.stations.items():
        if station.spec.kind == "stack" and station.known:
            left[f"stack:{place}"] = len(station.stock)
        elif station.spec.kind == "waste":
            left[f"waste:{place}"] = station.spec.capacity - station.count
    looked_at = 0
    for found in list_runs_ahead(state, now):
        looked_at += 1
        for step, at, name, amount in found.uses:
            needs.promised[name] = needs.promised.get(name, 0.0) + amount
            if name in left and name not in needs.short and needs.promised[name] > left[name]:
                needs.short[name] = Shortfall(found.run.id, found.run.workflow, step, at)
    return Inventory(
        tuple(_list_resources(state, today, needs)),
        tuple(_list_stacks(state, needs)),
        looked_at,
        tuple(_list_wastes(state, needs)),
    )


class _Needs(msgspec.Struct):
    """What runs will still use, and the first run that finds too little, by material."""

    promised: dict[str, float] = {}
    short: dict[str, Shortfall] = {}

    def look_up(self, name: str) -> tuple[float, Shortfall | None]:
        return self.promised.get(name, 0.0), self.short.get(name)


def _list_resources(state: LabState, today: str, needs: _Needs) -> Iterator[ResourceLeft]:
    modules = list(dict.fromkeys(split_level_key(name)[0] for name in state.resources.levels))
    place = {module: at for at, module in enumerate(modules)}

    def order(name: str) -> tuple[int, ...]:
        module, resource = split_level_key(name)
        return (place[module], *well_key(resource))

    for name in sorted(state.resources.levels, key=order):
        level = state.resources.levels[name]
        module, resource = split_level_key(name)
        spec = state.modules.by_name.get(ModuleName(module))
        lots = tuple(
            LotLeft(lot.name, lot.left, lot.expires, bool(lot.expires) and lot.expires < today)
            for lot in level.lots
        )
        unit = spec.spec.units.get(resource, "") if spec is not None else ""
        figures = (level.level, level.capacity, unit, lots, *needs.look_up(name))
        yield ResourceLeft(ModuleName(module), resource, *figures)


def _list_stacks(state: LabState, needs: _Needs) -> Iterator[StackLeft]:
    for place, station in state.bench.stations.items():
        if station.spec.kind != "stack":
            continue
        pieces = zip(reversed(station.stock), reversed(station.lots), strict=True)
        contents = tuple(Contents(*kind, len(list(same))) for kind, same in groupby(pieces))
        wanted, out = needs.look_up(f"stack:{place}")
        figures = (len(station.stock), station.spec.capacity, contents, int(wanted), station.known, out)
        yield StackLeft(place, *figures)


def _list_wastes(state: LabState, needs: _Needs) -> Iterator[WasteLeft]:
    for place, station in state.bench.stations.items():
        if station.spec.kind == "waste":
            capacity = station.spec.capacity
            wanted, out = needs.look_up(f"waste:{place}")
            yield WasteLeft(place, capacity - station.count, capacity, int(wanted), out)


def list_runs_ahead(state: LabState, now: int) -> Iterator[Ahead]:
    """The runs that have not ended, in the order in which they would continue, with what they will use."""
    free: dict[ModuleName, float] = {}
    queued = sorted(state.runs.queued.values(), key=lambda run: (-run.priority, run.position))
    for run in [*state.runs.active.values(), *queued][:ENOUGH_RUNS]:
        plan = state.runs.plan_of(run)
        table = make_timetable(plan)
        steps = list_statuses(plan, run)
        left = [i for i, status in enumerate(steps) if status not in SETTLED]
        begun_s = min((table.slots[i].start_s for i in left), default=0.0)
        # The whole run is delayed until each of its modules is free.
        shift_s = max(
            (free.get(plan.steps[i].module, 0.0) - (table.slots[i].start_s - begun_s) for i in left),
            default=0.0,
        )
        shift_s = max(shift_s, 0.0)
        uses: list[tuple[str, int, str, float]] = []
        starts: dict[int, int] = {}
        for index in left:
            step, slot = plan.steps[index], table.slots[index]
            end_s = shift_s + slot.end_s - begun_s
            if step.exclusive:
                free[step.module] = max(free.get(step.module, 0.0), end_s)
            at = starts[index] = now + int((shift_s + slot.start_s - begun_s) * 1e9 / state.lab.pace)
            for used, module, resource, amount in state.runs.plans[run.plan].uses_up:
                if used == index:
                    uses.append((step.key, at, f"{module}:{resource}", amount))
            for what in list_carried(step.effects):
                if what.stock:
                    uses.append((step.key, at, f"stack:{what.stock}", 1))
                if _is_waste(state, what.filled):
                    uses.append((step.key, at, f"waste:{what.filled}", 1))
        yield Ahead(run, starts, sorted(uses, key=lambda use: use[1]))


def _is_waste(state: LabState, place: StationName) -> bool:
    station = state.bench.stations.get(place)
    return station is not None and station.spec.kind == "waste"


def list_shortfalls(found: Inventory) -> list[tuple[str, Shortfall]]:
    """The shortages, the earliest first."""
    named = [(f"{r.module}:{r.resource}", r.runs_out) for r in found.resources]
    named += [(str(stack.station), stack.runs_out) for stack in found.stacks]
    named += [(str(waste.station), waste.runs_out) for waste in found.wastes]
    return sorted(((name, out) for name, out in named if out is not None), key=lambda pair: pair[1].at)
