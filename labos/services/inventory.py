"""What is left on the bench, from which lots, and what runs out first if all goes as planned.

The runs that are alive are walked in the order in which they would go on: each takes its nominal
time, laid out on the modules as they come free. Real labs are slower; the run at which something
is used up is the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import msgspec

from labos.core.effects import list_carried
from labos.core.ids import ModuleName, RunId, StationName
from labos.core.runs import SETTLED, RunState, list_statuses
from labos.core.state import LabState
from labos.core.wells import well_key
from labos.planning.timetable import make_timetable

ENOUGH_RUNS = 500
"""Runs that are looked ahead to; beyond them nobody can say when."""


class LotLeft(msgspec.Struct, frozen=True):
    """What is left of a lot; ``expired`` on the day of the question."""

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
    """``promised`` is what all runs that are alive will still use up."""

    module: ModuleName
    resource: str
    level: float
    capacity: float
    unit: str
    lots: tuple[LotLeft, ...]
    promised: float
    runs_out: Shortfall | None = None


class Contents(msgspec.Struct, frozen=True):
    """So many pieces of a type and lot, one upon the other."""

    type: str
    lot: str
    count: int


class StackLeft(msgspec.Struct, frozen=True):
    """A stack's nameless pieces, top to bottom; ``promised`` as of a resource."""

    station: StationName
    count: int
    capacity: int
    contents: tuple[Contents, ...]
    promised: int
    known: bool
    runs_out: Shortfall | None = None


class WasteLeft(msgspec.Struct, frozen=True):
    """The room in a waste; ``promised`` is what all runs that are alive will still throw away."""

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
    """A run as it would go on: when each step that is left would start (UTC ns, by its index), and what
    it uses up in the order of that: the step's key, when, what, how much."""

    run: RunState
    starts: dict[int, int]
    uses: list[tuple[str, int, str, float]]


def count_inventory(state: LabState, now: int, today: str) -> Inventory:
    """What is left at ``now`` (UTC ns); ``today`` is the date by which lots expire."""
    promised: dict[str, float] = {}
    short: dict[str, Shortfall] = {}
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
            promised[name] = promised.get(name, 0.0) + amount
            if name in left and name not in short and promised[name] > left[name]:
                short[name] = Shortfall(found.run.id, found.run.workflow, step, at)
    return Inventory(
        tuple(_list_resources(state, today, promised, short)),
        tuple(_list_stacks(state, promised, short)),
        looked_at,
        tuple(_list_wastes(state, promised, short)),
    )


Promised = dict[str, float]
Shorts = dict[str, Shortfall]


def _list_resources(state: LabState, today: str, promised: Promised, short: Shorts) -> Iterator[ResourceLeft]:
    modules = list(dict.fromkeys(name.rpartition(":")[0] for name in state.resources.levels))
    place = {module: at for at, module in enumerate(modules)}

    def order(name: str) -> tuple[int, ...]:
        module, _, resource = name.rpartition(":")
        return (place[module], *well_key(resource))

    for name in sorted(state.resources.levels, key=order):
        level = state.resources.levels[name]
        module, _, resource = name.rpartition(":")
        spec = state.modules.by_name.get(ModuleName(module))
        lots = tuple(
            LotLeft(lot.name, lot.left, lot.expires, bool(lot.expires) and lot.expires < today)
            for lot in level.lots
        )
        unit = spec.spec.units.get(resource, "") if spec is not None else ""
        figures = (level.level, level.capacity, unit, lots, promised.get(name, 0.0), short.get(name))
        yield ResourceLeft(ModuleName(module), resource, *figures)


def _list_stacks(state: LabState, promised: Promised, short: Shorts) -> Iterator[StackLeft]:
    for place, station in state.bench.stations.items():
        if station.spec.kind != "stack":
            continue
        pieces = zip(reversed(station.stock), reversed(station.lots), strict=True)
        contents = tuple(Contents(*kind, len(list(same))) for kind, same in groupby(pieces))
        wanted = int(promised.get(f"stack:{place}", 0))
        out = short.get(f"stack:{place}")
        figures = (len(station.stock), station.spec.capacity, contents, wanted, station.known, out)
        yield StackLeft(place, *figures)


def _list_wastes(state: LabState, promised: Promised, short: Shorts) -> Iterator[WasteLeft]:
    for place, station in state.bench.stations.items():
        if station.spec.kind == "waste":
            capacity = station.spec.capacity
            wanted, out = int(promised.get(f"waste:{place}", 0)), short.get(f"waste:{place}")
            yield WasteLeft(place, capacity - station.count, capacity, wanted, out)


def list_runs_ahead(state: LabState, now: int) -> Iterator[Ahead]:
    """The runs that are alive in the order in which they would go on, with what they will use."""
    free: dict[ModuleName, float] = {}
    queued = sorted(state.runs.queued.values(), key=lambda run: (-run.priority, run.position))
    for run in [*state.runs.active.values(), *queued][:ENOUGH_RUNS]:
        plan = state.runs.plan_of(run)
        table = make_timetable(plan)
        steps = list_statuses(plan, run)
        left = [i for i, status in enumerate(steps) if status not in SETTLED]
        begun_s = min((table.slots[i].start_s for i in left), default=0.0)
        # The whole run is shifted until each of its modules has come free.
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
    """What runs out, the first first."""
    named = [(f"{r.module}:{r.resource}", r.runs_out) for r in found.resources]
    named += [(str(stack.station), stack.runs_out) for stack in found.stacks]
    named += [(str(waste.station), waste.runs_out) for waste in found.wastes]
    return sorted(((name, out) for name, out in named if out is not None), key=lambda pair: pair[1].at)
