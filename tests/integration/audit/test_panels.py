"""The dashboards' questions in SQL, asked as Grafana asks them: of the tables, without LabOS in between."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from deploy.grafana.make.log import MOMENTS, POSTGRES, SQLITE
from labos.audit.database import open_audit
from labos.audit.tables import VIEWS, list_view_columns
from tests.integration.audit.logs import GrowingLog, project
from tests.support.campaigns import campaign_lab
from tests.support.dashboards import Question, limit_to_span, questions
from tests.unit.services.logbook import START_NS

LATER_NS = START_NS + 3600 * 10**9
Answer = list[dict[str, Any]]


def fill(url: str) -> None:
    database = open_audit(url)
    project(GrowingLog(campaign_lab().records), database)
    database.close()


def list_questions(plugin: str) -> list[Question]:
    return [question for question in questions() if question.plugin == plugin]


def from_sqlite(folder: Path, since_ns: int = START_NS, until_ns: int = LATER_NS) -> dict[str, Answer]:
    """What each question gives, by dashboard and panel."""
    told = {}
    with closing(sqlite3.connect(f"file:{folder / 'labos-audit.db'}?mode=ro", uri=True)) as connection:
        for question in list_questions(SQLITE.plugin):
            cursor = connection.execute(limit_to_span(question.sql, since_ns, until_ns))
            names = [column[0] for column in cursor.description]
            name = f"{question.board.removesuffix(SQLITE.ending)}: {question.panel}"
            told[name] = [dict(zip(names, row, strict=True)) for row in cursor]
    return told


def from_postgres(url: str, since_ns: int = START_NS, until_ns: int = LATER_NS) -> dict[str, Answer]:
    """The same, asked by a role that may read the views and nothing else."""
    import psycopg
    from psycopg.rows import dict_row

    from labos.audit._postgres import PostgresAudit

    database = open_audit(url)
    assert isinstance(database, PostgresAudit)
    told = {}
    with psycopg.connect(url, autocommit=True, row_factory=dict_row) as connection:
        connection.execute("DROP ROLE IF EXISTS panels_reader")
        connection.execute("CREATE ROLE panels_reader")
        database.allow_reading("panels_reader")
        connection.execute("SET ROLE panels_reader")
        for question in list_questions(POSTGRES.plugin):
            sql = limit_to_span(question.sql, since_ns, until_ns).encode()
            told[f"{question.board}: {question.panel}"] = connection.execute(sql).fetchall()
        connection.execute("RESET ROLE")
        connection.execute("DROP OWNED BY panels_reader")
        connection.execute("DROP ROLE panels_reader")
    database.close()
    return told


def says_what_happened(told: dict[str, Answer]) -> None:
    assert len(told) == 6
    for name, rows in told.items():
        assert rows, name
    runs = told["labos-audit: Last runs"]
    assert runs == told["labos-users: Last runs"]
    assert [row["run"] for row in runs] == ["R5", "R4", "R3", "R2", "R1"]
    assert [(row["campaign"], row["row"]) for row in runs][:2] == [("C1", 3), ("C3", 0)]
    campaigns = told["labos-users: Campaigns"]
    assert [(row["campaign"], row["done"]) for row in campaigns] == [
        ("C1", 0.75),
        ("C4", 1.0),
        ("C3", 0.5),
        ("C2", pytest.approx(1 / 3)),
    ]
    (question,) = told["labos-audit: Questions, and who answered them"]
    assert (question["resolved_by"], question["note"]) == ("ada", "the door was ajar")
    acts = told["labos-audit: Who did what lately"]
    assert {row["actor"] for row in acts} >= {"ada", "bo"}
    assert "labos" not in {row["actor"] for row in acts}
    counts = told["labos-audit: Events by type and actor"]
    assert ("campaign.submitted", "bo", 2) in {(row["type"], row["actor"], row["events"]) for row in counts}


def test_sqlite_answers_every_panel(tmp_path: Path) -> None:
    fill(f"sqlite:///{tmp_path / 'labos.db'}")
    told = from_sqlite(tmp_path)
    says_what_happened(told)
    for rows in told.values():  # the plug-in takes these for times
        assert {str(row[name])[-1] for row in rows for name in row.keys() & {*MOMENTS} if row[name]} <= {"Z"}


@pytest.mark.postgres
def test_postgres_answers_every_panel(postgres_url: str) -> None:
    fill(postgres_url)
    says_what_happened(from_postgres(postgres_url))


def test_the_time_shown_matters(tmp_path: Path) -> None:
    fill(f"sqlite:///{tmp_path / 'labos.db'}")
    told = from_sqlite(tmp_path, START_NS - 2 * 10**9, START_NS - 10**9)
    empty = {name for name, rows in told.items() if not rows}
    assert empty == {
        "labos-audit: Events by type and actor",
        "labos-audit: Questions, and who answered them",
        "labos-audit: Who did what lately",
    }


def test_both_kinds_of_data_source_are_asked_the_same() -> None:
    lite = [(q.board.removesuffix(SQLITE.ending), q.panel, q.sql) for q in list_questions(SQLITE.plugin)]
    server = [(q.board, q.panel, q.sql.replace("labos.", "")) for q in list_questions(POSTGRES.plugin)]
    assert sorted(lite) == sorted(server)


def test_every_time_of_a_view_is_known_as_one() -> None:
    times = {column.name for table in VIEWS for column in list_view_columns(table) if column.kind == "time"}
    assert {*MOMENTS} - {"last_at"} <= times
