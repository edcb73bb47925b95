"""A bench with everything: lids and their nests, towers, a pile, shelves, slots that a device assigns,
seals, grips, two arms over one corner, hands, doors, shelves behind one, setpoints, a person, and what
runs out.

A seed draws what is worked on it: between two and twelve applications of one or more runs.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import cache
from typing import Any

from msgspec.structs import replace

from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from labos.core.model import MAIN, Plan
from labos.node import Claims, Needs, Place, Releases, Requires, Sets, Station, action
from labos.testing.lab import Job, Stand
from labos_drivers._simulation import Gated, Instrument
from tests.simulation.corners import Corner


class OvenDevice(Gated):
    """Two shelves behind a door, at one temperature."""

    behind = ("left", "right")
    variable = "door"

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        if not any(m.device == self.name for m in self.world.motions("shut")):
            self.shut(*self.behind)

    def warm(self, celsius: int) -> None:
        self.world.work(self.name, "warm", celsius=celsius)

    async def bake(self, shelf: str, celsius: int) -> None:
        with self.motion():
            self.check_closed()
            await self.take_time(400)
            now = [m.facts["celsius"] for m in self.world.motions("warm") if m.device == self.name][-1]
            if now != celsius:
                self.world.crash(self.name, self.place(shelf), f"bakes at {now} instead of {celsius} °C")
            self.world.work(self.name, "bake", self.place(shelf))


class Oven(Instrument):
    """Keeps what stands on its shelves at the temperature that somebody claimed."""

    driver = "oven"
    models = ("oven",)
    stations = tuple(Station(name, access={"door": "open"}, claim=False) for name in OvenDevice.behind)
    variables = {"door": "closed"}
    rest = {"door": "closed"}
    device: OvenDevice

    async def connect(self) -> None:
        self.device = OvenDevice(self.setup)

    @action(Sets("module", "door", "open"), duration_s=20, safe_to_repeat=True)
    async def open_lid(self) -> None:
        """Open the door."""
        await self.device.open_gate()

    @action(Sets("module", "door", "closed"), duration_s=20, safe_to_repeat=True)
    async def close_lid(self) -> None:
        """Shut the door."""
        await self.device.close_gate()

    @action(Claims("temperature", "{celsius}"), duration_s=1, safe_to_repeat=True)
    async def warm(self, celsius: int) -> None:
        """Hold a temperature."""
        self.device.warm(celsius)

    @action(Needs(StationName("{shelf}")), Requires("module", "door", "closed"), duration_s=400)
    async def bake(self, shelf: Place, celsius: int) -> None:
        """Wait until the plate is as warm as the oven."""
        await self.device.bake(shelf, celsius)

    @action(Releases("temperature"), duration_s=1, safe_to_repeat=True)
    async def let_go(self) -> None:
        """Need the temperature no more."""


TAUGHT = {
    "pf400": "stacker.exchange wc.regrip wc.bridge sealer.default peeler.default ot2.deck1 cycler.default "
    "reader.default fridge.default incubator.exchange oven.left oven.right wc.pile wc.bench wc.shelf1 "
    "wc.shelf2 wc.table1 wc.table2 wc.output wc.trash",
    "ur": "wc.bridge camera.plate_station",
}


def _pose(place: str) -> str:
    zeros = "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"
    return f"{{first: {zeros}, step: {zeros}}}" if place in ("wc.output", "wc.shelves") else zeros


LOCATIONS = "".join(
    f"  {arm}:\n" + "".join(f"    {place}: {_pose(place)}\n" for place in places.split())
    for arm, places in TAUGHT.items()
)

BENCH = Corner(
    """
labos: 1
name: whole
modules:
  - {name: stacker, model: sciclops}
  - {name: pf400, model: pf400, regrip: wc.regrip}
  - {name: ur, model: ur5}
  - {name: operator, model: person, config: {alone: false}}
  - {name: ot2, model: ot2}
  - {name: sealer, model: A4S_sealer}
  - {name: peeler, model: brooks_xpeel}
  - {name: cycler, model: biometra}
  - {name: reader, model: hidex}
  - {name: fridge, model: hidex}
  - {name: incubator, model: liconic}
  - {name: oven, driver: oven}
  - {name: camera, model: camera}
stations:
  wc.regrip: {}
  wc.bench: {}
  wc.bridge: {kind: exchange, zone: middle}
  camera.plate_station: {zone: middle}
  sealer.default: {reach: {pf400: [wide]}}
  stacker.exchange: {reach: {pf400: [narrow]}}
  wc.shelf1: {kind: hotel, reach: {pf400: [narrow]}}
  wc.shelf2: {kind: hotel, reach: {pf400: [narrow]}}
  ot2.deck1: {reach: {pf400: [narrow]}}
  cycler.default: {reach: {pf400: [narrow]}}
  reader.default: {reach: {pf400: [wide]}}
  fridge.default: {kind: hotel}
  wc.lids: {accepts: [lid96]}
  wc.pile: {kind: stack, capacity: 3}
  wc.output: {shelves: 60}
  wc.table1: {kind: hotel}
  wc.table2: {kind: hotel}
  wc.trash: {kind: waste, capacity: 5}
  stacker.tower1: {accepts: [plate96]}
  stacker.tower2: {accepts: [pcr96]}
  stacker.lidnest1: {accepts: [lid96]}
  stacker.lidnest2: {accepts: [lid96]}
stock:
  stacker.tower1: {plate96+lid96: 5}
  stacker.tower2: {pcr96: 5}
locations:
"""
    + LOCATIONS,
    Oven,
)

FEW: dict[str, float] = {"foil": 3, "tape": 2, "tips": 24}
FITS = {"sealer.default": "wide", "ot2.deck1": "narrow", "cycler.default": "narrow", "reader.default": "wide"}
"""The only way in which fingers get round a plate there."""

MORTAL = (
    "pf400",
    "ur",
    "stacker",
    "ot2",
    "sealer",
    "peeler",
    "cycler",
    "reader",
    "fridge",
    "incubator",
    "oven",
    "camera",
)
WORKFLOWS = 120
"""How many routes there are to draw from."""


def stand() -> Stand:
    """The bench with next to nothing in its devices."""
    full = BENCH.stand
    modules = tuple(
        replace(m, levels={name: FEW.get(name, capacity) for name, capacity in m.levels.items()})
        for m in full.workcell.modules
    )
    return replace(full, workcell=replace(full.workcell, digest="whole", modules=modules))


class Way:
    """A plate's way over the bench, written step by step."""

    def __init__(self, rng: random.Random, place: str = "", *, lidded: bool = False) -> None:
        self.rng, self.steps, self.place = rng, list[str](), place
        self.lid, self.sealed = "", False
        self.before: list[str] = []
        self.behind: list[str] = []
        if not place:
            self._begin(lidded)

    def _begin(self, lidded: bool) -> None:
        self.steps.append(f"stacker.get_plate loc={'tower1' if lidded else 'tower2'}")
        self.place = "stacker.exchange"
        if lidded:
            self.lid = self.rng.choice(["lidnest1", "lidnest2"])
            self.steps.append(f"stacker.remove_lid source=exchange target={self.lid}")

    def to(self, target: str, arm: str = "pf400") -> None:
        """Carried to a place, after whatever opens the one it leaves and before what shuts it."""
        self.steps += self.before
        verb = "carry_plate" if arm == "operator" else "transfer"
        self.steps.append(f"{arm}.{verb} source={self.place} target={target}")
        self.steps += self.behind
        self.before, self.behind = [], []
        self.place = target

    def draw(self, legs: int) -> None:
        last = None
        for _ in range(legs):
            choices = [leg for leg in LEGS if leg is not last and self._may(leg)]
            last = self.rng.choice(choices)
            last(self)

    def _may(self, leg: Callable[[Way], None]) -> bool:
        if leg in (dose, bake, cycle) and self.sealed:
            return False
        return leg is not (seal if self.sealed else peel)

    def end(self, target: str) -> None:
        """The lid goes back on, and the plate away."""
        if self.lid:
            self.to("stacker.exchange")
            self.steps.append(f"stacker.replace_lid source={self.lid} target=exchange")
            self.lid = ""
        self.to(target)


def dose(way: Way) -> None:
    way.to("ot2.deck1")
    way.steps.append("ot2.run_protocol config_path=p.yaml")


def seal(way: Way) -> None:
    way.to("sealer.default")
    way.steps.append("sealer.seal time=3.0 temperature=175")
    way.sealed = True


def peel(way: Way) -> None:
    way.to("peeler.default")
    way.steps.append("peeler.peel")
    way.sealed = False


def cycle(way: Way) -> None:
    way.to("cycler.default")
    way.steps += ["cycler.close_lid", "cycler.run_program program_n=3", "cycler.open_lid"]


def read(way: Way) -> None:
    way.to("reader.default")
    way.steps += ["reader.close_lid", "reader.run_assay assay_name=od", "reader.open_lid"]


def chill(way: Way) -> None:
    """On a shelf behind a lid."""
    way.to("fridge.default")
    way.steps += ["fridge.close_lid", "fridge.open_lid"] * way.rng.randint(1, 2)


def take_picture(way: Way) -> None:
    """Over the bridge to the other arm's side, sometimes with a rest in its hand."""
    way.to("wc.bridge")
    if way.rng.random() < 0.4:
        way.steps += ["ur.pick source=wc.bridge", "ur.place target=camera.plate_station"]
    else:
        way.steps.append("ur.transfer source=wc.bridge target=camera.plate_station")
    way.steps.append("camera.take_picture file_name=a.jpg")
    way.steps.append("ur.transfer source=camera.plate_station target=wc.bridge")


def store(way: Way) -> None:
    way.to("incubator.exchange")
    way.steps.append("incubator.store")
    way.steps += ["reader.close_lid", "reader.open_lid"] * way.rng.randint(0, 1)
    way.steps.append("incubator.retrieve")


def bake(way: Way) -> None:
    shelf, celsius = way.rng.choice(OvenDevice.behind), way.rng.choice([37, 55])
    way.steps += [f"oven.warm celsius={celsius}", "oven.open_lid"]
    way.to(f"oven.{shelf}")
    way.steps += ["oven.close_lid", f"oven.bake shelf=oven.{shelf} celsius={celsius}"]
    way.before, way.behind = ["oven.open_lid"], ["oven.close_lid", "oven.let_go"]


def pile(way: Way) -> None:
    way.to("wc.pile")


def by_hand(way: Way) -> None:
    way.to("wc.bench", "operator")


LEGS = (dose, seal, peel, cycle, read, chill, take_picture, store, bake, pile, by_hand)


REACHED = [
    *("ot2.deck1", "sealer.default", "peeler.default", "cycler.default", "reader.default", "wc.bridge"),
    "fridge.default",
    *("incubator.exchange", "oven.left", "oven.right", "wc.pile", "wc.bench"),
]


def way_out(lid: str) -> list[str]:
    """From wherever a plate of a route stands into the waste, with its lid if it has one somewhere."""
    steps = ["cycler.open_lid", "reader.open_lid", "fridge.open_lid", "oven.open_lid", "incubator.retrieve"]
    steps += ["ur.place target=wc.bridge", "ur.transfer source=camera.plate_station target=wc.bridge"]
    target = "stacker.exchange" if lid else "wc.trash"
    steps += [f"pf400.transfer source={place} target={target}" for place in REACHED]
    if lid:
        steps.append(f"stacker.replace_lid source={lid} target=exchange")
    return [*steps, "pf400.transfer source=stacker.exchange target=wc.trash", "oven.close_lid"]


@cache
def route(number: int) -> SubmitRun:
    """One run: out of a tower, two to five legs, to the waste or to where plates wait."""
    rng = random.Random(f"route/{number}")
    way = Way(rng, lidded=rng.random() < 0.5)
    way.draw(rng.randint(1, 4))
    lid = way.lid
    way.end(rng.choice(["wc.trash", "wc.trash", "wc.output"]))
    return BENCH.run(f"route {number}", *way.steps, on_cancel=way_out(lid))


@cache
def make_parted(number: int) -> tuple[SubmitRun, SubmitRun]:
    """Two runs of one user: what the first leaves on the table, the second takes."""
    rng = random.Random(f"parted/{number}")
    first = Way(rng)
    first.draw(1)
    table = rng.choice(["wc.table1", "wc.table2"])
    first.end(table)
    second = Way(rng, table)
    second.sealed = first.sealed
    second.draw(1)
    second.end("wc.trash")
    return BENCH.run(f"first {number}", *first.steps), BENCH.run(f"second {number}", *second.steps)


def shelf_of(number: int) -> str:
    """Where an experiment parks."""
    return f"wc.shelf{1 + number % 2}"


@cache
def make_closing(shelf: str) -> Plan:
    return BENCH.run(f"closing {shelf}", f"pf400.transfer source={shelf} target=wc.trash").plan


@cache
def make_parking_runs(number: int) -> tuple[SubmitRun, ...]:
    """The runs of an experiment that parks its plate between them; the last one may be missing."""
    rng = random.Random(f"parking/{number}")
    first = Way(rng)
    first.draw(1)
    first.end(shelf_of(number))
    runs = [BENCH.run(f"parks {number}", *first.steps)]
    for again in range(rng.randint(0, 2)):
        way = Way(rng, shelf_of(number))
        way.sealed = first.sealed
        way.draw(1)
        first.sealed = way.sealed
        way.end(shelf_of(number))
        runs.append(BENCH.run(f"fetches {number}.{again}", *way.steps))
    return tuple(runs)


def cancels(seed: int, jobs: list[Job]) -> dict[str, int]:
    """Which routes are cancelled, and with which step begun."""
    rng = random.Random(f"cancels/{seed}")
    routes = [job for job in jobs if job.runs[0].plan.workflow.startswith("route") and rng.random() < 0.3]
    steps = {job.name: sum(step.part == MAIN for step in job.runs[0].plan.steps) for job in routes}
    return {f"{name}/0": rng.randrange(count) for name, count in steps.items()}


def mix(seed: int) -> list[Job]:
    """Applications of two users, submitted over the first hour."""
    rng = random.Random(f"whole/{seed}")
    jobs: list[Job] = []
    for number in range(rng.choice((2, 3, 4, 5, 6, 8, 12))):
        user, after = rng.choice(["ada", "bo"]), rng.uniform(0, 3600)
        kind, which = rng.random(), rng.randrange(WORKFLOWS)
        name, experiment = f"j{number}", None
        if kind < 0.6:
            runs: tuple[SubmitRun, ...] = (route(which),)
        elif kind < 0.75:
            runs = make_parted(which)
        else:
            runs = make_parking_runs(which)
            shelf = shelf_of(which)
            parks = (StationName(f"whole/{shelf}"),)
            experiment = StartExperiment("parking", user, make_closing(shelf), parking=parks)
        runs = tuple(replace(run, user=user) for run in runs)
        jobs.append(Job(name, user, runs, experiment, after_s=after))
    return jobs
