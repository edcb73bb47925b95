"""What the plan that keeps windows has start at a time is looked at when that time comes."""

from __future__ import annotations

import pytest

from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.player import FAR
from labos.planning.scheduler import Scheduler
from tests.benchmarks.league.cases import cases
from tests.benchmarks.league.play import Player


class Listening(Scheduler):
    """Notes for how many waits there is a planned start, and which of them would sleep beyond it."""

    def __init__(self) -> None:
        super().__init__()
        self.planned = 0
        self.beyond: list[tuple[str, int]] = []

    def check_start(
        self,
        state: LabState,
        run: RunState | None,
        step: int,
        now: int,
        *,
        only_asking: bool = False,
        at_once: bool = False,
    ) -> Wait | None:
        wait = super().check_start(state, run, step, now, only_asking=only_asking, at_once=at_once)
        if wait is not None and run is not None and wait.code == "reserved":
            begins = self.reservations.windows.find_planned_start(state, run, step, now)
            self.planned += now < begins < FAR
            if now < begins < FAR and (wait.until is None or wait.until > begins):
                self.beyond.append((run.id, step))
        return wait


@pytest.mark.slow
def test_nobody_sleeps_beyond_its_planned_start() -> None:
    """No event marks that time: who waits for somebody's reservation would miss the only time at which
    everybody keeps the windows."""
    case = next(case for case in cases() if case.name.startswith("48 windows"))
    made: list[Listening] = []

    def make() -> Listening:
        made.append(Listening())
        return made[-1]

    assert Player(case.cell, case.stock, make).play(case.works).breaches == 0
    assert sum(each.planned for each in made) > 0
    assert [each.beyond for each in made] == [[]] * len(made)
