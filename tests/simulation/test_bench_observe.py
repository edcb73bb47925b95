"""What failed actions did to the bench, held against the bench; and who finds lost labware."""

from __future__ import annotations

from typing import Any

import pytest

from labos.core.actions import ActionUnknown
from labos.core.decide import actions
from labos.core.decide.observation import Sight
from labos.core.ids import StationName, local
from labos.core.interventions import InterventionResolved
from labos.core.labware import StationObserved
from labos.core.state import LabState
from labos.runtime.reconcile import Reconciler
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.simulation.seen import HOW, STAND, Lonely, events, job, work

LATER = 2 * 3600.0
CARRY = "arm.transfer source=wc.a, target=wc.b"
GET = "arm.get source=arm.tower, target=wc.c"
MOTIONS = {
    "move": (GET, "arm.transfer source=wc.c, target=wc.b"),
    "take": ("arm.get source=arm.tower, target=wc.b",),
}
NAMELESS = ("wc.a", "sealer.default")
"""Where plates stand that came off no stack: which is which nobody can tell."""


def live_through(motion: str, how: str) -> list[str]:
    """A motion that fails in some way, then another run with the same arm; where bench and log differ."""
    lab = SimulatedLab(STAND, 1, QUIET)
    try:
        *before, last = MOTIONS[motion]
        failing = work(*before, f"{last}, how={how!r}")
        state = lab.run(
            [job(failing), job(work("arm.get source=arm.tower, target=wc.d"), "k", LATER)], limit_s=86400.0
        )
        return [line for line in lab.differences(state) if not line.startswith(NAMELESS)]
    finally:
        lab.close()


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("motion", MOTIONS)
def test_the_log_knows_where_a_failed_motion_left_labware(motion: str, how: str) -> None:
    assert live_through(motion, how) == []


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_log_that_takes_silence_for_nothing_done_is_wrong(
    motion: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mutant: a failure that says nothing counts as one that moved nothing."""
    true = actions.list_effect_events

    def careless(state: LabState, action: Any, done: str, why: str, result: object = None) -> Any:
        return true(state, action, "all" if done == "all" else "none", why)

    monkeypatch.setattr(actions, "list_effect_events", careless)
    monkeypatch.setattr(Reconciler, "on_reopened", lambda self: None)
    assert live_through(motion, "silent after") != []
    assert live_through(motion, "half") != []


@pytest.mark.parametrize("how", HOW)
def test_variables_and_consumables_after_a_failure(how: str) -> None:
    lab = SimulatedLab(STAND, 1, QUIET)
    try:
        state = lab.run_for([job(work(f"sealer.seal how={how!r}"))], 3600.0)
        said = how if how in ("before", "after") else "well" if how == "well" else "unknown"
        wanted = {"well": True, "after": True, "before": False, "unknown": None}[said]
        assert bool(lab.world.motions("seal")) == (how in ("well", "after", "silent after"))
        sealer = next(m for n, m in state.modules.by_name.items() if local(n) == "sealer")
        assert sealer.values.get("hot", False) is wanted
        foil = next(level for name, level in state.resources.levels.items() if name.endswith("foil"))
        assert foil.level == (10 if how == "before" else 9), "of what is not known all counts as used"
        standing = [i for i in state.bench.labware.values() if local(i.station) == "sealer.default"]
        for item in standing:
            assert item.variables.get("sealed", False) is wanted
    finally:
        lab.close()


def kill_in_motion(after_s: float) -> tuple[LabState, Lonely]:
    """The arm's node dies in mid-motion, and nobody is there but the sensors."""
    lab = Lonely(kill="arm", after_s=after_s)
    lab.run_for([job(work(CARRY, "arm.transfer source=wc.b, target=wc.c"))], 3600.0)
    return lab.fold_log(), lab


@pytest.mark.parametrize("after_s", [1.0, 5.0, 13.0, 17.0, 25.0, 28.0])
def test_sensors_find_what_an_arm_that_died_was_carrying(after_s: float) -> None:
    state, lab = kill_in_motion(after_s)
    try:
        unknown = [e for e in events(lab) if isinstance(e, ActionUnknown)]
        assert unknown, "it died in mid-motion"
        assert [e for e in events(lab) if isinstance(e, StationObserved)]
        (plate,) = [i for i in state.bench.labware.values() if local(i.station) != "sealer.default"]
        if lab.world.at("hand:arm"):
            assert local(plate.station) == "arm.gripper"
            assert [q.kind for q in state.interventions.open.values()] == ["unknown_action"]
        else:
            assert "j" in lab.done_jobs, lab.report()
            assert local(plate.station) == "wc.c"
            assert [e.choice for e in events(lab) if isinstance(e, InterventionResolved)] == ["withdrawn"]
            assert len(lab.world.motions("grip")) == 2, "nothing was carried twice"
        assert lab.world.crashes() == []
    finally:
        lab.close()


async def _never_start(self: Reconciler) -> None:
    """Observe nothing."""


def test_a_lab_that_does_not_look_waits_for_a_person(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: without the ladder the same lab hangs until somebody comes."""
    monkeypatch.setattr(Reconciler, "start", _never_start)
    state, lab = kill_in_motion(25.0)
    try:
        assert "j" not in lab.done_jobs
        assert [q.kind for q in state.interventions.open.values()] == ["unknown_action"]
    finally:
        lab.close()


def test_a_lab_that_does_not_narrow_waits_for_a_person_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: a place seen empty stays a possible one."""
    monkeypatch.setattr(Sight, "add_empty", lambda self, place: None)
    monkeypatch.setattr(Sight, "add_standing", lambda self, labware, place: None)
    _, lab = kill_in_motion(25.0)
    try:
        assert "j" not in lab.done_jobs
    finally:
        lab.close()


def test_a_lab_that_narrows_too_far_believes_what_is_not_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: once one place is seen empty, it is taken to stand at the next best."""

    def hastily(self: Sight, place: StationName) -> None:
        for name in self.may_be_at(place):
            self._left[name] = [other for other in self._left[name] if other != place][-1:]
        self._conclude()

    monkeypatch.setattr(Sight, "add_empty", hastily)
    wrong: list[str] = []
    for after_s in (5.0, 13.0, 17.0, 25.0):
        state, lab = kill_in_motion(after_s)
        try:
            wrong += [line for line in lab.differences(state) if not line.startswith(NAMELESS)]
        finally:
            lab.close()
    assert wrong
