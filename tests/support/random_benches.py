"""Random benches: a workcell with stations of every kind, labware of everybody on it, and one step that may
or may not be possible there.

A bench is made of events, so it is one that a log can have led to; only how it came to be so is left out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence

import msgspec

from labos.core.effects import (
    AnyEffect,
    Claims,
    Move,
    Needs,
    Releases,
    Relid,
    Requires,
    Sets,
    Take,
    Unlid,
    list_places,
)
from labos.core.fold import evolve
from labos.core.ids import (
    NOBODY,
    SHARED,
    ModuleName,
    Owner,
    RunId,
    StationName,
    run_owner,
    user_owner,
)
from labos.core.labware import (
    LabwareChanged,
    LabwarePlaced,
    LabwareUncertain,
    StationDeclared,
    StationLoaded,
)
from labos.core.model import PlanStep, StationSpec, Workcell
from labos.core.modules import SetpointClaimed, VariableSet
from labos.core.registry import Event
from labos.core.state import LabState, encode_picture, from_picture
from tests.support.bench import Driver, full, hold, module, plan, station, step, workcell

MINE, OTHERS, USERS = run_owner(RunId("R1")), run_owner(RunId("R2")), user_owner("ada")
PLATES, LIDS = ("plate", "tall"), ("lid",)
BENCHES_A_CELL = 50
"""So many benches are made of one workcell."""


def _hotel(name: str, shelves: int, owner: str = "") -> list[StationSpec]:
    hotel, at = StationName(full(name)), ModuleName(full(owner))
    each = [StationName(f"{hotel}.{number + 1}") for number in range(shelves)]
    return [
        StationSpec(hotel, "hotel", at, shelves),
        *(StationSpec(shelf, "hotel", at, hotel=hotel) for shelf in each),
    ]


def random_cell(rng: random.Random) -> Workcell:
    """Two arms, of which one has a hand; a device with a deck behind a lid, an oven that rests shut, a camera
    and a heater; nests, stacks, hotels with shelves and without, an exchange and a waste."""
    some = rng.choice
    modules = [
        module("arm"),
        module("arm2"),
        module("dev", variables={"lid": "open"}, rest={"lid": "open"}),
        module("oven", variables={"door": "shut"}, rest={"door": "shut"}),
        module("cam"),
        module("heat"),
    ]
    stations = [
        station("stack", "stack", rng.randint(2, 5)),
        station("pile", "stack", rng.randint(2, 4)),
        station("oven.mag", "stack", 3, access={"door": "open"}),
        station("a", accepts=some([(), (), PLATES, ("tall",)])),
        station("b", rotation=some([0, 0, 90])),
        station("c", capacity=2),
        station("lids", some(["nest", "stack"]), rng.randint(1, 2), accepts=some([(), LIDS])),
        station("regrip", a1=some([None, None, 0, 90])),
        station("port", "exchange"),
        station("hall", "hotel", rng.randint(1, 3)),
        *_hotel("tower", 2, some(["", "oven"])),
        station("trash", "waste", rng.randint(1, 4)),
        station("arm.gripper", "gripper"),
        *([station("arm2.gripper", "gripper")] if rng.random() < 0.5 else []),
        station("dev.n1", "deck", claim=True, access={"lid": "open"}),
        station("dev.n2", "deck", 2, claim=True, access={"lid": "open"}),
        station("oven.nest", claim=True, access={"door": "open"}),
        station("cam.nest", claim=rng.random() < 0.5),
        station("heat.n", "deck"),
    ]
    # What an arm was never taught is found by the dry run alone: it was taught all of them.
    arm = ModuleName(full("arm"))
    grips = {full("b"): some([(), ("wide",)]), full("port"): some([(), ("wide",)])}
    return workcell(
        modules, [msgspec.structs.replace(spec, reach={arm: grips.get(spec.name, ())}) for spec in stations]
    )


class RandomBench:
    """A bench with a run R1 that is about to start step 0, and a run R2 beside it. ``alone``: no labware of
    others is on it, and nothing is in doubt."""

    def __init__(self, rng: random.Random, blank: bytes, cell: Workcell, *, alone: bool = False) -> None:
        self.rng, self.cell, self.alone = rng, cell, alone
        self.state: LabState = from_picture(blank)
        self.specs = {spec.name: spec for spec in cell.stations}
        self.names = [spec.name for spec in cell.places]
        self._furnish()

    def write(self, event: Event) -> None:
        evolve(self.state, event, self.state.position + 1, self.state.recorded_at)

    # -- what stands on it -------------------------------------------------------------------

    def _furnish(self) -> None:
        rng = self.rng
        for name in self.names:
            spec = self.specs[name]
            if rng.random() < 0.02 and not self.alone:
                continue  # nobody ever said what stands there
            stock: tuple[str, ...] = ()
            if spec.kind == "stack" and name != full("lids") and rng.random() < 0.7:
                stock = ("plate+lid",) * rng.randint(1, 2) if rng.random() < 0.3 else ()
                stock = (stock or ("plate",) * rng.randint(1, 2))[: spec.capacity]
            elif spec.kind == "waste":
                stock = ("",) * rng.choice([0, 0, rng.randint(0, spec.capacity)])
            self.write(StationDeclared(name, stock))
            if spec.kind == "stack" and stock and len(stock) < spec.capacity and rng.random() < 0.2:
                self.write(StationLoaded(name, "tall", 1, "L2"))
        for _ in range(rng.randint(1, 10)):
            self._place()
        for owner, variable, values in (("dev", "lid", ("open", "shut")), ("oven", "door", ("shut", "open"))):
            if rng.random() < 0.4:
                by = self._some_run() if not self.alone else "R1"
                self.write(VariableSet(ModuleName(full(owner)), variable, rng.choice(values), by))
        if rng.random() < 0.3 and not self.alone:
            self.write(SetpointClaimed(ModuleName(full("heat")), "t", rng.choice([37, 42]), self._some_run()))
        if rng.random() < 0.08 and not self.alone:
            self._lose()

    def _some_run(self) -> str:
        return self.rng.choice(["R1", "R2"])

    def _owner(self) -> Owner:
        if self.alone:
            return MINE
        return self.rng.choice([MINE, MINE, MINE, OTHERS, OTHERS, USERS, SHARED, NOBODY])

    def _place(self) -> None:
        bench, rng = self.state.bench, self.rng
        free = [
            name
            for name in self.names
            if self.specs[name].kind != "waste"
            and not bench.stations[name].full
            and bench.stations[name].known
        ]
        if not free:
            return
        place, name, owner = rng.choice(free), bench.next_id, self._owner()
        if self.specs[place].kind == "gripper" and rng.random() < 0.7:
            return
        kind = "lid" if place == full("lids") or rng.random() < 0.1 else rng.choice(PLATES)
        if not self.specs[place].admits(kind):
            return
        self.write(LabwarePlaced(name, "", kind, place, owner))
        if kind != "lid" and rng.random() < 0.3:
            self.write(LabwarePlaced(bench.next_id, "", "lid", place, owner, on=name))
        if rng.random() < 0.2:
            self.write(LabwareChanged(name, "", "sealed", rng.choice([True, False])))

    def _lose(self) -> None:
        bench = self.state.bench
        known = [item for item in bench.labware.values() if item.station and not item.lid]
        if known:
            item = self.rng.choice(known)
            places = (item.station, self.rng.choice(self.names))
            self.write(LabwareUncertain(item.id, "", tuple(dict.fromkeys(places)), "nobody looked"))

    # -- what is to be done ------------------------------------------------------------------

    def as_planned(self, name: StationName) -> StationName:
        return self.specs[name].hotel or name

    def _source(self) -> StationName:
        """Mostly a place where something stands."""
        bench, rng = self.state.bench, self.rng
        full_ = [item.station for item in bench.labware.values() if item.station and item.owner != OTHERS]
        name = rng.choice(full_) if full_ and rng.random() < 0.85 else rng.choice(self.names)
        return self.as_planned(name)

    def _target(self) -> StationName:
        return self.as_planned(self.rng.choice(self.names))

    def _via(self) -> StationName:
        return StationName(full("regrip")) if self.rng.random() < 0.15 else StationName("")

    def start_carrying(self) -> AnyEffect:
        """An effect that carries labware, mostly from where there is some. What it goes from and to differ:
        a plan where they do not is refused."""
        rng, bench = self.rng, self.state.bench
        while True:
            what = rng.choice([Move, Move, Move, Move, Unlid, Relid, Take])
            source, target, via = self._source(), self._target(), self._via()
            if what is Take:
                source = StationName(full(rng.choice(["stack", "stack", "pile", "oven.mag"])))
            elif what is Unlid:
                bearing = [item.station for item in bench.labware.values() if item.lid and item.station]
                source = self.as_planned(rng.choice(bearing)) if bearing and rng.random() < 0.8 else source
                target = StationName(full("lids")) if rng.random() < 0.6 else target
            elif what is Relid:
                lids = [i.station for i in bench.labware.values() if i.type == "lid" and i.station]
                source = self.as_planned(rng.choice(lids)) if lids and rng.random() < 0.8 else source
                target = self._source()
            if source == target or (what is not Move and self.specs[target].kind == "waste"):
                continue
            if what is Take:
                return Take(source, target)
            grips = rng.choice([("", ""), ("", ""), ("", ""), ("narrow", "wide")])
            effect: AnyEffect = what(source, target, *grips, via=via)
            return effect

    def two_at_once(self) -> tuple[AnyEffect, AnyEffect]:
        """Two motions that do not meet where several pieces stand: which one is carried on depends on which
        motion is the first, and no effect says that."""
        while True:
            one, other = self.start_carrying(), self.start_carrying()
            both = {*list_places((one,))} & {*list_places((other,))}
            if not any(self.specs[place].kind == "stack" or self.specs[place].capacity > 1 for place in both):
                return one, other

    def step(self) -> PlanStep:
        """Mostly one motion; now and then with what it needs beside, two at once, or none."""
        rng = self.rng
        arm = rng.choice(["arm", "arm2"])
        chance = rng.random()
        if chance < 0.7:
            effects: Sequence[AnyEffect] = (self.start_carrying(),)
        elif chance < 0.8:
            effects = self.two_at_once()
        else:
            kinds: list[tuple[str, Callable[[], tuple[AnyEffect, ...]]]] = [
                ("dev", lambda: (Needs(), Requires("labware", "sealed", False))),
                ("dev", lambda: (Needs(), Sets("labware", "sealed", True))),
                ("cam", lambda: (Needs(self._source()),)),
                ("cam", lambda: (Needs(self._source()), Sets("labware", "sealed", True))),
                ("dev", lambda: (Needs(StationName(full("dev.n1"))), Sets("module", "lid", "shut"))),
                ("oven", lambda: (Requires("module", "door", "open"), Sets("module", "door", "shut"))),
                ("oven", lambda: (Sets("module", "door", "open"),)),
                ("heat", lambda: (Claims("t", 37),)),
                ("heat", lambda: (Releases("t"),)),
            ]
            arm, make = rng.choice(kinds)
            effects = make()
        return step(arm, *effects, recovers=rng.random() < 0.03)


class Blank:
    """A workcell in which R1 and R2 are under way, and nobody has said what stands anywhere. R2 may hold a
    module by its plan's word."""

    def __init__(self, rng: random.Random) -> None:
        self.cell = random_cell(rng)
        lab = Driver(self.cell, empty=False)
        lab.careful = False
        kept = (hold(rng.choice(["dev", "oven", "arm"]), 0, 1),) if rng.random() < 0.3 else ()
        lab.submit(plan(step("cam", exclusive=False), step("cam", exclusive=False), name="one"))
        lab.submit(plan(step("cam", exclusive=False), step("cam", exclusive=False), name="two", holds=kept))
        lab.step("R1", 0)
        lab.step("R2", 0)
        self.state = encode_picture(lab.state)

    def bench(self, rng: random.Random, *, alone: bool = False) -> RandomBench:
        return RandomBench(rng, self.state, self.cell, alone=alone)


def benches(first: int, count: int, *, alone: bool = False) -> Iterator[tuple[int, RandomBench]]:
    """Random benches, each with the seed that makes it again."""
    blank: Blank | None = None
    for seed in range(first, first + count):
        if blank is None or not seed % BENCHES_A_CELL:
            blank = Blank(random.Random(seed - seed % BENCHES_A_CELL))
        yield seed, blank.bench(random.Random(seed), alone=alone)
