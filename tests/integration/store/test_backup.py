"""A backup is taken under load, verified by itself, and put back on either database."""

from __future__ import annotations

import gzip
import json
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from labos.clock import SystemClock, Uuid7Ids
from labos.core.erasure import WordsErased
from labos.core.ids import LabId
from labos.core.lab import KernelStarted, LabCreated, StartsPaused
from labos.core.registry import Event
from labos.core.state import LabState, hash_state
from labos.core.words import PREFIX, Kept, keep
from labos.errors import LogDamaged, Refused
from labos.ports import Head
from labos.runtime.ledger import Ledger, fold
from labos.services.verification import check_words
from labos.store import (
    FolderBlobs,
    SqlEventStore,
    backup,
    find_first_damage,
    leap_epoch,
    open_store,
    read_segment,
    read_words_copy,
    records_of,
    restore_log,
    verify_backup,
    write_segment,
)
from tests.integration.store.records import LAB, LEASE_S, raw

Open = Callable[..., SqlEventStore]
KEY = b"k" * 32


class Writing:
    """A kernel that writes events that fold."""

    def __init__(self, store: SqlEventStore) -> None:
        self.store = store
        self.head = store.claim(LAB, "kernel", LEASE_S)
        self.ledger = Ledger(LabState(), self.head, SystemClock(), Uuid7Ids())
        if not self.head.position:
            self.write([LabCreated(LAB, "lab"), KernelStarted(self.head.epoch, "0")])

    def write(self, events: list[Event]) -> Head:
        records = [self.ledger.write(event, "ada").record for event in events]
        self.head = self.store.append(self.head, records)
        return self.head

    def say(self, event: Event, *words: Kept) -> Head:
        """Write an event with words of people."""
        record = msgspec.structs.replace(self.ledger.write(event, "ada").record, words=words)
        self.head = self.store.append(self.head, [record])
        return self.head


def notes(n: int, begin: int = 0) -> list[Event]:
    return [KernelStarted(1000 + begin + number, "0") for number in range(n)]


def hash_at(store: SqlEventStore, position: int) -> str:
    state = LabState()
    fold(state, store.read(upto=position))
    return hash_state(state)


def test_a_backup_under_load_holds_a_whole_log_and_comes_back_on_either_database(
    store: SqlEventStore, store_url: str, tmp_path: Path, opened: Open, request: pytest.FixtureRequest
) -> None:
    kernel = Writing(store)
    kernel.write(notes(50))
    blobs = FolderBlobs(tmp_path / "blobs")
    kept = blobs.put(b"a protocol")
    over = threading.Event()

    def load() -> None:
        number = 0
        while not over.is_set():
            number += 10
            kernel.write(notes(10, number + 50))

    writing = threading.Thread(target=load)
    writing.start()
    try:
        reader = opened(store_url, read_only=True)
        first = backup(reader, blobs, tmp_path / "safe", key=KEY)
        while reader.head().position <= first.position:
            pass
        made = backup(reader, blobs, tmp_path / "safe", key=KEY)
    finally:
        over.set()
        writing.join()
    assert made.segments[0] == first.segments[0]
    assert [s.first for s in made.segments] == [1, first.position + 1]
    assert made.blobs == (kept,)
    found, state = verify_backup(tmp_path / "safe", key=KEY)
    assert found == made
    assert hash_state(state) == made.segments[-1].state == hash_at(store, made.position)
    targets = [f"sqlite:///{tmp_path / 'back.db'}"]
    if store_url.startswith("postgresql"):
        server = request.getfixturevalue("postgres_server")
        targets.append(server.create_database(store_url.rpartition("/")[2] + "_back"))
    for target in targets:
        epoch = leap_epoch(made.epoch, SystemClock().now_ns())
        assert restore_log(target, records_of(tmp_path / "safe", found), found.lab, epoch).epoch == epoch
        back = opened(target)
        assert list(back.read()) == list(store.read(upto=made.position))
        assert find_first_damage(back) is None
        assert hash_at(back, made.position) == made.segments[-1].state
        with pytest.raises(Refused, match="not overwritten"):
            restore_log(target, records_of(tmp_path / "safe", found), found.lab, epoch)
        head = back.claim(LabId("another"), "kernel", LEASE_S)
        assert (head.lab, head.epoch) == (LAB, epoch + 1)
        with pytest.raises(Refused, match=r"not overwritten|is running on"):
            restore_log(target, (), found.lab, epoch)


def test_words_come_back_on_either_database_and_what_was_erased_does_not(
    store: SqlEventStore, store_url: str, tmp_path: Path, opened: Open, request: pytest.FixtureRequest
) -> None:
    kernel = Writing(store)
    stays, goes = keep("it smells", bytes(16)), keep("bo has a cold", bytes(range(16)))
    for words in (stays, goes):
        kernel.say(StartsPaused("*", "ada", words.reference), words)
    digest = goes.reference.removeprefix(PREFIX)
    kernel.write([WordsErased("", "personal", "ada", (digest,), (kernel.head.position,))])
    made = backup(store, FolderBlobs(tmp_path / "blobs"), tmp_path / "safe")
    verify_backup(tmp_path / "safe")
    server = request.getfixturevalue("postgres_server")
    name = "from_" + ("postgres" if store_url.startswith("postgresql") else "sqlite")
    for target in (f"sqlite:///{tmp_path / 'back.db'}", server.create_database(f"words_{name}")):
        texts = read_words_copy(tmp_path / "safe")
        restore_log(target, records_of(tmp_path / "safe", made), made.lab, 99, texts)
        back = opened(target)
        assert find_first_damage(back) is None
        assert check_words(back).faults == ()
        found = back.words_of([stays.reference, goes.reference])
        assert found == {stays.reference: stays, goes.reference: Kept(goes.reference, b"", "")}
        assert list(back.all_words()) == list(store.all_words())
        back.close()


def test_a_restore_that_fails_leaves_nothing_and_can_be_repeated(store_url: str, tmp_path: Path) -> None:
    source = open_store(f"sqlite:///{tmp_path / 'source.db'}")
    Writing(source).write(notes(5000))
    records = list(source.read())
    source.close()

    def break_off() -> object:
        yield from records[:4500]
        raise OSError("the disk with the backup is gone")

    with pytest.raises(Exception, match="gone"):
        restore_log(store_url, break_off(), LAB, 7)  # type: ignore[arg-type]
    assert restore_log(store_url, records, LAB, 7).position == len(records)


def test_another_labs_backup_and_a_cut_log_are_refused(tmp_path: Path, opened: Open) -> None:
    one = opened(f"sqlite:///{tmp_path / 'one.db'}")
    kernel = Writing(one)
    blobs = FolderBlobs(tmp_path / "blobs")
    made = backup(one, blobs, tmp_path / "safe")
    kernel.write(notes(3))
    backup(one, blobs, tmp_path / "safe")
    old = f"sqlite:///{tmp_path / 'old.db'}"
    restore_log(old, list(one.read(upto=made.position)), LAB, 7)
    with pytest.raises(Refused, match="this log is shorter, or differs before it"):
        backup(opened(old), blobs, tmp_path / "safe")
    other = opened(f"sqlite:///{tmp_path / 'other.db'}")
    other.claim(LabId("lab-2"), "kernel", LEASE_S)
    with pytest.raises(Refused, match="empty"):
        backup(other, blobs, tmp_path / "new")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(Refused, match="other files"):
        backup(one, blobs, tmp_path / "full")


@pytest.mark.parametrize("kept", [0, 3], ids=["nothing", "some"])
def test_a_log_that_has_lost_its_end_is_not_backed_up(tmp_path: Path, opened: Open, kept: int) -> None:
    url = f"sqlite:///{tmp_path / 'lab.db'}"
    store = opened(url)
    end = Writing(store).write(notes(4)).position
    with raw(url) as database:
        database.disarm()
        database.run("DELETE FROM event WHERE position > ?", kept)
    with pytest.raises(LogDamaged, match=f"ends at {kept}, but its head says {end}") as found:
        backup(store, FolderBlobs(tmp_path / "blobs"), tmp_path / "safe")
    assert found.value.position == kept + 1
    assert not (tmp_path / "safe" / "backup.json").exists()


@pytest.mark.parametrize("key", [b"", KEY], ids=["bare", "sealed"])
def test_whatever_changes_in_a_backup_is_found(tmp_path: Path, opened: Open, key: bytes) -> None:
    store = opened(f"sqlite:///{tmp_path / 'lab.db'}")
    kernel = Writing(store)
    blobs = FolderBlobs(tmp_path / "blobs")
    name = blobs.put(b"a protocol")
    safe = tmp_path / "safe"
    backup(store, blobs, safe, key=key)
    kernel.write(notes(5))
    made = backup(store, blobs, safe, key=key)
    first, second = (safe / segment.file for segment in made.segments)
    good = {path: path.read_bytes() for path in (first, second, safe / "backup.json")}
    blob = safe / "blobs" / name[:2] / name[2:4] / name

    def check_damaged(match: str) -> None:
        with pytest.raises(LogDamaged, match=match):
            verify_backup(safe, key=key)
        for path, data in good.items():
            path.write_bytes(data)
        verify_backup(safe, key=key)

    lines = gzip.decompress(good[second]).splitlines(keepends=True)
    second.write_bytes(
        gzip.compress(lines[0].replace(b'"version":"0"', b'"version":"1"') + b"".join(lines[1:]))
    )
    check_damaged(rf"Position {made.segments[1].first}: the payload")
    second.write_bytes(gzip.compress(b"".join(lines[:-1])))
    check_damaged("does not end as its manifest states")
    second.write_bytes(good[second][: len(good[second]) // 2])
    check_damaged("cannot be read")
    first.unlink()
    check_damaged("is missing")
    manifest = json.loads(good[safe / "backup.json"])
    manifest["segments"][0]["state"] = "0" * 64
    (safe / "backup.json").write_text(json.dumps(manifest))
    check_damaged("seal was not made with this key" if key else "gives a different state")
    blob.write_bytes(b"another protocol")
    with pytest.raises(LogDamaged, match="bytes changed"):
        verify_backup(safe, key=key)
    if not key:
        with pytest.raises(LogDamaged, match="has no seal"):
            verify_backup(safe, key=KEY)


def test_a_segment_is_the_same_bytes_as_the_log(tmp_path: Path, opened: Open) -> None:
    store = opened(f"sqlite:///{tmp_path / 'lab.db'}")
    Writing(store).write([*notes(3), KernelStarted(2000, 'ü "quoted" \\ \n')])
    for name in ("log.jsonl", "log.jsonl.gz"):
        again = write_segment(tmp_path / name, store.read())
        assert again == write_segment(tmp_path / name, store.read())
        assert list(read_segment(tmp_path / name)) == list(store.read())
