"""Plates that stand in the incubator when their experiment was cancelled leave it for the trash."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

from labos.client import LabClient, RunResult
from labos.errors import LabosError

INTO, OUT = "Incubate/Into incubator", "Take out/Out of incubator"
LOOK_S, PATIENCE_S = 0.5, 600.0


def slots_left(plates: Iterable[tuple[int, RunResult, RunResult | None]]) -> list[int]:
    """Where plates still stand: each plate has a slot, the run that made it, and the one that read it if that
    was begun."""
    return [
        slot for slot, made, read in plates if _is_done(made, INTO) and not (read and _is_done(read, OUT))
    ]


def throw_away(
    lab: LabClient, experiment: str, user: str, workcell: str, flow: Path, slots: Iterable[int]
) -> list[RunResult]:
    """Throw plates of an experiment away that was cancelled. They are its user's when it is over; how the
    runs ended. Raises LabosError if it does not come to its end."""
    deadline = time.monotonic() + PATIENCE_S
    while any(alive["id"] == experiment for alive in lab.state()["experiments"]):
        if time.monotonic() > deadline:
            raise LabosError(
                f"{experiment} has not ended {PATIENCE_S:g} s after it was cancelled. "
                "Its plates stay in the incubator.",
                remedy="When it has ended, run throw_away.yaml for each slot (README).",
            )
        time.sleep(LOOK_S)
    runs = [lab.submit(flow, {"slot": slot}, user=user, workcell=workcell) for slot in slots]
    return [lab.wait(run) for run in runs]


def _is_done(run: RunResult, step: str) -> bool:
    return any(each.key == step and each.state == "done" for each in run.steps)
