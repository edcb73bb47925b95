"""The tables say what the fold says, at any position, however they came there."""

from __future__ import annotations

import json
import random
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from labos.audit import projector
from labos.audit._rows import convert_to_seconds
from labos.audit._work import NUMBERS
from labos.audit.database import open_audit
from labos.audit.query import ReadConnection, open_asker
from labos.core.branches import MAIN
from labos.core.envelope import Record
from labos.core.runs import DONE, FAILED, IN_FLIGHT, PENDING, SKIPPED, UNKNOWN
from labos.core.state import LabState
from labos.runtime.ledger import fold
from labos.testing.faults import QUIET, STORMY
from labos.testing.lab import Job, SimulatedLab
from tests.integration.audit.logs import GrowingLog, golden, project
from tests.simulation.mixes import mix, stand
from tests.simulation.test_campaigns import A_WEEK_S, Facility
from tests.support.campaigns import campaign_lab

LOGS = (
    *("real-1", "simulated-1", "campaigns"),
    *(pytest.param(log, marks=pytest.mark.slow) for log in (3, 4, "campaigns on a bad day")),
)

STATES = {
    PENDING: {"pending", "asleep"},
    IN_FLIGHT: {"in flight"},
    DONE: {"done"},
    FAILED: {"failed"},
    UNKNOWN: {"unknown"},
    SKIPPED: {"skipped", "pending", "asleep", "failed"},
}
"""What the tables may call a step of each state: a step that is left out because of another one's end has no
event of its own."""


@cache
def simulate(seed: int) -> list[Record]:
    """The log of a simulated lab; every other one has a bad day."""
    lab = SimulatedLab(stand(), seed, STORMY if seed % 2 else QUIET)
    try:
        lab.run(mix(seed))
        return list(lab.store.records)
    finally:
        lab.close()


def stormy_campaign() -> list[Record]:
    """The log of a simulated lab that is killed and fails while it carries out a campaign."""
    lab = Facility(stand(), 0, STORMY)
    lab.refills = True
    try:
        lab.run([Job("one", "ada", ())], limit_s=A_WEEK_S)
        return list(lab.store.records)
    finally:
        lab.close()


def records_of(name: str | int) -> list[Record]:
    if name == "campaigns":
        return campaign_lab().records
    if name == "campaigns on a bad day":
        return stormy_campaign()
    return simulate(name) if isinstance(name, int) else golden(name)


@pytest.mark.parametrize("name", LOGS)
def test_the_tables_agree_with_the_fold(
    name: str | int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(f"fold/{name}")
    records = records_of(name)
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    cuts = [*sorted(rng.sample(range(1, len(records)), 6)), len(records)]
    state, log = LabState(), GrowingLog(records, 0)
    for cut in cuts:
        monkeypatch.setattr(projector, "BATCH", rng.choice((7, 40, 1000)))
        fold(state, records[log.end : cut])
        log.end = cut
        database = open_audit(url)  # a new projector each time, which remembers nothing
        assert project(log, database) == cut
        database.close()
        with open_asker(url) as asker:
            compare(asker, state)


def compare(asker: ReadConnection, state: LabState) -> None:
    _same_bench(asker, state)
    _same_runs(asker, state)
    _same_levels(asker, state)
    _same_questions(asker, state)
    _same_campaigns(asker, state)
    (count,) = next(asker.ask("SELECT count(*) FROM events").rows)
    assert count == state.position


def rows(asker: ReadConnection, query: str) -> list[dict[str, Any]]:
    answer = asker.ask(query)
    return [dict(zip(answer.columns, row, strict=True)) for row in answer.rows]


def _same_bench(asker: ReadConnection, state: LabState) -> None:
    told = {row["labware"]: row for row in rows(asker, "SELECT * FROM labware WHERE gone_at_s IS NULL")}
    assert told.keys() == state.bench.labware.keys()
    for name, item in state.bench.labware.items():
        row = told[name]
        maybe = tuple(json.loads(row["maybe"])) if row["maybe"] else ()
        said = (row["station"], row["lies_on"], row["lid"], maybe, row["owner"], row["type"])
        assert said == (item.station, item.on, item.lid, item.maybe, item.owner, item.type), name
        assert json.loads(row["variables"]) == item.variables
        if item.barcode:
            assert row["barcode"] == item.barcode
    levels: dict[str, dict[str, float]] = defaultdict(dict)
    for row in rows(
        asker,
        "SELECT labware, well, sum(CASE WHEN kind = 'in' THEN volume_ul ELSE -volume_ul END) AS volume "
        "FROM transfers WHERE kind = 'in' OR certain GROUP BY labware, well",
    ):
        levels[row["labware"]][row["well"]] = row["volume"]
    for name, item in state.bench.labware.items():
        if not item.samples:
            assert levels[name] == pytest.approx(item.volumes_ul), name


def _same_runs(asker: ReadConnection, state: LabState) -> None:
    alive = {**{run.id: run for run in state.runs.active.values()}}
    told = {row["run"]: row for row in rows(asker, "SELECT * FROM runs WHERE ended_at_s IS NULL")}
    assert told.keys() == {*alive, *state.runs.queued}
    for name, run in alive.items():
        assert told[name]["status"] == run.status, name
        steps = rows(asker, f"SELECT step, state, part FROM steps WHERE run = '{name}' ORDER BY step")
        for step, there in zip(steps, run.statuses, strict=True):
            assert step["state"] in STATES[there], (name, step, there)
            if step["part"] == NUMBERS[MAIN] and there != SKIPPED:
                assert (step["state"] == "done") == (there == DONE)
        assert told[name]["steps_done"] == run.statuses.count(DONE)
    open_ = rows(asker, "SELECT action, status FROM actions WHERE ended_at_s IS NULL")
    assert {row["action"]: row["status"] for row in open_} == {
        action.id: action.status for action in state.actions.open.values()
    }


def _same_levels(asker: ReadConnection, state: LabState) -> None:
    told = {f"{row['module']}:{row['resource']}": row for row in rows(asker, "SELECT * FROM resources")}
    for key, level in state.resources.levels.items():
        assert told[key]["level"] == pytest.approx(level.level), key
        assert told[key]["capacity"] == level.capacity
        lots = [(lot["name"], pytest.approx(lot["left"])) for lot in json.loads(told[key]["lots"])]
        assert lots == [(lot.name, lot.left) for lot in level.lots]


def _same_questions(asker: ReadConnection, state: LabState) -> None:
    told = rows(asker, "SELECT intervention FROM interventions WHERE resolved_at_s IS NULL")
    assert {row["intervention"] for row in told} == state.interventions.open.keys()


def _same_campaigns(asker: ReadConnection, state: LabState) -> None:
    told = {row["campaign"]: row for row in rows(asker, "SELECT * FROM campaigns WHERE ended_at_s IS NULL")}
    assert told.keys() == state.campaigns.open.keys()
    for name, campaign in state.campaigns.open.items():
        row, terms = told[name], campaign.terms
        for field in ("name", "workflow", "workcell", "rows", "status", "why"):
            assert row[field] == getattr(campaign, field), (name, field)
        for outcome in ("completed", "failed", "cancelled", "refused"):
            assert row[outcome] == getattr(campaign, outcome), (name, outcome)
        assert row["user_id"] == campaign.user
        assert row["runs"] == campaign.next_row - campaign.refused
        assert (row["priority"], tuple(json.loads(row["tags"]))) == (terms.priority, terms.tags)
        assert row["deadline_s"] == (convert_to_seconds(terms.deadline) if terms.deadline else None)
        assert row["submitted_at_s"] == convert_to_seconds(campaign.submitted_at)
    alive = rows(asker, "SELECT run, campaign FROM runs WHERE ended_at_s IS NULL AND campaign <> ''")
    assert {row["run"]: row["campaign"] for row in alive} == state.campaigns.members


def test_ended_campaigns_say_how(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    database = open_audit(url)
    project(GrowingLog(records_of("campaigns")), database)
    database.close()
    ended = (
        "SELECT name, status, why, rows, runs, completed, cancelled, refused FROM campaigns "
        "WHERE ended_at_s IS NOT NULL ORDER BY submitted_position"
    )
    members = "SELECT run, campaign, row FROM runs ORDER BY submitted_position"
    with open_asker(url) as asker:
        assert [tuple(row) for row in asker.ask(ended).rows] == [
            ("titration", "cancelled", "the wrong table", 3, 1, 0, 1, 0),
            ("trial", "stopped", "Its budget of 1 runs is used up.", 2, 1, 1, 0, 0),
            ("plates", "completed", "", 1, 0, 0, 0, 1),
        ]
        assert [tuple(row) for row in asker.ask(members).rows] == [
            ("R1", "C1", 0),
            ("R2", "C1", 2),
            ("R3", "C2", 0),
            ("R4", "C3", 0),
            ("R5", "C1", 3),
        ]
