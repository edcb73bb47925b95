"""The tables of the state machines, against what the fold makes of logs."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from labos.core.actions import ActionStatus
from labos.core.modules import ModuleStatus
from labos.core.registry import Event, decode
from labos.core.runs import RunStatus, StepStatus
from tests.golden.test_golden import NAMES, log
from tests.support.machines import MACHINES, list_arrows
from tests.support.transitions import Found, transitions
from tests.unit.core.test_any_order import live_through

DRAWN = {name: set(list_arrows(rows)) for name, rows in MACHINES.items()}


def golden(name: str) -> Iterator[tuple[Event, int, int]]:
    for record in log(name):
        head = record.head
        yield decode(head.type, head.schema, record.payload), head.position, head.recorded_at


def drive(seed: int) -> Iterator[tuple[Event, int, int]]:
    """A bad day of a small lab: all that can go wrong, in any order."""
    for entry in live_through(random.Random(seed), 60).log:
        yield entry.event, entry.position, entry.at


def not_drawn(found: Found) -> list[tuple[str, str, str, str]]:
    return [(name, *row) for name, rows in found.items() for row in rows if row not in DRAWN[name]]


@pytest.mark.parametrize("name", NAMES)
def test_nothing_happens_in_a_golden_log_that_is_not_drawn(name: str) -> None:
    assert not_drawn(transitions(golden(name))) == []


def test_nothing_happens_in_random_labs_that_is_not_drawn() -> None:
    seen: dict[tuple[str, str, str, str], bool] = {}
    for seed in range(12):
        found = transitions(drive(seed))
        assert not_drawn(found) == [], seed
        seen |= {(name, *row): True for name, rows in found.items() for row in rows}
    assert len(seen) > 20


def test_every_status_is_drawn_and_can_be_left() -> None:
    statuses = {
        "run": set(RunStatus),
        "step": set(StepStatus),
        "action": set(ActionStatus),
        "node": set(ModuleStatus),
    }
    for name, drawn in DRAWN.items():
        into, out_of = {after for _, _, after in drawn}, {before for _, before, _ in drawn}
        wanted = statuses.get(name, {"at rest", "in use", "uncertain"})
        assert {*into, *out_of} - {""} == wanted
        assert wanted <= out_of, f"a {name} never leaves a status"
        assert wanted - {StepStatus.PENDING} <= into
