"""A corner of a lab whose presses work only now and then, and whose ways out cross each other."""

from __future__ import annotations

import random
from typing import Any

from labos.core.decide.runs import SubmitRun
from labos.node import DeviceError, Needs, Station, action
from labos.spec import compile_workflow, parse_workflow
from labos_drivers._simulation import Instrument, Simulated
from tests.simulation.corners import Corner


class PressSimulator(Simulated):
    """Presses plates; now and then it jams, and whoever presses then without a reset breaks it."""

    def __init__(self, setup: Any) -> None:
        super().__init__(setup)
        self.jammed = False
        self.mood = random.Random(f"{setup.seed}/{setup.name}/mood")

    async def press(self) -> float:
        nest = self.place("nest")
        with self.motion():
            if not self.top(nest):
                self.world.crash(self.name, nest, "presses nothing")
            if self.jammed and self.config.get("jams"):
                self.world.crash(self.name, nest, "presses while it is jammed")
            await self.take_time(200)
            if self.mood.random() < float(self.config.get("fails", 0.5)):
                self.jammed = True
                raise DeviceError("The press did not close.", effects="none")
            self.world.work(self.name, "press", nest)
            return round(self.mood.random(), 3)

    def reset(self) -> None:
        super().reset()
        self.jammed = False


class Press(Instrument):
    """A press that works only now and then, and measures what it pressed."""

    driver = "press"
    models = ("press",)
    stations = (Station("nest"),)
    device: PressSimulator

    async def connect(self) -> None:
        self.device = PressSimulator(self.setup)

    @action(Needs(), duration_s=200)
    async def press(self) -> dict[str, float]:
        """Press the plate in the nest."""
        return {"force": await self.device.press()}


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: tower, model: sciclops}
  - {name: arm, model: ur5}
  - {name: p, model: press}
  - {name: q, model: press}
  - {name: r, model: press, config: {fails: 0.7, jams: true}}
stations:
  wc.trash: {kind: waste}
stock:
  tower.tower1: {plate96: 20}
""",
    Press,
)


def carry(name: str, source: str, target: str) -> str:
    return (
        f"- {{name: {name}, module: arm, action: transfer, args: {{source: {source}, target: {target}}}}}\n"
    )


GET = "- {name: get, module: tower, action: get_plate, args: {loc: tower1}}\n"


def run(name: str, steps: str, **payload: Any) -> SubmitRun:
    source = parse_workflow(f"labos: 1\nname: {name}\nsteps:\n{steps}", f"{name}.yaml")
    cell = CORNER.cell
    compiled = compile_workflow(
        source, payload, cell.workcell, CORNER.descriptions, simulate=True, bench=cell.bench
    )
    return SubmitRun(compiled.plan, "ada")


def make_sorted_out(here: str, there: str) -> SubmitRun:
    """Measured here: what is weak is thrown away, what is strong goes there first."""
    weak = "steps.press.result.force < 0.4"
    steps = GET + carry("in", "tower.exchange", f"{here}.nest")
    steps += (
        f"- {{name: press, module: {here}, action: press, retry: {{times: 20}}, expect: result.force >= 0}}\n"
    )
    for name, source, target, when in (
        ("weak", f"{here}.nest", "wc.trash", weak),
        ("over", f"{here}.nest", f"{there}.nest", f"not ({weak})"),
        ("lost", f"{there}.nest", "wc.trash", f"not ({weak})"),
    ):
        steps += carry(name, source, target).replace("}}\n", f"}}, when: {when}}}\n")
    return run(f"sorted {here}", steps)


def make_crossing(here: str, there: str) -> SubmitRun:
    """Pressed here; if that fails, pressed there, and thrown away in either case."""
    indented = "".join(
        f"      {line}\n"
        for line in (
            carry("over", f"{here}.nest", f"{there}.nest") + carry("lost", f"{there}.nest", "wc.trash")
        ).splitlines()
    )
    steps = GET + carry("in", "tower.exchange", f"{here}.nest")
    steps += f"- name: press\n  module: {here}\n  action: press\n  on_error:\n    run:\n{indented}"
    return run(f"crossing {here}", steps + carry("out", f"{here}.nest", "wc.trash"))
