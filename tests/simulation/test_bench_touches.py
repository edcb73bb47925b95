"""What people do by plan is told apart from what they do because something went wrong. A seed plans which is
which; the account of the lab says the same, and does not where the difference is switched off."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from labos.services import twh
from labos.services.twh import measure
from tests.simulation.labour import Day, Witnessed

RESCUES, BY_PLAN = ("jam", "nonsense"), ("by hand", "hands")
PIECES = 8
"""So few that no ink runs out."""


def count_touches(seed: int) -> tuple[dict[str, int], dict[str, int]]:
    """How many touches of each kind there were, by the day's own plan, and by the log."""
    day = Day(seed, PIECES, without=("gone", "stopped", "paused", "no kernel"))
    lab = Witnessed(seed, day)
    try:
        lab.live(day.run())
        found = measure(lab.store.records).lab
        truth = {
            "rescued": sum(how in RESCUES for how in day.how.values()),
            "planned": sum(mishap in BY_PLAN for mishap in day.before.values()),
        }
        return truth, {"rescued": found.interventions, "planned": found.planned}
    finally:
        lab.close()


def test_rescues_and_planned_work_are_counted_as_what_they_were() -> None:
    seen = {"rescued": 0, "planned": 0}
    for seed in range(4):
        truth, told = count_touches(seed)
        assert told == truth, f"seed {seed}"
        seen = {kind: seen[kind] + truth[kind] for kind in seen}
    assert min(seen.values()) > 3


@pytest.mark.full
def test_where_every_answer_counts_as_a_rescue_the_account_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twh, "PlannedWork", SimpleNamespace(KIND="nothing of that kind"))
    wrong = [seed for seed in range(4) if (found := count_touches(seed))[0] != found[1]]
    assert wrong
    assert all(count_touches(seed)[1]["rescued"] > count_touches(seed)[0]["rescued"] for seed in wrong)


def test_where_every_answer_counts_as_planned_the_account_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twh, "_is_person", lambda actor: False)
    assert any(told["rescued"] < truth["rescued"] for truth, told in map(count_touches, range(4)))
