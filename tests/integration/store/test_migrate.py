"""Databases are brought to this version's tables, and newer ones are left alone."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import create_engine

from labos.errors import BadInput, LogTooNew, StoreUnavailable
from labos.store import SqlEventStore, find_migrations_folder, migrate, open_store, read_database_status
from labos.store._migrate import REVISION, alembic_config
from labos.store._tables import VERSION_TABLE, metadata
from labos.store._url import parse_url
from tests.integration.store.records import raw, write_records

Open = Callable[..., SqlEventStore]


def test_an_empty_database_is_migrated_once(store_url: str) -> None:
    assert read_database_status(store_url).state in ("missing", "empty")
    assert migrate(store_url) == REVISION
    assert read_database_status(store_url).state == "current"
    assert migrate(store_url) == REVISION


def test_a_kernel_on_a_current_database_does_not_load_alembic(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'lab.db'}"
    migrate(url)
    code = (
        "import sys, labos.bootstrap\n"
        "from labos.store import open_store\n"
        f"open_store({url!r}).close()\n"
        "bad = [n for n in sys.modules if n.split('.')[0] in ('alembic', 'mako')]\n"
        "assert not bad, bad\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_status_creates_nothing(tmp_path: Path) -> None:
    assert read_database_status(f"sqlite:///{tmp_path / 'lab.db'}").state == "missing"
    assert list(tmp_path.iterdir()) == []


def test_a_newer_database_is_refused_and_not_touched(store_url: str) -> None:
    migrate(store_url)
    with raw(store_url) as database:
        database.run(f"UPDATE {VERSION_TABLE} SET version_num = '9999'")
    assert read_database_status(store_url).state == "newer"
    for use in (migrate, open_store, lambda url: open_store(url, read_only=True)):
        with pytest.raises(LogTooNew, match="9999"):
            use(store_url)
    with raw(store_url) as database:
        assert database.run(f"SELECT version_num FROM {VERSION_TABLE}") == [("9999",)]


def test_a_database_of_another_program_is_refused(store_url: str) -> None:
    with raw(store_url) as database:
        database.run("CREATE TABLE event (x INTEGER)")
    with pytest.raises(StoreUnavailable, match="not LabOS's own"):
        open_store(store_url)


def test_without_create_nothing_is_made(store_url: str, tmp_path: Path) -> None:
    for options in ({"create": False}, {"read_only": True}):
        with pytest.raises(StoreUnavailable):
            open_store(store_url, **options)
    assert read_database_status(store_url).state in ("missing", "empty")
    assert list(tmp_path.iterdir()) == []


def test_a_migration_that_fails_leaves_nothing_behind(
    store_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with raw(store_url) as database:
        if database.is_sqlite:
            database.run("CREATE TABLE keep (x INTEGER)")
            database.run("CREATE INDEX event_recorded_at ON keep (x)")
        else:
            database.run("CREATE TABLE event_recorded_at (x INTEGER)")
    with pytest.raises(StoreUnavailable, match="event_recorded_at"):
        migrate(store_url)
    assert read_database_status(store_url).state == "empty"


def test_the_migrations_make_the_tables_that_the_code_expects(store_url: str) -> None:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext
    from alembic.script import ScriptDirectory

    migrate(store_url)
    engine = create_engine(parse_url(store_url))
    try:
        with engine.connect() as connection:
            context = MigrationContext.configure(
                connection, opts={"version_table": VERSION_TABLE, "compare_type": True}
            )
            assert compare_metadata(context, metadata) == []
    finally:
        engine.dispose()
    assert ScriptDirectory.from_config(alembic_config()).get_current_head() == REVISION


def test_the_log_cannot_be_downgraded(store_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from alembic import command

    migrate(store_url)
    monkeypatch.setenv("LABOS_DATABASE_URL", store_url)
    with pytest.raises(NotImplementedError, match="Restore the backup"):
        command.downgrade(alembic_config(), "base")
    assert read_database_status(store_url).state == "current"


def test_the_alembic_command_can_migrate(store_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from alembic import command

    monkeypatch.setenv("LABOS_DATABASE_URL", store_url)
    command.upgrade(alembic_config(), "head")
    assert read_database_status(store_url).state == "current"


def test_an_installed_package_brings_its_own_migrations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from labos.store import _migrate

    checkout = find_migrations_folder()
    assert (checkout / "versions" / "0001_log.py").is_file()
    package = tmp_path / "site" / "labos"
    (package / "_migrations").mkdir(parents=True)
    monkeypatch.setattr(_migrate, "__file__", str(package / "store" / "_migrate.py"))
    with pytest.raises(StoreUnavailable, match="missing from this installation"):
        find_migrations_folder()
    (package / "_migrations" / "env.py").touch()
    assert find_migrations_folder() == package / "_migrations"


@pytest.mark.parametrize(
    "url",
    ["lab.db", "sqlite://", "sqlite:///:memory:", "mysql://u:secret@h/d", "postgresql://u:secret@h", "::"],
)
def test_a_url_that_cannot_be_used_is_refused_without_showing_it(url: str) -> None:
    with pytest.raises(BadInput) as caught:
        open_store(url)
    assert "secret" not in str(caught.value)


def test_a_missing_server_is_one_clear_sentence() -> None:
    with pytest.raises(StoreUnavailable) as caught:
        open_store("postgresql://lab:secret@127.0.0.1:1/lab?connect_timeout=2")
    text = str(caught.value)
    assert "PostgreSQL database lab@127.0.0.1:1/lab" in text
    assert "refused" in text
    assert "Check that the server runs" in text
    assert "secret" not in text
    assert "\n" not in text


def test_a_missing_driver_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    monkeypatch.delitem(sys.modules, "labos.store._postgres", raising=False)
    with pytest.raises(StoreUnavailable, match=r"labos-sdl\[postgres\]"):
        open_store("postgresql://lab@127.0.0.1:1/lab")


def test_a_missing_database_is_named(postgres_url: str) -> None:
    with pytest.raises(StoreUnavailable, match=r"nowhere.*Create the database"):
        open_store(postgres_url.rsplit("/", 1)[0] + "/nowhere")


def test_a_file_that_is_no_database_is_named(tmp_path: Path) -> None:
    file = tmp_path / "lab.db"
    file.write_bytes(b"no database at all" * 100)
    with pytest.raises(StoreUnavailable, match=r"lab\.db is not available.*Restore"):
        open_store(f"sqlite:///{file}")
    assert file.read_bytes() == b"no database at all" * 100


def test_the_log_is_written_with_full_syncs(tmp_path: Path, opened: Open) -> None:
    store = opened(f"sqlite:///{tmp_path / 'sub' / 'lab.db'}")
    write_records(store, 1)
    with store._transaction() as connection:
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar_one() == 2
    with closing(sqlite3.connect(tmp_path / "sub" / "lab.db")) as database:
        assert database.execute("PRAGMA journal_mode").fetchone() == ("wal",)
