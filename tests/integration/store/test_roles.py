"""On PostgreSQL a kernel works as a role that can add to the log, and cannot change it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path

import psycopg
import pytest
from click.testing import CliRunner
from psycopg import errors

from labos.audit.database import open_audit
from labos.cli.db import command as db
from labos.errors import BadInput, NotFound, Refused, StoreUnavailable
from labos.store import SqlEventStore, find_first_damage, find_lease_holder, grant_writer, migrate
from tests.docs.markdown import DOCS
from tests.integration.store.records import LAB, batch, write_records
from tests.integration.store.test_words import make_erasure, pause_with_words
from tests.support.postgres import PostgresServer

pytestmark = pytest.mark.postgres

Open = Callable[..., SqlEventStore]
_numbers = itertools.count(1)

FORBIDDEN = [
    "UPDATE event SET actor = 'somebody'",
    "DELETE FROM event",
    "TRUNCATE event",
    "DELETE FROM head",
    "TRUNCATE head",
    "INSERT INTO head SELECT 2, lab, position, hash, epoch, recorded_at, lease_owner, lease_until FROM head",
    "ALTER TABLE event DISABLE TRIGGER ALL",
    "ALTER TABLE head DISABLE TRIGGER head_update",
    "DROP TRIGGER event_update ON event",
    "DROP TABLE snapshot",
    "SET session_replication_role = replica",
    "CREATE OR REPLACE FUNCTION labos_refuse() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RETURN NEW; END'",
    "CREATE OR REPLACE FUNCTION labos_rewrite_words() RETURNS void LANGUAGE sql AS 'SELECT'",
    "CREATE TABLE another (x int)",
    "UPDATE labos_version SET version_num = '9999'",
]


class Roles:
    """A database of an ordinary owner, and a role beside it."""

    def __init__(self, server: PostgresServer) -> None:
        number = next(_numbers)
        self.owner, self.writer = f"owner_{number}", f"kernel {number}"
        self.server = server
        with psycopg.connect(server.url, autocommit=True) as admin:
            admin.execute(f'CREATE ROLE "{self.owner}" LOGIN')
            admin.execute(f'CREATE ROLE "{self.writer}" LOGIN')
            admin.execute(f'CREATE DATABASE roles_{number} OWNER "{self.owner}"')
        self.base = f"127.0.0.1:{server.port}/roles_{number}"
        self.owners_url = f"postgresql://{self.owner}@{self.base}"
        self.writers_url = f"postgresql://{self.writer.replace(' ', '%20')}@{self.base}"


@pytest.fixture
def roles(postgres_server: PostgresServer) -> Roles:
    made = Roles(postgres_server)
    migrate(made.owners_url)
    return made


def test_a_writer_can_do_what_a_kernel_does(roles: Roles, opened: Open) -> None:
    grant_writer(roles.owners_url, roles.writer)
    store = opened(roles.writers_url)
    head = write_records(store, 3)
    head = store.append(head, batch(head, 50))
    store.save_snapshot(head.position, head.hash, "fold", b"data")
    store.renew(head.epoch, 30.0)
    assert store.load_snapshot("fold") == (53, head.hash, b"data")
    assert len(list(store.replay(end=store.head()))) == 53
    store.save_snapshot(head.position, head.hash, "fold", b"newer")
    assert find_lease_holder(roles.writers_url) == "test"
    store.close()  # without giving the lease back, as if it had died
    successor = opened(roles.writers_url)
    assert successor.claim(LAB, "the next kernel", 30.0).epoch == 2
    assert find_first_damage(successor) is None
    assert successor.known_position == 53


def test_a_writer_keeps_and_erases_words_also_where_it_was_there_before_them(
    roles: Roles, opened: Open
) -> None:
    grant_writer(roles.owners_url, roles.writer)
    with psycopg.connect(roles.owners_url, autocommit=True) as owner:  # as before the upgrade
        owner.execute("DROP TABLE words")
        owner.execute("DROP FUNCTION labos_rewrite_words")
        owner.execute("UPDATE labos_version SET version_num = '0002'")
    migrate(roles.owners_url)
    store = opened(roles.writers_url)
    head = store.claim(LAB, "test", 30.0)
    record, words = pause_with_words(head, "a cold")
    head = store.append(head, [record])
    store.append(head, [make_erasure(head, words)])
    assert store.words_of([words.reference])[words.reference].is_erased
    assert "labos db writer" in store.scrub()  # it was granted nothing since
    grant_writer(roles.owners_url, roles.writer)
    assert store.scrub() == ""
    with psycopg.connect(roles.writers_url, autocommit=True) as writer:
        for statement in ("DELETE FROM words", "TRUNCATE words"):
            with pytest.raises(errors.InsufficientPrivilege):
                writer.execute(statement)


def test_a_writer_cannot_change_the_log_nor_take_its_guards_away(roles: Roles, opened: Open) -> None:
    grant_writer(roles.owners_url, roles.writer)
    store = opened(roles.writers_url)
    write_records(store, 3)
    with psycopg.connect(roles.writers_url, autocommit=True) as writer:
        for statement in FORBIDDEN:
            with pytest.raises(errors.InsufficientPrivilege):
                writer.execute(statement)
        with pytest.raises(errors.IntegrityConstraintViolation, match="never goes back"):
            writer.execute("UPDATE head SET position = position - 1")
    assert find_first_damage(store) is None


def test_nobody_else_can_read_or_write_the_log(roles: Roles, opened: Open) -> None:
    grant_writer(roles.owners_url, roles.writer)
    write_records(opened(roles.writers_url), 3)
    with psycopg.connect(roles.server.url, autocommit=True) as admin:
        admin.execute(f'CREATE ROLE "stranger to {roles.owner}" LOGIN')
    stranger = f"postgresql://stranger%20to%20{roles.owner}@{roles.base}"
    with psycopg.connect(stranger, autocommit=True) as connection:
        for table in ("event", "head", "snapshot", "words"):
            with pytest.raises(errors.InsufficientPrivilege):
                connection.execute(f"SELECT * FROM {table}")


def test_a_role_that_may_do_everything_anyway_is_refused(roles: Roles, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="owns the tables"):
        grant_writer(roles.owners_url, roles.owner)
    with pytest.raises(Refused, match="superuser"):
        grant_writer(roles.owners_url, "labos")
    with pytest.raises(NotFound, match="no role 'nobody'"):
        grant_writer(roles.owners_url, "nobody")
    with pytest.raises(BadInput, match="SQLite has no roles"):
        grant_writer(f"sqlite:///{tmp_path / 'lab.db'}", "ada")
    with pytest.raises(StoreUnavailable):
        grant_writer(roles.writers_url, roles.writer)


def test_the_command_says_what_was_done(roles: Roles) -> None:
    done = CliRunner().invoke(db, ["writer", roles.writer, "--database", roles.owners_url])
    assert done.exit_code == 0, done.output
    assert "may write the log" in done.output


def test_a_writer_that_finds_an_old_database_is_sent_to_the_owner(
    postgres_server: PostgresServer, opened: Open
) -> None:
    fresh = Roles(postgres_server)
    with pytest.raises(StoreUnavailable, match="labos db upgrade"):
        opened(fresh.writers_url)


def test_the_role_of_an_api_process_reads_the_log_and_its_words(roles: Roles, opened: Open) -> None:
    """What docs/api-processes.md grants it, and no more."""
    store = opened(roles.owners_url)
    head = store.claim(LAB, "test", 30.0)
    record, words = pause_with_words(head, "a cold")
    store.append(head, [record])
    name = f"lab_api_{roles.owner}"
    (granted,) = re.findall(r"```sql\n(.*?)```", (DOCS / "api-processes.md").read_text(), re.DOTALL)
    with psycopg.connect(roles.owners_url, autocommit=True) as owner:
        with psycopg.connect(roles.server.url, autocommit=True) as admin:
            admin.execute(f"CREATE ROLE {name} LOGIN")
        for statement in granted.split(";")[1:]:
            owner.execute(statement.replace("lab_api", name))
    url = f"postgresql://{name}@{roles.base}"
    api = opened(url, read_only=True)
    assert len(list(api.read())) == 1
    assert api.words_of([words.reference]) == {words.reference: words}
    with psycopg.connect(url, autocommit=True) as connection:
        for statement in (*FORBIDDEN, "UPDATE words SET text = ''", "DELETE FROM words"):
            with pytest.raises(errors.InsufficientPrivilege):
                connection.execute(statement)
    store.close()


def test_a_role_that_finds_the_views_first(postgres_server: PostgresServer, opened: Open) -> None:
    """PostgreSQL looks into a schema of the role's own name first, and that of the views is called labos."""
    url = postgres_server.create_database("views_first")
    assert url.startswith("postgresql://labos@")
    migrate(url)
    tables = open_audit(url)
    tables.reset()
    tables.close()
    with psycopg.connect(url, autocommit=True) as owner:
        assert owner.execute("SELECT current_schema()").fetchone() == ("labos",)
        owner.execute("CREATE ROLE views_first_kernel LOGIN")
        owner.execute("DROP TABLE words")
        owner.execute("UPDATE labos_version SET version_num = '0002'")
        grant = "GRANT SELECT, INSERT ON event TO views_first_kernel"  # as before the upgrade
        owner.execute(grant)
        migrate(url)
        assert owner.execute("SELECT schemaname FROM pg_tables WHERE tablename = 'words'").fetchall() == [
            ("public",)
        ]
    with pytest.raises(Refused, match="superuser"):
        grant_writer(url, "labos")
    grant_writer(url, "views_first_kernel")
    for each in (url, url.replace("labos@", "views_first_kernel@")):
        store = opened(each)
        head = store.claim(LAB, "test", 30.0)
        record, words = pause_with_words(head, f"a cold of {each}")
        head = store.append(head, [record])
        store.append(head, [make_erasure(head, words)])
        assert store.scrub() == ""
        store.close()
