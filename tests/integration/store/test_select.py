"""Selections of the log give the same answers on both databases."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from labos.ports import LogQuery
from labos.store import SqlEventStore, open_store
from tests.integration.store.conftest import BACKENDS
from tests.integration.store.records import LAB, LEASE_S, START_NS, batch

KINDS = ["action", "action.requested", "Action.requested", "actions.x", "action.failed", "run.started"]
ODD = {7: 'a"b\\c', 8: "100% a_b", 9: "µ"}


@pytest.fixture(scope="module", params=BACKENDS)
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SqlEventStore]:
    """1200 records in 6 kinds, 3 streams, 4 correlations and 2 actors; only read by the tests."""
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path_factory.mktemp('select') / 'lab.db'}"
    else:
        url = request.getfixturevalue("postgres_server").create_database("selected")
    store = open_store(url)
    try:
        _fill(store)
        yield store
    finally:
        store.close()


def _fill(store: SqlEventStore) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    records = []
    for i in range(1, 1201):
        (record,) = batch(
            head,
            payload={
                "i": f"<{i}>",
                "odd": 'a"b\\c' if i == 7 else "100% a_b" if i == 8 else "µ" if i == 9 else "",
            },
            type=KINDS[i % 6],
            stream=f"run:{i % 3}",
            version=i,
            correlation=f"c{i % 4}",
            actor=f"user:{i % 2}",
            recorded_at=START_NS + i * 1000,
        )
        records.append(record)
        head = type(head)(head.lab, record.head.position, record.hash, head.epoch, record.head.recorded_at)
    store.append(store.head(), records)


def positions(store: SqlEventStore, query: LogQuery) -> list[int]:
    return [record.head.position for record in store.select(query)]


def where(condition: str) -> list[int]:
    return [i for i in range(1, 1201) if eval(condition, {"i": i})]


@pytest.mark.parametrize(
    ("query", "condition"),
    [
        (LogQuery(), "True"),
        (LogQuery(after=3, upto=9), "3 < i <= 9"),
        (LogQuery(types=("action",)), "i % 6 in (0, 1, 4)"),
        (LogQuery(types=("action.*",)), "i % 6 in (0, 1, 4)"),
        (LogQuery(types=("action.failed",)), "i % 6 == 4"),
        (LogQuery(types=("action.fail",)), "False"),
        (LogQuery(types=("actions", "run")), "i % 6 in (3, 5)"),
        (LogQuery(types=("action%", "act_on", "%")), "False"),
        (LogQuery(streams=("run:0", "run:2")), "i % 3 in (0, 2)"),
        (LogQuery(correlation="c3", actor="user:1", after=1100), "i % 4 == 3 and i > 1100"),
        (LogQuery(since_ns=START_NS + 5000, until_ns=START_NS + 8000), "5 <= i < 8"),
        (LogQuery(last=3), "i > 1197"),
        (LogQuery(last=0), "False"),
        (LogQuery(last=700), "i > 500"),
        (LogQuery(last=2, types=("run",), upto=600), "i in (593, 599)"),
        (LogQuery(last=9, after=1195), "i > 1195"),
        (LogQuery(mentions="<117>"), "i == 117"),
        (LogQuery(mentions="run:1", last=2), "i in (1195, 1198)"),
        (LogQuery(mentions="RUN:1"), "False"),
        (LogQuery(mentions="100% a_b"), "i == 8"),
        (LogQuery(mentions="100_ a%b"), "False"),
        (LogQuery(mentions='a"b\\c'), "i == 7"),
        (LogQuery(mentions="µ"), "i == 9"),
    ],
)
def test_every_field_selects(log: SqlEventStore, query: LogQuery, condition: str) -> None:
    assert positions(log, query) == where(condition)


def test_selected_records_are_whole(log: SqlEventStore) -> None:
    assert list(log.select(LogQuery(after=10, upto=20))) == list(log.read(10, 20))


def test_an_empty_log_selects_nothing(store: SqlEventStore) -> None:
    assert positions(store, LogQuery(last=5)) == []
    assert positions(store, LogQuery(types=("action",))) == []
