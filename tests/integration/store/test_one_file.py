"""After an orderly end the one file of SQLite is the whole log, whoever else still has it open."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from labos.core.envelope import Record
from labos.store import SqlEventStore
from tests.integration.store.records import batch, raw, write_records

Open = Callable[..., SqlEventStore]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "lab.db"


def alone(file: Path, opened: Open) -> list[Record]:
    """What a copy of the file holds, without the write-ahead log beside it."""
    copy = file.parent / "copy"
    copy.mkdir()
    shutil.copy(file, copy)
    return list(opened(f"sqlite:///{copy / file.name}", create=False, read_only=True).read())


@pytest.mark.parametrize("in_order", [True, False], ids=["lease given back", "lease kept"])
@pytest.mark.parametrize("reader_first", [True, False], ids=["reader first", "reader last"])
def test_a_copy_of_the_file_is_the_log(file: Path, opened: Open, in_order: bool, reader_first: bool) -> None:
    url = f"sqlite:///{file}"
    store, reader = opened(url), opened(url, read_only=True)
    head = write_records(store, 300)
    records = list(reader.read())
    if in_order:
        store.release(head.epoch)
    for one in (reader, store) if reader_first else (store, reader):
        one.close()
    assert alone(file, opened) == records
    assert len(records) == 300


def test_who_has_read_himself_closes_in_order_too(file: Path, opened: Open) -> None:
    store = opened(f"sqlite:///{file}")
    write_records(store, 3)
    assert len(list(store.read())) == 3
    store.close()
    assert not file.with_name(file.name + "-wal").exists()
    assert len(alone(file, opened)) == 3


def test_a_program_in_the_midst_of_reading_costs_nothing(
    file: Path, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it still needs stays beside the file, and nothing is lost."""
    monkeypatch.setattr("labos.store._sqlite.BUSY_TIMEOUT_S", 0.1)
    url = f"sqlite:///{file}"
    store = opened(url)
    head = write_records(store, 3)
    with raw(url) as program:
        program.run("BEGIN")
        program.run("SELECT count(*) FROM event")
        head = store.append(head, batch(head, 5))
        store.close()
        assert program.run("SELECT count(*) FROM event") == [(3,)]
        program.run("COMMIT")
    assert opened(url).head() == head


def test_a_file_that_was_moved_away_is_not_made_anew(file: Path, opened: Open) -> None:
    store = opened(f"sqlite:///{file}")
    write_records(store, 3)
    for part in file.parent.glob("lab.db*"):
        part.unlink()
    store.close()
    assert not file.exists()
