"""A plate of everybody's on a scale, which several runs weigh, carry about or throw away: nobody is inside
for ever, and nothing is weighed that does not stand there."""

from __future__ import annotations

import random

import pytest

from labos.core.decide.runs import SubmitRun
from labos.core.state import LabState
from labos.node import Needs, Node, Station, World, action
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.corners import Corner

STILL_S = 3 * 3600.0
"""If nothing has happened for so long, nothing will."""
SEEDS = range(4)


class Scale(Node):
    """Notes whether a plate stood on it."""

    driver = "scale"
    models = ("scale",)
    stations = (Station("pan"),)

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world

    @action(Needs(), duration_s=20)
    async def weigh(self) -> None:
        """Weigh the plate on the pan."""
        pan = self.setup.place("pan")
        if not self.world.at(pan):
            self.world.crash(self.setup.name, pan, "weighs nothing")
        self.world.work(self.setup.name, "weigh", pan)

    @action(duration_s=60)
    async def calibrate(self) -> None:
        """Do something that needs no plate."""


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: left, model: sciclops}
  - {name: ur, model: ur5}
  - {name: scale, driver: scale}
  - {name: other, driver: scale}
stations:
  wc.a: {}
  wc.gate: {}
  wc.trash: {kind: waste}
stock:
  left.tower1: {plate96: 20}
  scale.pan: {plate96: 1}
  other.pan: {plate96: 1}
""",
    Scale,
)

OWN = ("left.get_plate loc=tower1", "ur.transfer source=left.exchange target=wc.gate")
AWAY = "ur.transfer source=wc.gate target=wc.trash"
WAYS: dict[str, tuple[str, ...]] = {
    "weighs": ("scale.weigh", "other.calibrate", "scale.weigh"),
    "weighs both": ("scale.weigh", "other.weigh", "scale.weigh"),
    "weighs both the other way": ("other.weigh", "scale.weigh", "other.weigh"),
    "weighs beside its own": (*OWN, "scale.weigh", AWAY),
    "throws away": (*OWN, "ur.transfer source=scale.pan target=wc.trash", AWAY),
    "carries about": (
        "ur.transfer source=other.pan target=wc.a",
        *OWN,
        "ur.transfer source=wc.a target=other.pan",
        "other.weigh",
        AWAY,
    ),
}


def run(name: str, user: str) -> SubmitRun:
    return CORNER.run(name, *WAYS[name], user=user)


def jobs(seed: int) -> list[Job]:
    """Three to six runs of two users, within the first minutes."""
    rng = random.Random(f"lent/{seed}")
    names = [rng.choice(list(WAYS)) for _ in range(rng.randint(3, 6))]
    users = ["ada", "bo"]
    return [
        Job(f"j{n}", user, (run(name, user),), after_s=rng.uniform(0, 240))
        for n, name in enumerate(names)
        for user in [rng.choice(users)]
    ]


def run_lab(seed: int, rates: FaultRates) -> LabState:
    """A lab until nothing goes on any more; nothing crashed, and the log knows where everything stands."""
    lab = SimulatedLab(CORNER.stand, seed, rates, still_s=STILL_S)
    try:
        state = lab.run_for(jobs(seed), 24 * 3600.0)
        assert lab.world.crashes() == [], f"seed {seed}"
        assert lab.differences(state) == [], f"seed {seed}"
        return state
    finally:
        lab.close()


@pytest.mark.parametrize(
    ("rates", "seeds"),
    [
        pytest.param(QUIET, SEEDS, id="quiet"),
        pytest.param(STORMY, SEEDS, id="stormy", marks=pytest.mark.slow),
        pytest.param(QUIET, range(200), id="quiet-many", marks=pytest.mark.full),
        pytest.param(STORMY, range(200), id="stormy-many", marks=pytest.mark.full),
    ],
)
def test_nobody_is_inside_for_ever(rates: FaultRates, seeds: range) -> None:
    for seed in seeds:
        assert not run_lab(seed, rates).runs.active, f"seed {seed}"


def test_who_does_not_look_at_what_runs_need_leaves_somebody_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.planning.paths._list_needs", lambda *_: ())
    assert any(run_lab(seed, QUIET).runs.active for seed in range(8))
