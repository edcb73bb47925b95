"""Nobody changes the log by accident, and nobody changes it unseen."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from labos.store import Damage, SqlEventStore, find_first_damage
from tests.integration.store.records import Raw, raw, write_records

COLUMNS = "position, id, stream, version, type, schema, recorded_at, actor, correlation, causation"
REST = "digest, envelope, payload, hash"

FORBIDDEN = [
    "UPDATE event SET actor = 'somebody' WHERE position = 2",
    "DELETE FROM event WHERE position = 3",
    "DELETE FROM event",
    # A gap, a second record at one position, a record behind the log's back.
    f"INSERT INTO event ({COLUMNS}, {REST}) SELECT 9, 'x', 'x', 1, type, schema, recorded_at, actor, "
    f"correlation, causation, {REST} FROM event WHERE position = 1",
    f"INSERT INTO event ({COLUMNS}, {REST}) SELECT 2, 'x', 'x', 1, type, schema, recorded_at, actor, "
    f"correlation, causation, {REST} FROM event WHERE position = 1",
    "DELETE FROM head",
    "UPDATE head SET position = position - 1",
    "UPDATE head SET epoch = epoch - 1",
]
FORBIDDEN_SQLITE = [
    f"INSERT OR REPLACE INTO event SELECT {COLUMNS}, {REST} FROM event WHERE position = 2",
    f"REPLACE INTO event ({COLUMNS}, {REST}) SELECT 4, id, 'x', 1, type, schema, recorded_at, actor, "
    f"correlation, causation, {REST} FROM event WHERE position = 1",
    f"REPLACE INTO event ({COLUMNS}, {REST}) SELECT 4, 'x', stream, version, type, schema, recorded_at, "
    f"actor, correlation, causation, {REST} FROM event WHERE position = 1",
    "UPDATE OR REPLACE event SET position = 1 WHERE position = 2",
    "REPLACE INTO head SELECT * FROM head",
]
FORBIDDEN_POSTGRES = [
    "TRUNCATE event",
    "TRUNCATE head",
    f"INSERT INTO event SELECT {COLUMNS}, {REST} FROM event WHERE position = 2 "
    "ON CONFLICT (position) DO UPDATE SET actor = 'somebody'",
]


def test_the_database_refuses_to_change_the_log(store: SqlEventStore, store_url: str) -> None:
    head = write_records(store, 3)
    before = list(store.read())
    with raw(store_url) as database:
        more = FORBIDDEN_SQLITE if database.is_sqlite else FORBIDDEN_POSTGRES
        for statement in FORBIDDEN + more:
            with pytest.raises(Exception, match=r"the log|the head|UNIQUE|duplicate key"):
                database.run(statement)
    assert list(store.read()) == before
    assert store.head() == head
    assert find_first_damage(store) is None


Tamper = Callable[[Raw], object]


def _flip(column: str, position: int) -> Tamper:
    def flip(database: Raw) -> None:
        ((value,),) = database.run(f"SELECT {column} FROM event WHERE position = ?", position)
        changed = bytes([value[0] ^ 1]) + value[1:]
        database.run(f"UPDATE event SET {column} = ? WHERE position = ?", changed, position)

    return flip


def _run(statement: str) -> Tamper:
    return lambda database: database.run(statement)


@pytest.mark.parametrize(
    ("tamper", "position", "reason"),
    [
        (_flip("payload", 4), 4, "payload"),
        (_flip("envelope", 5), 5, "hash"),
        (_flip("hash", 6), 6, "hash"),
        (_flip("hash", 8), 8, "hash"),
        (_run("UPDATE event SET actor = 'user:2' WHERE position = 7"), 7, "actor"),
        (_run("UPDATE event SET recorded_at = 5 WHERE position = 2"), 2, "recorded_at"),
        (_run("DELETE FROM event WHERE position = 3"), 3, "missing"),
        (_run("DELETE FROM event WHERE position = 1"), 1, "missing"),
        (_run("DELETE FROM event WHERE position > 6"), 7, "head says 8"),
        (_run("DELETE FROM event"), 1, "head says 8"),
        (_run("UPDATE head SET position = 7"), 7, "another hash"),
        (_run("UPDATE head SET lab = 'lab-2'"), 1, "lab"),
        (
            _run("UPDATE head SET position = 7, hash = (SELECT hash FROM event WHERE position = 7)"),
            8,
            "after the end",
        ),
    ],
)
def test_verifying_names_the_first_position_that_was_tampered_with(
    store: SqlEventStore, store_url: str, tamper: Tamper, position: int, reason: str
) -> None:
    write_records(store, 8)
    assert find_first_damage(store) is None
    with raw(store_url) as database:
        database.disarm()
        tamper(database)
    store.close()
    found = find_first_damage(store)
    assert found is not None
    assert found.position == position
    assert reason in found.reason


def test_a_value_of_the_wrong_type_is_damage_too(store: SqlEventStore, store_url: str) -> None:
    write_records(store, 3)
    with raw(store_url) as database:
        if not database.is_sqlite:
            pytest.skip("PostgreSQL keeps the types of its columns")
        database.disarm()
        database.run("UPDATE event SET payload = 'text' WHERE position = 2")
    found = find_first_damage(store)
    assert found is not None
    assert found.position == 2
    assert "wrong type" in found.reason


def test_verifying_tells_its_progress(store: SqlEventStore) -> None:
    write_records(store, 2500)
    seen: list[tuple[int, int]] = []
    assert find_first_damage(store, lambda done, total: seen.append((done, total))) is None
    assert seen == [(1000, 2500), (2000, 2500), (2500, 2500)]
    assert Damage(1, "x") == Damage(1, "x")
