"""What a place takes, and what an action asks of the plate and the module: room, what is buried, types,
seals, lids of cyclers, setpoints, devices at rest. Each rule is switched off once, and the bench crashes or
the log is wrong.
"""

from __future__ import annotations

import pytest

from labos.core import binding
from labos.core.bench import Labware
from labos.core.binding import list_party
from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from labos.core.runs import RunFailed, RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.node import Needs, Node, Place, Station, World, action
from labos.runtime import kernel
from labos.testing.faults import QUIET, STORMY
from labos.testing.lab import SimulatedLab, make_bare_scheduler
from labos_drivers._simulation import Instrument, Simulated
from tests.simulation.corners import Corner, jobs
from tests.simulation.whole import Oven
from tests.support.seeds import few_and_many

SEEDS = range(2)


class Mill(Node):
    """Its block takes the low plates of a cycler only: what is higher, it crushes."""

    driver = "mill"
    models = ("mill",)
    stations = (Station("block"),)

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world

    @action(Needs(), duration_s=5)
    async def mill(self) -> None:
        """Shake beads through the wells."""
        block = self.setup.place("block")
        for plate in self.world.at(block):
            if self.world.kind(plate) != "pcr96":
                self.world.crash(self.setup.name, block, "crushes a plate that is too high")
        self.world.work(self.setup.name, "mill", block)


class ShakerDevice(Simulated):
    """Two nests on one tray: while it shakes, nothing may reach for either."""

    async def shake(self, nest: str) -> None:
        with self.motion():
            before = self.world.last_motion()
            await self.take_time(120)
            for motion in self.world.motions(after=before):
                if motion.verb in ("grip", "release") and motion.place.startswith(f"{self.name}."):
                    self.world.crash(self.name, motion.place, "shakes under a hand")
            self.world.work(self.name, "shake", self.place(nest))


class Shaker(Instrument):
    """Shakes what stands on it; its nests are independent of each other."""

    driver = "shaker"
    models = ("shaker",)
    stations = (Station("near", claim=False), Station("far", claim=False))
    device: ShakerDevice

    async def connect(self) -> None:
        self.device = ShakerDevice(self.setup)

    @action(Needs(StationName("{nest}")), duration_s=120)
    async def shake(self, nest: Place) -> None:
        """Shake the plate at a nest, and whatever stands at the other."""
        await self.device.shake(nest)


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: right, model: sciclops}
  - {name: ur, model: ur5}
  - {name: ur2, model: ur5}
  - {name: sealer, model: A4S_sealer}
  - {name: ot2, model: ot2}
  - {name: cycler, model: biometra}
  - {name: oven, driver: oven}
  - {name: mill, driver: mill}
  - {name: shaker, driver: shaker}
stations:
  wc.a: {}
  wc.pile: {kind: stack, capacity: 4}
  wc.of_left: {kind: hotel, capacity: 10}
  wc.of_right: {kind: hotel, capacity: 10}
  wc.trash: {kind: waste}
  mill.block: {accepts: [pcr96]}
stock:
  left.tower1: {plate96: 20}
  right.tower1: {pcr96: 20}
""",
    Oven,
    Mill,
    Shaker,
)


def by_way_of(place: str, side: str, arm: str, *meanwhile: str) -> SubmitRun:
    """To where the plates of one side are kept: taking one from the other side shows there."""
    return CORNER.run(
        f"{side} by way of {place}",
        f"{side}.get_plate loc=tower1",
        f"{arm}.transfer source={side}.exchange target={place}",
        *meanwhile,
        f"{arm}.transfer source={place} target=wc.of_{side}",
    )


def make_baked(celsius: int, shelf: str, side: str, arm: str) -> SubmitRun:
    return CORNER.run(
        f"baked at {celsius}",
        f"{side}.get_plate loc=tower1",
        f"oven.warm celsius={celsius}",
        "oven.open_lid",
        f"{arm}.transfer source={side}.exchange target=oven.{shelf}",
        "oven.close_lid",
        f"oven.bake shelf=oven.{shelf} celsius={celsius}",
        "oven.open_lid",
        f"{arm}.transfer source=oven.{shelf} target=wc.trash",
        "oven.close_lid",
        "oven.let_go",
    )


def make_shaken(nest: str, side: str, arm: str) -> SubmitRun:
    return CORNER.run(
        f"shaken {nest}",
        f"{side}.get_plate loc=tower1",
        f"{arm}.transfer source={side}.exchange target=shaker.{nest}",
        f"shaker.shake nest=shaker.{nest}",
        f"{arm}.transfer source=shaker.{nest} target=wc.trash",
    )


LEFT_BEHIND = CORNER.run(
    "leave a sealed plate",
    "left.get_plate loc=tower1",
    "ur.transfer source=left.exchange target=sealer.default",
    "sealer.seal",
    "ur.transfer source=sealer.default target=wc.a",
)
DOSE = CORNER.run(
    "dose what stands there",
    "ur.transfer source=wc.a target=ot2.deck1",
    "ot2.run_protocol config_path=p.yaml",
    "ur.transfer source=ot2.deck1 target=wc.trash",
)
MILL = CORNER.run(
    "mill what stands there",
    "ur.transfer source=wc.a target=mill.block",
    "mill.mill",
    "ur.transfer source=mill.block target=wc.trash",
)
HASTY = CORNER.read(
    """
labos: 1
name: cycle before the lid is shut
steps:
  - {name: Get, module: left, action: get_plate, args: {loc: tower1}}
  - {name: In, module: ur, action: transfer, args: {source: left.exchange, target: cycler.default}}
  - {name: Cycle, module: cycler, action: run_program, args: {program_n: 3}, after: [In]}
  - {name: Shut, module: cycler, action: close_lid, after: [In]}
  - {name: Open, module: cycler, action: open_lid, after: [Cycle, Shut]}
  - {name: Out, module: ur, action: transfer, args: {source: cycler.default, target: wc.trash}, after: [Open]}
"""
)
"""The author forgot that cycling has to wait for the lid: the rule knows it."""

THROUGH_A = [by_way_of("wc.a", "left", "ur"), by_way_of("wc.a", "right", "ur2")] * 3
LATER = ("cycler.close_lid", "cycler.open_lid")
OVER_THE_PILE = [by_way_of("wc.pile", "left", "ur", *LATER), by_way_of("wc.pile", "right", "ur2")] * 3
IN_THE_OVEN = [make_baked(37, "left", "left", "ur"), make_baked(60, "right", "right", "ur2")] * 2
FOUR_HEATS = [*IN_THE_OVEN[:2], make_baked(38, "left", "left", "ur"), make_baked(61, "right", "right", "ur2")]
"""No two of these runs are equal, so they go by age."""

ON_THE_TRAY = [make_shaken("near", "left", "ur"), make_shaken("far", "right", "ur2")] * 3

ENDING = {
    "room": THROUGH_A,
    "pile": OVER_THE_PILE,
    "setpoint": IN_THE_OVEN,
    "setpoints": FOUR_HEATS,
    "lid": [HASTY] * 3,
    "rest": ON_THE_TRAY,
}
WAITING = {"seal": [LEFT_BEHIND, DOSE], "type": [LEFT_BEHIND, MILL]}
"""What cannot be done waits, for nothing on the bench would make it possible."""


@pytest.mark.parametrize("what", ENDING)
@few_and_many(1, 4)
def test_all_end_and_nothing_crashes(what: str, seeds: range) -> None:
    for seed in seeds:
        CORNER.live_through(ENDING[what], seed)


@pytest.mark.slow
def test_in_a_storm_too() -> None:
    for seed in SEEDS:
        CORNER.live_through([*THROUGH_A, *IN_THE_OVEN, HASTY], seed, STORMY)


@pytest.mark.parametrize("what", WAITING)
def test_what_must_not_be_done_waits_and_says_why(what: str) -> None:
    lab = SimulatedLab(CORNER.stand, 0, QUIET)
    try:
        state = lab.run_for(jobs(WAITING[what]), 3600.0)
        assert lab.differences(state) == []
        assert len(lab.done_jobs) == 1
        assert len(state.runs.active) + len(state.runs.queued) == 1
    finally:
        lab.close()


def without_room(monkeypatch: pytest.MonkeyPatch) -> None:
    real = binding.check_room

    def roomy(state: LabState, place: StationName) -> Wait | None:
        wait = real(state, place)
        return None if wait is not None and wait.code == "occupied" else wait

    monkeypatch.setattr(binding, "check_room", roomy)


def test_without_room_plates_are_put_on_plates(monkeypatch: pytest.MonkeyPatch) -> None:
    without_room(monkeypatch)
    monkeypatch.setattr(kernel, "find_broken_by", lambda state, events: "")
    for seed in SEEDS:
        crashes, _ = CORNER.run_anyhow(THROUGH_A, seed, plan_with=make_bare_scheduler)
        assert any("puts a plate on a plate" in crash for crash in crashes), f"seed {seed}"


def test_nor_would_such_a_batch_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    without_room(monkeypatch)
    lab = SimulatedLab(CORNER.stand, 0, QUIET, plan_with=make_bare_scheduler)
    try:
        lab.run_for(jobs(THROUGH_A), 300.0)
        assert lab.world.crashes() == []
        assert any("wc.a holds 2 of 1" in fault for kernel in lab.opened for fault in kernel.faults)
    finally:
        lab.close()


def test_with_two_hands_at_a_stack_nobody_knows_what_is_on_top(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding, "check_stack_alone", lambda state, place: None)
    found = (CORNER.run_anyhow(OVER_THE_PILE, seed)[1] for seed in range(6))
    assert any("wc.of_" in wrong for wrongs in found for wrong in wrongs)


def test_without_the_order_of_a_stack_anothers_plate_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def anywhere(state: LabState, run: RunState, place: StationName, _: object = ()) -> Labware | None:
        standing = [state.bench.labware[name] for name in state.bench.stations[place].labware]
        return next(
            (i for owner in list_party(run) for i in standing if i.owner == owner and not i.moving), None
        )

    monkeypatch.setattr(binding, "find_usable", anywhere)
    found = [CORNER.run_anyhow(OVER_THE_PILE, seed, plan_with=make_bare_scheduler)[1] for seed in SEEDS]
    assert all(any("wc.of_" in wrong for wrong in wrongs) for wrongs in found), found


def test_without_asking_for_seals_tips_go_into_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding.StartCheck, "check_value", lambda self, requires: None)
    monkeypatch.setattr("labos.planning.stuck._check_labware_ahead", lambda state, run: None)
    for seed in SEEDS:
        crashes, _ = CORNER.run_anyhow(WAITING["seal"], seed, plan_with=make_bare_scheduler)
        assert any("drives its tips into a seal" in crash for crash in crashes), f"seed {seed}"


def count_failed(seed: int) -> int:
    """How many of the hasty runs fail: a cycler refuses to cycle under an open lid."""
    lab = SimulatedLab(CORNER.stand, seed, QUIET)
    try:
        lab.run_for(jobs(ENDING["lid"]), 4 * 3600.0)
        return sum(record.head.type == RunFailed.TYPE for record in lab.store.records)
    finally:
        lab.close()


def test_a_cycler_waits_for_its_lid() -> None:
    assert [count_failed(seed) for seed in SEEDS] == [0] * len(SEEDS)


def test_without_asking_for_the_lid_the_cycler_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding.StartCheck, "check_value", lambda self, requires: None)
    assert all(count_failed(seed) for seed in SEEDS)


def test_without_types_a_plate_is_crushed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding, "check_accepts", lambda state, what, kind: None)
    for seed in SEEDS:
        crashes, _ = CORNER.run_anyhow(WAITING["type"], seed, plan_with=make_bare_scheduler)
        assert any("crushes a plate" in crash for crash in crashes), f"seed {seed}"


def test_without_setpoints_somebody_bakes_too_hot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binding.StartCheck, "check_setpoint", lambda self, claims: None)
    found = (CORNER.run_anyhow(FOUR_HEATS, seed, plan_with=make_bare_scheduler)[0] for seed in range(4))
    assert any("bakes at" in crash for crashes in found for crash in crashes)


def test_without_waiting_for_rest_a_tray_shakes_under_a_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    real = binding.check_reachable

    def any_time(state: LabState, run: RunState, place: StationName) -> Wait | None:
        wait = real(state, run, place)
        return None if wait is not None and wait.code == "module_busy" else wait

    monkeypatch.setattr(binding, "check_reachable", any_time)
    found = [CORNER.run_anyhow(ON_THE_TRAY, seed, plan_with=make_bare_scheduler)[0] for seed in SEEDS]
    assert all(any("shakes under a hand" in crash for crash in crashes) for crashes in found), found
