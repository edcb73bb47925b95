"""A corner of a lab whose arm and sealer fail as they are told to, with a camera that sees it all."""

from __future__ import annotations

import asyncio
from typing import Annotated

from labos.core.decide.runs import SubmitRun
from labos.core.registry import Event, decode
from labos.node import Consumes, DeviceError, Move, Needs, Param, Place, Sets, Station, Take, action
from labos.spec import compile_workflow, parse_workcell, parse_workflow
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from labos_drivers._arm import SOURCE, TARGET, Arm
from labos_drivers._simulation import Instrument, Simulated
from tests.simulation.mixes import DESCRIPTIONS, NODES

HOW = ("well", "before", "half", "after", "silent before", "silent half", "silent after")
"""How an action fails: before it begins, half-way or when all is done; and whether it says so."""

How = Annotated[str, Param(choices=HOW)]


def fail(how: str, when: str) -> None:
    """Raises DeviceError if that is how the action fails."""
    if how == when:
        said = {"before": "none", "half": "partial", "after": "all"}[when]
        raise DeviceError(f"It failed {when}.", effects=said)  # type: ignore[arg-type]
    if how == f"silent {when}":
        raise DeviceError("It failed.")


class ClumsyArm(Arm):
    async def carry(self, source: str, target: str, how: str) -> None:
        with self.motion():
            fail(how, "before")
            await self.take_time(10)
            self.world.grip(self.name, self.place(source))
            await self.take_time(10)
            fail(how, "half")
            self.world.release(self.name, self.place(target))
            await self.take_time(10)
            fail(how, "after")


class Clumsy(Instrument):
    """An arm that fails as it is told to."""

    driver = "clumsy"
    models = ("clumsy",)
    manipulator = True
    stations = (Station("tower", kind="stack", capacity=9, claim=False), Station("gripper", kind="gripper"))
    device: ClumsyArm

    async def connect(self) -> None:
        self.device = ClumsyArm(self.setup)

    @action(Move(SOURCE, TARGET), duration_s=30)
    async def transfer(self, source: Place, target: Place, how: How = "well") -> None:
        """Carry a plate."""
        await self.device.carry(source, target, how)

    @action(Take(SOURCE, TARGET), duration_s=30)
    async def get(self, source: Place, target: Place, how: How = "well") -> None:
        """Take a plate off the tower."""
        await self.device.carry(source, target, how)


class Spoiling(Instrument):
    """A sealer that fails as it is told to."""

    driver = "spoiling"
    models = ("spoiling",)
    stations = (Station("default"),)
    levels = {"foil": 10}
    device: Simulated

    async def connect(self) -> None:
        self.device = Simulated(self.setup)

    @action(Needs(), Sets("labware", "sealed", True), Sets("module", "hot", True), Consumes("foil", 1))
    async def seal(self, how: How = "well") -> None:
        """Seal the plate in the nest."""
        fail(how, "before")
        self.device.world.work(self.device.name, "foil", self.device.place("default"))
        fail(how, "half")
        self.device.world.work(self.device.name, "seal", self.device.place("default"))
        fail(how, "after")


CELL = """
labos: 1
name: corner
modules:
  - {name: arm, model: clumsy}
  - {name: sealer, model: spoiling}
  - {name: camera, model: camera, config: {observes: [wc.a, wc.b, wc.c]}}
stations:
  wc.a: {kind: nest}
  wc.b: {kind: nest}
  wc.c: {kind: nest}
  wc.d: {kind: nest}
stock:
  wc.a: {plate96: 1}
  arm.tower: {plate96: 3}
  sealer.default: {plate96: 1}
"""

MORE: tuple[type[Instrument], ...] = (Clumsy, Spoiling)
WITH = DESCRIPTIONS | {node.driver: node.describe() for node in MORE}
PARSED = parse_workcell(CELL, WITH)
STAND = Stand(
    PARSED.workcell,
    tuple((s.station, s.labware, s.count) for s in PARSED.bench.stock),
    NODES | {node.driver: node for node in MORE},
)


def work(*steps: str, user: str = "ada") -> SubmitRun:
    """A run of steps, each written ``module.action key=value …``."""
    lines = ["labos: 1", "name: work", "steps:"]
    for number, step in enumerate(steps):
        what, *args = step.split(" ", 1)
        module, _, name = what.partition(".")
        given = ", ".join(arg.replace("=", ": ", 1) for arg in (args[0].split(", ") if args else ()))
        lines.append(f"  - {{name: s{number}, module: {module}, action: {name}, args: {{{given}}}}}")
    source = parse_workflow("\n".join(lines), "work.yaml")
    compiled = compile_workflow(source, {}, PARSED.workcell, WITH, simulate=True, bench=PARSED.bench)
    return SubmitRun(compiled.plan, user)


def job(run: SubmitRun, name: str = "j", after_s: float = 0.0) -> Job:
    return Job(name, run.user, (run,), after_s=after_s)


class Lonely(SimulatedLab):
    """A lab without people: what nobody sees stays open."""

    def __init__(self, seed: int = 0, *, kill: str = "", after_s: float = 0.0) -> None:
        super().__init__(STAND, seed, QUIET)
        self.kill, self.after_s = kill, after_s

    async def _act_as_person(self) -> None:
        if self.kill:
            await asyncio.sleep(self.after_s)
            for process in self.processes:
                if process.name == f"node:corner/{self.kill}" and process.alive:
                    process.kill()
        await asyncio.Event().wait()


def events(lab: SimulatedLab) -> list[Event]:
    return [decode(r.head.type, r.head.schema, r.payload) for r in lab.store.records]
