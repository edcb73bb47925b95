"""What is acknowledged survives; what is not is never half there."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psycopg
import pytest

from labos.core.envelope import Record
from labos.errors import Fenced, Refused, StoreUnavailable
from labos.ports import Head
from labos.store import SqlEventStore, find_first_damage, find_lease_holder, open_store
from tests.integration.store.records import LAB, LEASE_S, Raw, batch, raw, write_records
from tests.support.postgres import PostgresServer

Open = Callable[..., SqlEventStore]
pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]


@contextmanager
def writer(url: str, *, preamble: str = "", size: int = 3) -> Iterator[subprocess.Popen[str]]:
    """A kernel process that appends; killed at the end, if it still lives."""
    code = f"{preamble}\nfrom tests.integration.store.writer import main\nmain({url!r}, {size})"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def read_acknowledged(process: subprocess.Popen[str], at_least: int) -> int:
    """The position that a writer last reported, once it is ``at_least`` that."""
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= at_least:
            return int(line)
    raise AssertionError("the writer ended early")


def rest(process: subprocess.Popen[str]) -> list[str]:
    assert process.stdout is not None
    return process.stdout.read().split("\n")[:-1]


def eventually(action: Callable[[], object], expected: type[Exception], within_s: float = 5.0) -> None:
    """Repeat until it no longer raises ``expected``."""
    deadline = time.monotonic() + within_s
    while True:
        try:
            action()
            return
        except expected:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


@contextmanager
def freeze_writer(url: str, where: str) -> Iterator[None]:
    """The session of a writer that has moved the head and stands still in the midst of its rows."""
    session = psycopg.connect(url, application_name="labos-frozen-w")
    rows: Any = None
    try:
        session.execute("SELECT position FROM head FOR UPDATE")
        if where == "a pipeline":
            rows = session.pipeline()
            rows.__enter__()
            session.execute("SELECT 1")
            session.pgconn.flush()
        elif where == "a COPY":
            rows = session.cursor().copy("COPY event FROM STDIN")
            rows.__enter__()
        yield
    finally:
        session.close()


def _expect(holds: bool) -> None:
    assert holds


def _append_in_doubt(store: SqlEventStore, head: Head, records: list[Record]) -> None:
    with pytest.raises(StoreUnavailable):
        store.append(head, records)


@contextmanager
def commit_repeatedly(database: Raw) -> Iterator[None]:
    """Commits one small write after another, until its session is ended."""

    def work() -> None:
        with suppress(psycopg.OperationalError):
            while True:
                database.run("SELECT pg_logical_emit_message(true, 'probe', '')")

    thread = threading.Thread(target=work)
    thread.start()
    yield
    thread.join()


def _find_waiting(database: Raw) -> int:
    """The session whose commit waits for a standby, once there is one."""
    waiting = "SELECT pid FROM pg_stat_activity WHERE wait_event = 'SyncRep'"
    deadline = time.monotonic() + 10
    while not (found := database.run(waiting)):
        assert time.monotonic() < deadline, "no commit waits for a standby"
        time.sleep(0.02)
    return int(found[0][0])


def _let_go(database: Raw, session: int) -> None:
    """End a session, and wait until it is gone."""
    database.run("SELECT pg_terminate_backend(?)", session)
    alive = "SELECT 1 FROM pg_stat_activity WHERE pid = ?"
    deadline = time.monotonic() + 10
    while database.run(alive, session):
        assert time.monotonic() < deadline, f"session {session} does not end"
        time.sleep(0.02)


class TestKilledKernel:
    def test_the_next_kernel_starts_at_once_and_finds_what_was_acknowledged(
        self, store: SqlEventStore, store_url: str
    ) -> None:
        with writer(store_url) as process:
            read_acknowledged(process, 30)
            with pytest.raises(Refused, match="the writer"):
                store.claim(LAB, "next", LEASE_S)
            process.send_signal(signal.SIGKILL)
            process.wait()
            last = max(int(line) for line in [*rest(process), "30"])
        # The lease of 30 s still runs; the server may need a moment to see that the process died.
        eventually(lambda: store.claim(LAB, "next", LEASE_S), Refused)
        head = store.head()
        assert head.position >= last
        assert head.position % 3 == 0
        assert find_first_damage(store) is None
        assert store.append(head, batch(head)).position == head.position + 1

    def test_nobody_is_said_to_live_after_a_kill_although_the_lease_runs_on(
        self, store: SqlEventStore, store_url: str
    ) -> None:
        assert find_lease_holder(store_url) == ""
        with writer(store_url) as process:
            read_acknowledged(process, 3)
            assert find_lease_holder(store_url) == "the writer"
            process.send_signal(signal.SIGKILL)
            process.wait()
        eventually(lambda: _expect(find_lease_holder(store_url) == ""), AssertionError)
        left = store.find_holder()
        assert (left.owner, left.living, left.lease_left_s > 0) == ("the writer", False, True)
        first = store.claim(LAB, "next", LEASE_S)
        assert first.epoch == 2
        assert find_lease_holder(store_url) == "next"
        assert store.find_holder().living
        store.release(first.epoch)
        assert find_lease_holder(store_url) == ""
        assert store.find_holder().owner == "", "it was given back"

    def test_who_asks_keeps_nobody_from_starting(self, store: SqlEventStore, store_url: str) -> None:
        over = threading.Event()

        def ask() -> None:
            while not over.is_set():
                find_lease_holder(store_url)

        asking = [threading.Thread(target=ask) for _ in range(3)]
        for thread in asking:
            thread.start()
        try:
            for epoch in range(1, 21):
                assert store.claim(LAB, "kernel", LEASE_S).epoch == epoch
                store.release(epoch)
        finally:
            over.set()
            for thread in asking:
                thread.join()

    def test_a_refused_kernel_names_the_holder(self, store_url: str, opened: Open) -> None:
        with writer(store_url) as process:
            read_acknowledged(process, 3)
            with pytest.raises(Refused) as caught:
                opened(store_url).claim(LAB, "next", LEASE_S)
            if store_url.startswith("sqlite"):
                assert f"pid {process.pid}" in str(caught.value)


@pytest.mark.postgres
class TestLease:
    """Of PostgreSQL; on SQLite the file lock decides."""

    def test_a_frozen_kernel_is_succeeded_when_its_lease_ends_and_then_fenced(
        self, postgres_url: str, opened: Open
    ) -> None:
        frozen, successor = opened(postgres_url), opened(postgres_url)
        old = frozen.claim(LAB, "frozen", 1.0)
        with pytest.raises(Refused, match="frozen, whose lease lasts"):
            successor.claim(LAB, "successor", LEASE_S)
        eventually(lambda: successor.claim(LAB, "successor", LEASE_S), Refused)
        with pytest.raises(Fenced):
            frozen.append(old, batch(old))
        with pytest.raises(Fenced):
            frozen.renew(old.epoch, LEASE_S)
        third = opened(postgres_url)
        frozen.close()
        with pytest.raises(Refused, match="successor"):
            third.claim(LAB, "third", LEASE_S)
        head = successor.head()
        assert successor.append(head, batch(head)).position == 1

    @pytest.mark.parametrize("where", ["two statements", "a pipeline", "a COPY"])
    def test_a_kernel_frozen_in_the_midst_of_its_rows_keeps_nobody_out(
        self, postgres_url: str, opened: Open, where: str
    ) -> None:
        """Its lease is over before it has been silent for long: it is not yet known to be frozen."""
        frozen, successor = opened(postgres_url), opened(postgres_url)
        old = frozen.claim(LAB, "frozen", 0.1)
        with freeze_writer(postgres_url, where):
            eventually(lambda: _expect(successor.find_holder().lease_left_s <= 0), AssertionError)
            assert successor.claim(LAB, "successor", LEASE_S).epoch == old.epoch + 1
        with pytest.raises(Fenced):
            frozen.append(old, batch(old))

    def test_a_renewed_lease_holds(self, postgres_url: str, opened: Open) -> None:
        kernel, other = opened(postgres_url), opened(postgres_url)
        head = kernel.claim(LAB, "kernel", 0.3)
        kernel.renew(head.epoch, LEASE_S)
        time.sleep(0.4)
        with pytest.raises(Refused):
            other.claim(LAB, "other", LEASE_S)

    def test_a_renewal_takes_the_session_lock_again(self, postgres_url: str, opened: Open) -> None:
        kernel, other = opened(postgres_url), opened(postgres_url)
        head = kernel.claim(LAB, "kernel", LEASE_S)
        with raw(postgres_url) as database:
            database.run("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'")
        eventually(lambda: kernel.renew(head.epoch, LEASE_S), StoreUnavailable)
        kernel.renew(head.epoch, LEASE_S)
        with pytest.raises(Refused):
            other.claim(LAB, "other", LEASE_S)


@pytest.mark.postgres
class TestBrokenConnection:
    def test_a_terminated_session_is_unavailable_once_and_then_anew(
        self, postgres_url: str, opened: Open
    ) -> None:
        store = opened(postgres_url)
        head = write_records(store, 3)
        with raw(postgres_url) as database:
            database.run(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                "WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        with pytest.raises(StoreUnavailable):
            store.append(head, batch(head))
        assert store.head() == head
        assert store.append(head, batch(head)).position == 4

    def test_the_head_tells_the_truth_after_every_doubtful_append(
        self, postgres_url: str, opened: Open
    ) -> None:
        store = opened(postgres_url)
        head = write_records(store, 1)
        done = threading.Event()

        def disturb() -> None:
            with raw(postgres_url) as database:
                while not done.wait(0.03):
                    database.run(
                        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                        "WHERE datname = current_database() AND right(application_name, 2) = '-w'"
                    )

        disturber = threading.Thread(target=disturb)
        disturber.start()
        doubts = 0
        try:
            end = time.monotonic() + 2
            while time.monotonic() < end:
                try:
                    records = batch(head, 25)
                    head = store.append(head, records)
                except StoreUnavailable:
                    doubts += 1
                    found = None
                    while found is None:
                        try:
                            found = store.head()
                        except StoreUnavailable:
                            continue
                    assert found.position in (head.position, head.position + 25)
                    head = found
        finally:
            done.set()
            disturber.join()
        assert doubts > 3
        found = None

        def look() -> None:
            nonlocal found
            found = store.head()

        eventually(look, StoreUnavailable)  # the last disturbance may hit this very question
        assert found == head
        assert find_first_damage(store) is None

    def test_a_commit_whose_answer_was_lost_is_found_by_the_head(
        self, own_postgres: Callable[[], PostgresServer], opened: Open
    ) -> None:
        """Waiting for a standby that never comes, a commit is on disk but not acknowledged."""
        server = own_postgres()
        url = server.create_database("lab")
        store = opened(url)
        head = write_records(store, 1)
        records = batch(head, 30)
        with raw(url) as database, raw(url) as other:
            database.run("ALTER SYSTEM SET synchronous_standby_names = 'nobody'")
            database.run("SELECT pg_reload_conf()")
            # Commits wait from the moment on at which the checkpointer has read this: another one shows it.
            with commit_repeatedly(other):
                _let_go(database, _find_waiting(database))
            append = threading.Thread(target=_append_in_doubt, args=(store, head, records))
            append.start()
            _let_go(database, _find_waiting(database))
            append.join()
            database.run("ALTER SYSTEM RESET synchronous_standby_names")
            database.run("SELECT pg_reload_conf()")
        truth = store.head()
        assert (truth.position, truth.hash) == (31, records[-1].hash)
        assert list(store.read(1)) == records
        assert store.append(truth, batch(truth)).position == 32

    def test_a_server_that_crashes_and_comes_back_has_every_acknowledged_record(
        self, own_postgres: Callable[[], PostgresServer], opened: Open
    ) -> None:
        server = own_postgres()
        url = server.create_database("lab")
        store = opened(url)
        with writer(url) as process:
            read_acknowledged(process, 60)
            server.stop(immediate=True)
            *positions, last_words = rest(process)
            process.wait()
        assert last_words.startswith("StoreUnavailable: The PostgreSQL database labos@127.0.0.1")
        with pytest.raises(StoreUnavailable, match="refused"):
            store.head()
        server.start()
        head = store.claim(LAB, "next", LEASE_S)
        assert head.position >= max([60, *map(int, positions)])
        assert head.position % 3 == 0
        assert find_first_damage(store) is None
        head = store.append(head, batch(head))
        server.kill()
        with pytest.raises(StoreUnavailable):
            store.append(head, batch(head))
        eventually(server.start, RuntimeError)
        assert store.head() == head
        assert store.append(head, batch(head)).position == head.position + 1


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Callable[[str], None]]:
    """A tiny disk at ``tmp_path``; call it with mount options to mount it again."""
    folder = str(tmp_path)

    def mount(options: str) -> None:
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("this user may not mount a disk")

    mount("size=600k")
    yield mount
    subprocess.run(["umount", "--lazy", folder], check=True)


class TestBadDisk:
    """Of SQLite; PostgreSQL's own disk is its own business, and its errors take the same door."""

    def test_a_full_disk_is_reported_and_the_log_goes_on_when_there_is_room(
        self, tmp_path: Path, disk: Callable[[str], None], opened: Open
    ) -> None:
        store = opened(f"sqlite:///{tmp_path / 'lab.db'}")
        head = store.claim(LAB, "kernel", LEASE_S)

        def fill() -> None:
            nonlocal head
            for _ in range(1000):
                head = store.append(head, batch(head, 20))

        with pytest.raises(StoreUnavailable, match=r"lab\.db is not available: .*full.*Free some space"):
            fill()
        assert head.position > 0
        for _ in range(3):
            with pytest.raises(StoreUnavailable):
                store.append(head, batch(head, 2000))
            assert store.head() == head
        disk("remount,size=5m")
        assert store.append(head, batch(head, 20)).position == head.position + 20
        assert find_first_damage(store) is None

    def test_a_disk_that_turns_read_only_is_reported(
        self, tmp_path: Path, disk: Callable[[str], None], opened: Open
    ) -> None:
        url = f"sqlite:///{tmp_path / 'lab.db'}"
        store = opened(url)
        head = write_records(store, 3)
        store.close()
        disk("remount,ro")
        reader = opened(url, read_only=True)
        assert reader.head() == head
        assert find_first_damage(reader) is None
        for kernel in (store, opened(url)):
            with pytest.raises(StoreUnavailable, match=r"Check that .* may be written"):
                kernel.claim(LAB, "kernel", LEASE_S)

    def test_a_file_that_may_not_grow_is_reported_and_nothing_is_half_written(
        self, tmp_path: Path, opened: Open
    ) -> None:
        pytest.importorskip("resource", reason="limits of file size are a thing of Unix")
        url = f"sqlite:///{tmp_path / 'lab.db'}"
        limit = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))"
        with writer(url, preamble=limit, size=100) as process:
            *positions, last_words = rest(process)
        assert last_words.startswith("StoreUnavailable: The SQLite database")
        store = opened(url)
        head = store.claim(LAB, "next", LEASE_S)
        assert head.position == int(positions[-1]) > 0
        assert find_first_damage(store) is None

    @pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
    def test_a_folder_without_permission_is_named(self, tmp_path: Path) -> None:
        tmp_path.chmod(0o500)
        try:
            with pytest.raises(StoreUnavailable, match="Check that"):
                open_store(f"sqlite:///{tmp_path / 'lab.db'}")
        finally:
            tmp_path.chmod(0o700)

    def test_a_program_that_holds_the_file_is_named_as_the_cause(
        self, tmp_path: Path, opened: Open, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("labos.store._sqlite.BUSY_TIMEOUT_S", 0.1)
        url = f"sqlite:///{tmp_path / 'lab.db'}"
        store = opened(url)
        head = write_records(store, 1)
        store.close()
        head = store.claim(LAB, "kernel", LEASE_S)
        with raw(url) as database:
            database.run("BEGIN IMMEDIATE")
            with pytest.raises(StoreUnavailable, match=r"locked.*close that program"):
                store.append(head, batch(head))
            database.run("ROLLBACK")
        assert store.append(head, batch(head)).position == 2
