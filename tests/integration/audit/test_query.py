"""Questions are answered, and nothing is changed whatever is asked."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.audit.database import open_audit
from labos.audit.query import ReadConnection, open_asker
from labos.audit.tables import VIEWS, list_view_columns
from labos.errors import BadInput, StoreUnavailable
from tests.integration.audit.logs import GrowingLog, golden, project

NO_QUESTIONS = (
    "DELETE FROM runs",
    "UPDATE runs SET status = 'completed'",
    "INSERT INTO runs (run) VALUES ('R99')",
    "DROP VIEW runs",
    "CREATE TABLE mine (x INTEGER)",
    "CREATE TEMP TABLE mine (x INTEGER)",
    "COMMIT",
    "SELECT 1; DROP VIEW labos.runs",
    "COMMIT; DROP VIEW labos.runs",
    "WITH gone AS (DELETE FROM labos_run RETURNING run) SELECT * FROM gone",
    "BEGIN",
    "",
)

ONLY_SQLITE = (
    "PRAGMA query_only = OFF",
    "PRAGMA writable_schema = ON",
    "ATTACH 'elsewhere.db' AS elsewhere",
    "DETACH labos",
    "VACUUM INTO 'elsewhere.db'",
    "DROP TABLE labos.labos_run",
    "SELECT load_extension('x')",
)

ONLY_POSTGRES = (
    "SET TRANSACTION READ WRITE",
    "SET SESSION CHARACTERISTICS AS TRANSACTION READ WRITE",
    "COPY labos.runs TO PROGRAM 'cat'",
    "COPY (SELECT 1) TO '/tmp/labos-elsewhere'",
    "DELETE FROM labos_audit.run",
    "WITH gone AS (DELETE FROM labos_audit.run RETURNING run) SELECT * FROM gone",
    "DO $$ BEGIN DELETE FROM labos_audit.run; END $$",
    "SELECT set_config('transaction_read_only', 'off', false); DELETE FROM labos_audit.run",
    "SELECT nextval('labos_audit.none')",
    "TRUNCATE event",
    "SELECT * FROM labos_audit.run FOR UPDATE",
    "SELECT 1 INTO mine",
)


def fill(url: str) -> str:
    database = open_audit(url)
    project(GrowingLog(golden("simulated-1")), database)
    database.close()
    return url


@pytest.fixture
def lite(tmp_path: Path) -> Iterator[ReadConnection]:
    with open_asker(fill(f"sqlite:///{tmp_path / 'labos.db'}")) as asker:
        yield asker


@pytest.fixture
def server(postgres_url: str) -> Iterator[ReadConnection]:
    with open_asker(fill(postgres_url)) as asker:
        yield asker


def refuses_all(asker: ReadConnection, statements: tuple[str, ...]) -> None:
    def count() -> object:
        return next(asker.ask("SELECT count(*), min(status) FROM labos.runs").rows)

    before = count()
    for statement in statements:
        with pytest.raises(BadInput):
            print(statement, *asker.ask(statement).rows)
        assert count() == before, statement


def answers(asker: ReadConnection) -> None:
    """Every column of every view can be named without quotes, and says what it is called."""
    for table in VIEWS:
        names = [column.name for column in list_view_columns(table)]
        for schema in ("", "labos."):
            answer = asker.ask(f"SELECT {', '.join(names)} FROM {schema}{table.view} LIMIT 1")
            assert list(answer.columns) == names
            list(answer.rows)
    query = "SELECT run FROM runs WHERE user_id = ? AND status = ? AND workflow LIKE '%c%' ORDER BY run"
    assert [tuple(row) for row in asker.ask(query, ("ada", "completed")).rows] == [("R1",)]
    hot = "SELECT count(*) FROM actions WHERE CAST(args ->> 'temperature' AS REAL) > 170 AND simulated = true"
    assert next(asker.ask(hot).rows)[0] > 0


def test_sqlite_answers(lite: ReadConnection) -> None:
    answers(lite)


def test_sqlite_changes_nothing(lite: ReadConnection, tmp_path: Path) -> None:
    refuses_all(lite, NO_QUESTIONS + ONLY_SQLITE)
    assert not list(tmp_path.glob("elsewhere*"))


def test_sqlite_gives_up_in_time(tmp_path: Path) -> None:
    url = fill(f"sqlite:///{tmp_path / 'labos.db'}")
    with open_asker(url, limit_s=0.2) as asker:
        began = time.monotonic()
        with pytest.raises(BadInput, match="took longer than"):
            list(asker.ask("SELECT count(*) FROM events a, events b, events c").rows)
        assert time.monotonic() - began < 20, "the limit is not looked at"
        assert next(asker.ask("SELECT 1").rows)[0] == 1


def test_there_has_to_be_something_to_ask(tmp_path: Path) -> None:
    with (
        pytest.raises(StoreUnavailable, match="labos audit project"),
        open_asker(f"sqlite:///{tmp_path / 'labos.db'}"),
    ):
        pytest.fail("it was opened")


@pytest.mark.postgres
def test_postgres_answers(server: ReadConnection) -> None:
    answers(server)


@pytest.mark.postgres
def test_postgres_changes_nothing(server: ReadConnection) -> None:
    refuses_all(server, NO_QUESTIONS + ONLY_POSTGRES)


@pytest.mark.postgres
def test_postgres_gives_up_in_time(postgres_url: str) -> None:
    with open_asker(fill(postgres_url), limit_s=0.2) as asker:
        for query in ("SELECT pg_sleep(30)", "SELECT count(*) FROM events a, events b, events c"):
            with pytest.raises(BadInput, match="took longer than"):
                list(asker.ask(query).rows)
        assert next(asker.ask("SELECT 1").rows)[0] == 1


@pytest.mark.postgres
def test_a_reader_sees_the_views_and_nothing_else(postgres_url: str) -> None:
    import psycopg

    from labos.audit._postgres import PostgresAudit

    database = open_audit(fill(postgres_url))
    assert isinstance(database, PostgresAudit)
    with psycopg.connect(postgres_url, autocommit=True) as owner:
        owner.execute("DROP ROLE IF EXISTS grafana")
        owner.execute("CREATE ROLE grafana")
        database.allow_reading("grafana")
        database.reset()  # views that are made anew can be read, too
        project(GrowingLog(golden("real-1")), database)
        owner.execute("SET ROLE grafana")
        assert owner.execute("SELECT count(*) FROM labos.runs").fetchone() == (3,)
        for refused in ("SELECT 1 FROM labos_audit.run", "SELECT 1 FROM event", "DELETE FROM labos.runs"):
            with pytest.raises(psycopg.Error):
                owner.execute(refused.encode())
        owner.execute("RESET ROLE")
        owner.execute("DROP OWNED BY grafana")
        owner.execute("DROP ROLE grafana")
    database.close()
