"""Where the time went, held against labs that know it better: their own account of every mishap."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.services.losses import LossAccount, Losses, sum_losses
from labos.testing.lab import SimulatedLab, make_cancellers
from labos.testing.loop import BASE_NS
from tests.simulation.labour import MISHAPS, SECOND, Day, Witnessed, beside
from tests.simulation.test_whole import STILL_S, WEEK_S, weather
from tests.simulation.whole import FITS, cancels, mix, stand

TOLERANCE_S = 0.5
"""So much may be between what devices know and what the log does, over a day; the account is kept to the
nanosecond."""


def adds_up(found: Losses) -> None:
    """In every scope the minutes add up, and agree with the clock that measures them another way."""
    twh = found.twh
    for each in [found.lab, *found.workcells.values(), *found.experiments.values(), *found.runs.values()]:
        assert each.span_ns == each.at_work_ns + each.lost_ns
        assert each.clock_ns == each.at_work_ns + sum(loss.on_clock_ns for loss in each.losses)
        known = {"run": twh.runs, "experiment": twh.experiments, "workcell": twh.workcells}
        clock = twh.lab if each.kind == "lab" else known[each.kind][each.name]
        assert each.clock_ns == clock.clock_ns, (each.kind, each.name)


def list_charged(found: LossAccount) -> dict[object, float]:
    return {loss.cause: loss.lost_ns / SECOND for loss in found.losses}


def compare(seed: int) -> Counter[str]:
    """A day with one run and its mishaps: each cause is charged with what it really cost."""
    day = Day(seed)
    lab = Witnessed(seed, day)
    try:
        lab.live(day.run())
        found = sum_losses(lab.store.records)
        adds_up(found)
        truth, told = lab.truth(), list_charged(found.runs["R1"])
        wrong = {
            cause: (truth.get(cause, 0.0), told.get(cause, 0.0))
            for cause in {**truth, **told}
            if abs(truth.get(cause, 0.0) - told.get(cause, 0.0)) > TOLERANCE_S
        }
        assert not wrong, f"seed {seed}, {day.before}: {wrong}"
        return Counter(day.before.values())
    finally:
        lab.close()


@pytest.mark.slow
def test_every_mishap_is_charged_with_what_it_cost() -> None:
    total = Counter[str]()
    for seed in range(4):
        total += compare(seed)
    print(dict(total))
    assert set(total) == set(MISHAPS)


def test_the_lab_is_at_work_while_one_of_its_devices_is() -> None:
    for seed in range(2):
        lab = Witnessed(seed, Day(seed, without=("paused", "hands", "no kernel")))
        try:
            lab.live(lab.day.run(), beside(4))
            found = sum_losses(lab.store.records)
            adds_up(found)
            assert found.lab.at_work_ns / SECOND == pytest.approx(lab.is_working(), abs=2.0), f"seed {seed}"
            assert found.runs["R1"].lost_ns > found.lab.lost_ns > 0, "what one run lost, another used"
            assert found.runs["R2"].lost_ns < SECOND
        finally:
            lab.close()


class Watched(SimulatedLab):
    """Remembers when each process was away (seconds of virtual time)."""

    def _start_node(self, name: str) -> None:
        before = len(self.processes)
        super()._start_node(name)
        if len(self.processes) > before:
            self._watch(name)

    def _start_kernel(self, *machine: str) -> None:
        super()._start_kernel(*machine)
        self._watch("kernel")

    def _watch(self, name: str) -> None:
        spells = self.away.setdefault(name, [])
        if spells:
            spells[-1][1] = self.loop.time()
        self.processes[-1].on_death.append(lambda: spells.append([self.loop.time(), float("inf")]))

    @property
    def away(self) -> dict[str, list[list[float]]]:
        return self.__dict__.setdefault("_away", {})


def soundly_charged(seed: int) -> Counter[str]:
    """The whole bench under one seed: the minutes add up, no module is charged with minutes in which its
    node was there, and none of LabOS' own is charged without its kernel's death."""
    rates, doomed, mended = weather(seed)
    jobs = mix(seed)
    asked = cancels(seed, jobs)
    lab = Watched(
        stand(), seed, rates, doomed=doomed, mended=mended, still_s=STILL_S, meddles=make_cancellers(asked)
    )
    lab.refills, lab.late = True, 0.7
    for place, grip in FITS.items():
        for kind in ("plate96", "pcr96"):
            lab.world.fit(place, kind, grip)
    try:
        lab.run_for(jobs, WEEK_S)
        found = sum_losses(lab.store.records)
        adds_up(found)
        tally = Counter[str]()
        for spell in found.intervals:
            since, until = ((at - BASE_NS) / SECOND for at in (spell.since, spell.until))
            cause = spell.cause
            tally[f"{cause.kind} {cause.what}"] += spell.run == ""
            if cause.what == "node gone":
                away = lab.away[cause.module]
                assert any(down <= since + 1 and until <= up + 120 for down, up in away), (seed, spell)
            if cause.what == "no kernel":
                assert any(since <= up and down <= until for down, up in lab.away["kernel"]), (seed, spell)
            if cause.what == "unknown action":
                assert any(down <= since + 1 for down, _ in lab.away.get(cause.module, [])), (seed, spell)
        return tally
    finally:
        lab.close()


@pytest.mark.slow
def test_on_the_whole_bench_nobody_is_charged_for_others() -> None:
    total = Counter[str]()
    for seed in (0, 6):
        total += soundly_charged(seed)
    print(dict(total))
    assert total["error node gone"] > 0


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_a_hundred_days() -> None:
    total, days = Counter[str](), Counter[str]()
    for seed in range(100):
        days += compare(seed)
        total += soundly_charged(seed)
    print(f"mishaps {dict(days)}; on the whole bench {dict(total)}")
