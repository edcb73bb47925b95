"""What is past its date is not used: the device of this bench reads the date on the pack that it opens, and
is spoilt by an old one. People refill with packs of which some are old."""

from __future__ import annotations

import asyncio

import pytest

from labos.core import expiry, rules
from labos.core.days import day_of
from labos.core.decide.stock import Replenish
from labos.core.ids import ModuleName
from labos.core.resources import Level, Lot
from labos.core.state import LabState
from labos.node import Consumes, Node, World, action
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from labos.testing.loop import BASE_NS
from tests.simulation.corners import Corner

A_DAY_NS = 24 * 3600 * 10**9
PACK = 2
"""Doses of each pack."""


class Gluer(Node):
    """Opens one pack after the other; old glue blocks its nozzle."""

    driver = "gluer"
    models = ("gluer",)
    levels = {"glue": 100}

    async def connect(self) -> None:
        assert self.setup.world is not None
        self.world: World = self.setup.world

    @action(Consumes("glue", 1), duration_s=60)
    async def glue(self) -> None:
        """Glue something."""
        used = sum(motion.facts["amount"] for motion in self.world.motions("use"))
        self.world.use(self.setup.name, "glue", 1)
        packs = [motion.facts["date"] for motion in self.world.motions("bring")]
        date = packs[int(used) // PACK]
        today = day_of(BASE_NS + int(asyncio.get_running_loop().time() * 1e9))
        if date and date < today:
            self.world.crash(self.setup.name, self.setup.name, f"takes glue of {date} on {today}")
        await asyncio.sleep(60)


CORNER = Corner(
    """
labos: 1
name: corner
modules:
  - {name: gluer, driver: gluer}
""",
    Gluer,
)
GLUES = CORNER.run("glues", "gluer.glue")
OLD, GOOD, NONE = day_of(BASE_NS - 2 * A_DAY_NS), day_of(BASE_NS + 90 * A_DAY_NS), ""
DATES = (NONE, GOOD, OLD, GOOD)
"""Of the packs, from the first that is used to the last."""


class Stocked(SimulatedLab):
    """The packs that a person put in, as they are and as they are told."""

    async def _set_up(self) -> None:
        await super()._set_up()
        assert self.kernel is not None
        module = ModuleName("corner/gluer")
        self.world.supply("gluer", "glue", -(self.world.find_level("gluer", "glue") or 0.0))
        for number, date in enumerate(DATES):
            self.world.work("ada", "bring", date=date)
            self.world.supply("gluer", "glue", PACK)
            fresh = Replenish(module, "glue", PACK, f"lot {number}", date, instead=not number)
            await self.kernel.execute(fresh, "ada")


def run_gluing(seed: int, rates: FaultRates = QUIET) -> tuple[LabState, list[str], int]:
    """The log, what crashed, and how often something was glued."""
    lab = Stocked(CORNER.stand, seed, rates)
    try:
        jobs = [Job(f"j{number}", "ada", (GLUES,)) for number in range(7)]
        state = lab.run_for(jobs, 4 * 3600.0)
        return state, [m.facts["what"] for m in lab.world.crashes()], len(lab.world.motions("use"))
    finally:
        lab.close()


@pytest.mark.parametrize("rates", [QUIET, STORMY], ids=["quiet", "stormy"])
def test_an_old_pack_keeps_runs_waiting_and_the_nozzle_clean(rates: FaultRates) -> None:
    for seed in range(3):
        _, crashed, doses = run_gluing(seed, rates)
        assert crashed == []
        assert doses == 2 * PACK, f"seed {seed}"


def test_without_the_rule_old_glue_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rules, "check_in_date", lambda state, run, step, now: None)
    for seed in range(3):
        assert any(f"takes glue of {OLD}" in what for what in run_gluing(seed)[1]), f"seed {seed}"


def test_where_the_youngest_pack_is_looked_at_first_old_glue_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switched off: that what is used comes from the oldest packs first."""
    real = expiry.find_first_expired

    def youngest_first(level: Level, amount: float, today: str) -> Lot | None:
        return real(Level(level.level, level.capacity, level.lots[::-1]), amount, today)

    monkeypatch.setattr(expiry, "find_first_expired", youngest_first)
    assert any("takes glue of" in what for seed in range(3) for what in run_gluing(seed)[1])
