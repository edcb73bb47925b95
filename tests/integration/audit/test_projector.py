"""The projector dies, meets others of its kind, other logs and other versions."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from labos.audit import database, projector
from labos.audit.database import Mark, open_audit
from labos.audit.projector import Projector
from labos.audit.tables import VERSION
from labos.errors import LogTooNew, StoreUnavailable
from labos.store import open_store
from tests.integration.audit.logs import GrowingLog, golden, project, read_everything
from tests.integration.store.conftest import BACKENDS
from tests.integration.store.test_backup import Writing, notes
from tests.support.lab_process import until
from tests.support.processes import run_process


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'labos.db'}"


@pytest.fixture(params=BACKENDS)
def store_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty database of this test's own."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'labos.db'}"
    return str(request.getfixturevalue("postgres_url"))


def fresh(folder: Path, log: GrowingLog) -> str:
    """Tables that were made in one go."""
    url = f"sqlite:///{folder / 'fresh.db'}"
    made = open_audit(url)
    project(log, made)
    made.close()
    return url


def test_a_killed_projector_leaves_nothing_out_and_repeats_nothing(url: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.integration.audit.kills", url, "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100)
    seen = [int(word) for word in done.stdout.split()]
    assert len(set(seen)) > 2, "it was always killed at the same place"
    log = GrowingLog(golden("simulated-1"))
    again = open_audit(url)
    assert project(log, again) == log.end
    again.close()
    assert read_everything(url) == read_everything(fresh(tmp_path, log))


def test_two_projectors_at_once_do_the_work_once(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(projector, "BATCH", 20)
    log = GrowingLog(golden("simulated-1"), 0)
    first, second = open_audit(url), open_audit(url)
    workers = [Projector(log, first), Projector(log, second)]
    for end in (30, 50, 90, 91, 200, 300, 365):
        log.end = end
        for worker in workers:
            assert worker.catch_up() == end
        workers.reverse()
    assert first.mark() == second.mark()
    first.close()
    second.close()
    assert read_everything(url) == read_everything(fresh(tmp_path, log))


def test_what_is_not_expected_is_not_written(url: str) -> None:
    log = GrowingLog(golden("real-1"))
    made = open_audit(url)
    project(log, made)
    late = Projector(log, made)
    assert not made.write(Mark("another", 3, "00"), Mark("another", 4, "01"), late._rows)
    assert made.mark().position == log.end
    made.close()


@pytest.mark.parametrize("end", [365, 100])
def test_tables_of_another_log_are_made_anew(url: str, tmp_path: Path, end: int) -> None:
    first = open_audit(url)
    project(GrowingLog(golden("simulated-1"), end), first)
    other = GrowingLog(golden("real-1"))
    assert project(other, first) == other.end
    first.close()
    assert read_everything(url) == read_everything(fresh(tmp_path, other))


def test_older_tables_are_made_anew_and_newer_ones_refused(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = GrowingLog(golden("real-1"))
    made = open_audit(url)
    project(log, made)
    monkeypatch.setattr(database, "VERSION", VERSION + 1)
    made.reset()
    monkeypatch.undo()
    with pytest.raises(LogTooNew, match="labos audit rebuild"):
        project(log, made)
    monkeypatch.setattr(database, "VERSION", VERSION + 2)
    assert project(log, made) == log.end
    made.close()
    assert read_everything(url) == read_everything(fresh(tmp_path, log))


def test_tables_of_a_damaged_file_are_refused_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "labos-audit.db").write_bytes(b"this is no database" * 100)
    with pytest.raises(StoreUnavailable, match="not a database"):
        open_audit(f"sqlite:///{tmp_path / 'labos.db'}")


@pytest.mark.postgres
def test_both_databases_say_the_same(url: str, postgres_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projector, "BATCH", 100)
    log = GrowingLog(golden("simulated-1"))
    for each in (url, postgres_url):
        made = open_audit(each)
        for end in (len(log.records) // 3, len(log.records)):
            log.end = end
            assert project(log, made) == end
        made.close()
    lite, server = read_everything(url), read_everything(postgres_url)
    for view, rows in lite.items():
        same = [tuple(float(v) if isinstance(v, bool | int) else v for v in row) for row in rows]
        told = [tuple(float(v) if isinstance(v, bool | int) else v for v in row) for row in server[view]]
        assert sorted(same, key=repr) == sorted(told, key=repr), view


@pytest.mark.slow
def test_a_projector_that_stands_still_holds_nobody_up(store_url: str, tmp_path: Path) -> None:
    """Stopped wherever it is, in a batch or between two: the kernel writes on, and it catches up."""
    kernel = Writing(open_store(store_url, home=tmp_path))
    kernel.write(notes(2000))
    words = [
        "audit",
        "project",
        "--follow",
        "--every",
        "0.1",
        "--home",
        str(tmp_path),
        "--database",
        store_url,
    ]
    with run_process([sys.executable, "-m", "labos", *words], stdout=subprocess.DEVNULL) as other:
        tables = open_audit(store_url)
        until(lambda: tables.is_made, "it has begun")
        for end in (2000, 3000):
            other.send_signal(signal.SIGSTOP)
            for number in range(100):
                kernel.write(notes(10, end + 10 * number))
            assert kernel.store.head().position == end + 1002
            other.send_signal(signal.SIGCONT)
        until(lambda: tables.mark().position == kernel.head.position, "it has caught up")
        tables.close()
    kernel.store.close()
