"""Whole labs with clocks running: reservations keep windows that would be breached without them."""

from __future__ import annotations

from collections import Counter

import pytest

from labos.core.decide.runs import SubmitRun
from labos.core.registry import decode
from labos.core.rules import Wait
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.reservations import Reservations
from labos.planning.safety import Safety
from labos.planning.scheduler import Scheduler
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import Job, SimulatedLab
from tests.simulation.mixes import hurried, stand

TWO_DAYS_S = 2 * 24 * 3600.0


class _Careless(Reservations):
    """Leaves no room for anybody."""

    def against(self, state: LabState, run: RunState, step: int, now: int, safety: Safety) -> Wait | None:
        return None


def careless() -> Scheduler:
    """Planning with reservations switched off; deadlines still decide who goes first."""
    scheduler = Scheduler()
    scheduler.reservations = _Careless()
    return scheduler


class Account(Counter[str]):
    """Events by type."""


def live_through(jobs: list[Job], seed: int, rates: FaultRates = QUIET, plan_with: type = Scheduler) -> Account:
    """One seed to its end; the bench and the log agree in every plate."""
    lab = SimulatedLab(stand(), seed, rates, plan_with=plan_with)
    try:
        state = lab.run(jobs, limit_s=TWO_DAYS_S)
        assert lab.differences(state) == [], f"seed {seed}"
        assert not state.runs.active
        assert not state.runs.queued
        assert not state.runs.windowed
        return Account(record.head.type for record in lab.store.records)
    finally:
        lab.close()
