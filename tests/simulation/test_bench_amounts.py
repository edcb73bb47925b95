"""What a protocol uses up is counted before it starts: the robot plays it to its end, tip by tip, and never
finds an empty rack. Where the count is understated, it does.

The robot of this bench carries out the protocol that it is given, a Python program, and takes each tip out of
its racks when it picks it up: what LabOS read from the file is not known to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from labos.core.counts import Count, Counter
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ModuleName
from labos.core.state import LabState
from labos.spec import compile_workflow, parse_workflow
from labos.spec.tables import Descriptions
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from labos_drivers.ot2 import OT2
from labos_drivers.ot2.protocol import with_values
from labos_drivers.ot2.simulator import OT2Simulator
from labos_drivers.ot2.tips import count_used_tips
from labos_drivers.ot2.translate import translate
from tests.simulation.corners import Corner, jobs

RACKS = 96
FILES = {
    "loop.py": b"""
def run(protocol):
    pipette = protocol.load_instrument("p300_single_gen2", "left")
    for row in "ABCDE":
        for column in range(1, 9):
            pipette.pick_up_tip()
            pipette.transfer(10, row, column, new_tip="never")
            pipette.drop_tip()
""",
    "wells.py": b"""
def run(protocol):
    pipette = protocol.load_instrument("p20_multi_gen2", "left")
    for well in LABOS["destination_wells"]:
        pipette.pick_up_tip()
        pipette.drop_tip()
    pipette.transfer(10, 1, 2)
""",
    "mix.yaml": b"""
equipment:
  - {name: corning_96_wellplate_360ul_flat, location: '2', alias: dest}
  - {name: opentrons_96_tiprack_300ul, location: '1'}
  - {name: p300_multi_gen2, mount: left}
commands:
  - {source: 'dest:A1', destination: 'dest:[A2, A3, A4]', volume: 100}
  - {source: 'dest:A1', destination: payload.destination_wells, volume: 50, drop_tip: false}
""",
}
TIPS = {"loop.py": 40, "wells.py": 24, "mix.yaml": 32}
"""Counted by hand, with the two wells below."""
WELLS = ["A1", "B1"]


class Player(OT2Simulator):
    """Carries protocols out."""

    async def run_protocol(
        self,
        protocol: str,
        volumes: dict[str, list[float]],
        wells: list[str],
        drawn: dict[str, float],
        variables: dict[str, Any],
    ) -> dict[str, Any]:
        content = FILES[protocol]
        program = translate(protocol, content) if protocol.endswith(".yaml") else content
        names: dict[str, Any] = {}
        exec(compile(with_values(program, {"destination_wells": wells}), protocol, "exec"), names)
        with self.motion(drawn_in=True):
            names["run"](Robot(self))
            await self.take_time(60)
        return {"run": protocol, "status": "succeeded"}


class Robot:
    """The robot's own program, as far as these protocols go."""

    is_tiprack = True
    max_volume = 300

    def __init__(self, device: Player) -> None:
        self.device = device

    def load_instrument(self, name: str, mount: str) -> Hand:
        return Hand(self.device, 8 if "multi" in name else 1)

    def load_labware(self, name: str, slot: str) -> Robot:
        return self

    def wells(self) -> list[Robot]:
        return [self]

    def __getitem__(self, well: str) -> Robot:
        return self

    def comment(self, text: str) -> None: ...

    def bottom(self, height: float) -> None: ...

    def top(self) -> None: ...


class Hand:
    max_volume = 300
    min_volume = 1.0

    def __init__(self, device: Player, tips: int) -> None:
        self.device, self.tips = device, tips
        self.has_tip = False

    def pick_up_tip(self) -> None:
        self.device.world.use(self.device.name, "tips", self.tips)
        self.has_tip = True

    def drop_tip(self) -> None:
        self.has_tip = False

    def transfer(self, volume: float, source: Any, target: Any, new_tip: str = "once") -> None:
        if new_tip != "never":
            self.pick_up_tip()
            self.drop_tip()

    def aspirate(self, volume: float, where: Any) -> None: ...

    def dispense(self, volume: float, where: Any) -> None: ...

    def blow_out(self, where: Any) -> None: ...


class Playing(OT2):
    devices = (Player, *OT2.devices[1:])


class Bench(Corner):
    """A robot with one rack, and how its driver counts."""

    def __init__(self, counter: Counter) -> None:
        super().__init__(
            """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: ot2, model: ot2, resources: {tips: 96}}
stations:
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
""",
            Playing,
        )
        self.known = Descriptions(self.descriptions, {}, {"ot2": {"tips": counter}})

    def find_mixing(self, protocol: str) -> SubmitRun:
        text = f"""
labos: 1
name: mix
steps:
  - {{name: Get, module: left, action: get_plate, args: {{loc: tower1}}}}
  - {{name: In, module: ur, action: transfer, args: {{source: left.exchange, target: ot2.deck2}}}}
  - name: Mix
    module: ot2
    action: run_protocol
    args: {{config_path: {protocol}, destination_wells: [A1, B1]}}
  - {{name: Out, module: ur, action: transfer, args: {{source: ot2.deck2, target: wc.trash}}}}
"""
        compiled = compile_workflow(
            parse_workflow(text, "mix.yaml"),
            {},
            self.cell.workcell,
            self.known,
            files=FILES,
            bench=self.cell.bench,
        )
        assert compiled.findings == ()
        return SubmitRun(compiled.plan, "ada")

    def live(self, protocols: Sequence[str], seed: int) -> tuple[LabState, list[str], float]:
        """The log at the end, what crashed, and how many tips there really are."""
        lab = SimulatedLab(self.stand, seed, QUIET)
        try:
            state = lab.run_for(jobs([self.find_mixing(name) for name in protocols]), 4 * 3600.0)
            crashed = [motion.facts["what"] for motion in lab.world.crashes()]
            return state, crashed, lab.world.find_level("ot2", "tips") or 0.0
        finally:
            lab.close()


def find_left(state: LabState) -> float | None:
    return state.resources.find_left(ModuleName("corner/ot2"), "tips")


@pytest.mark.parametrize("protocol", FILES)
def test_what_the_robot_used_is_what_was_counted(protocol: str) -> None:
    state, crashed, really = Bench(count_used_tips).live([protocol], seed=0)
    assert crashed == []
    assert not state.runs.active
    assert RACKS - really == TIPS[protocol]
    assert find_left(state) == really


def test_who_would_run_dry_half_way_waits() -> None:
    for seed in range(3):
        state, crashed, really = Bench(count_used_tips).live(["loop.py", "mix.yaml", "loop.py"], seed)
        assert crashed == []
        assert len(state.runs.queued) == 1
        assert find_left(state) == really


def a_column(name: str, content: bytes, args: Any) -> Count:
    """Switched off: a column of tips stands for every protocol."""
    return Count(8)


def drop_loops(name: str, content: bytes, args: Any) -> Count:
    """Switched off: a loop counts once."""
    return Count(1 if name.endswith(".py") else 8)


@pytest.mark.parametrize("mutant", [a_column, drop_loops])
def test_an_understated_amount_lets_the_robot_run_dry(mutant: Callable[..., Count]) -> None:
    crashed = [Bench(mutant).live(["loop.py", "mix.yaml", "loop.py"], seed)[1] for seed in range(3)]
    assert all("runs out of tips" in what for what in crashed)
