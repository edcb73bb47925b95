"""What was erased stands in no file of a real PostgreSQL server: its data folder is searched for it.

The server's write-ahead log is the exception: it keeps what was written until its files are recycled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import psycopg
import pytest
from click.testing import CliRunner

from labos.audit.database import open_audit
from labos.audit.projector import Projector
from labos.audit.query import open_asker
from labos.cli.db import command as db
from labos.core.erasure import WordsErased
from labos.core.ids import RunId
from labos.core.runs import RunPaused
from labos.core.words import ERASED, PREFIX, Kept, keep
from labos.ports import Head
from labos.services.shown import ShownLog
from labos.services.verification import check_words
from labos.store import SqlEventStore, grant_writer, migrate
from tests.integration.store.records import LAB, LEASE_S
from tests.integration.store.test_roles import Roles
from tests.integration.store.test_words import make_erasure, pause_with_words
from tests.support.postgres import PostgresServer
from tests.unit.services.logbook import Logbook

pytestmark = [pytest.mark.postgres, pytest.mark.slow]

Open = Callable[..., SqlEventStore]
NOBODY = "nobody may read 0xC0FFEE"
STAYS = "this one stays 0xBEEF"
SAMPLES = ("most_common_vals", "histogram_bounds", "most_common_elems")


@pytest.fixture
def server() -> Iterator[PostgresServer]:
    """A server of its own, where nothing else is written."""
    made = PostgresServer()
    made.start()
    yield made
    made.remove()


def files_with(server: PostgresServer, text: str, below: str = "base") -> list[Path]:
    """The server's files in which a text stands, once all that it holds in memory is written."""
    with psycopg.connect(server.url, autocommit=True) as admin:
        admin.execute("CHECKPOINT")
    assert server.folder is not None
    files = [file for file in (server.folder / "data" / below).rglob("*") if file.is_file()]
    return [file for file in files if text.encode() in file.read_bytes()]


def make_log(store: SqlEventStore, number: int = 200) -> tuple[Head, list[Kept]]:
    """A log with so many texts that nobody may read, and one that stays."""
    head = store.claim(LAB, "test", LEASE_S)
    texts = []
    for at in range(number):
        text = f"{NOBODY} {at} " + "and so on " * (at % 5)
        record, words = pause_with_words(head, text, salt=at.to_bytes(16))
        head = store.append(head, [record])
        texts.append(words)
    record, _ = pause_with_words(head, STAYS)
    return store.append(head, [record]), texts


def erase(store: SqlEventStore, head: Head, texts: list[Kept]) -> None:
    store.append(head, [make_erasure(head, *texts)])


@pytest.mark.parametrize("works_as", ["owner", "writer"])
def test_nothing_of_the_text_is_left_in_the_files_of_postgres(
    server: PostgresServer, opened: Open, works_as: str
) -> None:
    roles = Roles(server)
    migrate(roles.owners_url)
    grant_writer(roles.owners_url, roles.writer)
    store = opened(roles.owners_url if works_as == "owner" else roles.writers_url)
    head, texts = make_log(store)
    with psycopg.connect(roles.owners_url, autocommit=True) as owner:
        owner.execute("ANALYZE words")  # as the server does by itself, some day
    assert files_with(server, NOBODY)
    erase(store, head, texts)
    assert files_with(server, NOBODY), "a row that was changed stands in the file until that is written anew"
    assert store.scrub() == ""
    assert files_with(server, NOBODY) == []
    assert files_with(server, STAYS)
    found = check_words(store)
    assert (found.faults, found.checked) == ((), len(texts) + 1)
    # What is written from now on goes the same way.
    head = store.head()
    record, words = pause_with_words(head, f"{NOBODY} again", salt=b"a" * 16)
    head = store.append(head, [record])
    erase(store, head, [words])
    assert store.scrub() == ""
    assert files_with(server, NOBODY) == []


def test_who_looks_at_an_older_state_does_not_keep_the_text(server: PostgresServer, opened: Open) -> None:
    url = server.create_database("lab")
    store = opened(url)
    head, texts = make_log(store, 20)
    with psycopg.connect(url) as reader:
        reader.execute("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
        reader.execute("SELECT count(*) FROM event")
        erase(store, head, texts)
        assert store.scrub() == ""
        assert files_with(server, NOBODY) == []


def test_who_reads_the_table_meanwhile_is_not_waited_for_for_long(
    server: PostgresServer, opened: Open, tmp_path: Path
) -> None:
    """As a dump of the database does: the kernel must go on. It is said, and can be done later."""
    url = server.create_database("lab")
    store = opened(url)
    head, texts = make_log(store, 20)
    scrub = ["scrub", "--database", url, "--home", str(tmp_path)]
    with psycopg.connect(url) as reader:
        reader.execute("LOCK TABLE words IN ACCESS SHARE MODE")
        erase(store, head, texts)
        left = store.scrub()
        assert "lock timeout" in left
        assert "labos db scrub" in left
        store.renew(store.head().epoch, LEASE_S)
        done = CliRunner().invoke(db, scrub)
        assert (done.exit_code, "Traces may be left" in done.output) == (1, True)
    assert files_with(server, NOBODY)
    done = CliRunner().invoke(db, scrub)
    assert (done.exit_code, done.output) == (0, "The files contain no traces of erased texts.\n")
    assert files_with(server, NOBODY) == []


def test_samples_that_the_server_took_in_a_database_of_before_go_too(
    server: PostgresServer, opened: Open
) -> None:
    url = server.create_database("lab")
    store = opened(url)
    with psycopg.connect(url, autocommit=True) as owner:
        owner.execute("ALTER TABLE words ALTER COLUMN text SET STATISTICS -1")
        head, texts = make_log(store)
        owner.execute("ANALYZE words")
        query = "SELECT histogram_bounds::text FROM pg_stats WHERE tablename = 'words' AND attname = 'text'"
        (sampled,) = owner.execute(query).fetchone() or ("",)
        assert NOBODY in sampled
        erase(store, head, texts)
        assert store.scrub() == ""
        owner.execute("ANALYZE words")
        assert owner.execute(query).fetchone() is None
    assert files_with(server, NOBODY) == []


def test_the_write_ahead_log_keeps_it_until_its_files_go(server: PostgresServer, opened: Open) -> None:
    """What the docs say that a server's administrator can do."""
    url = server.create_database("lab")
    store = opened(url)
    head, texts = make_log(store, 20)
    erase(store, head, texts)
    assert store.scrub() == ""
    assert files_with(server, NOBODY, "pg_wal")
    with psycopg.connect(server.url, autocommit=True) as admin:
        admin.execute("ALTER SYSTEM SET wal_recycle = off")
        admin.execute("SELECT pg_reload_conf()")
        admin.execute("SELECT pg_switch_wal()")
        admin.execute("CHECKPOINT")
    assert files_with(server, NOBODY, ".") == []


def test_nothing_is_left_of_the_tables_for_sql_either(server: PostgresServer, opened: Open) -> None:
    """They are made anew without what was erased, and the server has sampled no such column before."""
    url = server.create_database("lab")
    store, book, texts = opened(url), Logbook(), []
    book.furnish()
    for number in range(30):
        run = book.submit("pcr")
        words = keep(f"{NOBODY} {number}", number.to_bytes(16))
        book.write([RunPaused(RunId(run), words.reference)], "bo")
        book.records[-1] = msgspec.structs.replace(book.records[-1], words=(words,))
        texts.append(words)
    head = store.append(store.claim(LAB, "test", LEASE_S), book.records)
    tables = open_audit(url)
    projector = Projector(ShownLog(store), tables)
    projector.catch_up()
    asked = f"SELECT count(*) FROM runs WHERE why LIKE '{NOBODY}%'"
    with open_asker(url) as asker:
        assert asker.fetch(asked) == [(30,)]
    sampled = " || ".join(f"coalesce({name}::text, '')" for name in SAMPLES)
    with psycopg.connect(url, autocommit=True) as owner:
        owner.execute("ANALYZE")
        query = f"SELECT schemaname, tablename, attname FROM pg_stats WHERE {sampled} ~* '0xc0ffee'"
        assert owner.execute(query.encode()).fetchall() == []
    digests = tuple(each.reference.removeprefix(PREFIX) for each in texts)
    written = len(book.records)
    book.write([WordsErased("", "personal", "ada", digests, (1,))])
    store.append(head, book.records[written:])
    assert store.scrub() == ""
    projector.catch_up()
    with open_asker(url) as asker:
        assert asker.fetch(asked) == [(0,)]
        assert asker.fetch(f"SELECT count(*) FROM runs WHERE why = '{ERASED}'") == [(30,)]
    tables.close()
    assert files_with(server, NOBODY) == []
    assert files_with(server, "0xc0ffee") == []  # as the search index has it
