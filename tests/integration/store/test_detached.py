"""Later segments of a backup, verified without those before them."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from labos.cli.app import main
from labos.core.envelope import GENESIS, Record
from labos.core.ids import LabId
from labos.core.lab import LabCreated, StartsPaused
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.words import keep
from labos.errors import BadInput, LogDamaged
from labos.ports import Head
from labos.runtime.ledger import Ledger
from labos.store import (
    FolderBlobs,
    SqlEventStore,
    backup,
    copy_accounts,
    key_of,
    open_accounts,
    verify_backup,
    verify_detached,
    write_segment,
)
from tests.integration.store.records import LAB
from tests.integration.store.test_accounts_copy import fill
from tests.integration.store.test_backup import KEY, Writing, notes
from tests.unit.services.logbook import Clock, Ids

Open = Callable[..., SqlEventStore]


class Safe:
    """A folder with a backup in three segments, and what is done to it."""

    def __init__(self, folder: Path, store: SqlEventStore, key: bytes) -> None:
        self.folder, self.store, self.key = folder, store, key
        self.kernel = Writing(store)
        blobs = FolderBlobs(folder.parent / "blobs")
        blobs.put(b"a protocol")
        for number in range(3):
            self.kernel.write(notes(5, 10 * number))
            self.made = backup(store, blobs, folder, key=key)

    def path(self, number: int) -> Path:
        return self.folder / self.made.segments[number].file

    def detach(self, count: int) -> None:
        for number in range(count):
            self.path(number).unlink()

    def change(self, number: int, **fields: object) -> None:
        """Write a segment's manifest anew, as somebody without the key would."""
        manifest = json.loads((self.folder / "backup.json").read_text())
        manifest["segments"][number] |= fields
        (self.folder / "backup.json").write_text(json.dumps(manifest))

    def damage(self, key: bytes = b"") -> LogDamaged:
        with pytest.raises(LogDamaged) as caught:
            verify_detached(self.folder, key=key)
        return caught.value


@pytest.fixture(params=[b"", KEY], ids=["bare", "sealed"])
def safe(tmp_path: Path, opened: Open, request: pytest.FixtureRequest) -> Safe:
    return Safe(tmp_path / "safe", opened(f"sqlite:///{tmp_path / 'lab.db'}"), request.param)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_what_is_left_verifies_by_itself_and_says_what_it_rests_on(safe: Safe, count: int) -> None:
    safe.detach(count)
    found = verify_detached(safe.folder, key=safe.key)
    first = safe.made.segments[count]
    assert found.segments == safe.made.segments[count:]
    assert found.absent == safe.made.segments[:count]
    assert (found.after, found.before, found.sealed) == (first.first - 1, first.before, bool(safe.key))
    assert (found.records, found.blobs, found.blobs_absent) == (safe.made.position - found.after, 1, 0)
    if count:
        assert found.before == next(safe.store.read(found.after - 1, found.after)).hash.hex()
        with pytest.raises(LogDamaged, match="is missing"):
            verify_backup(safe.folder, key=safe.key)


def test_a_backup_goes_on_and_its_segments_come_back(safe: Safe, tmp_path: Path) -> None:
    kept = {number: safe.path(number).read_bytes() for number in (0, 1)}
    safe.detach(2)
    safe.kernel.write(notes(3, 50))
    safe.made = backup(safe.store, FolderBlobs(tmp_path / "blobs"), safe.folder, key=safe.key)
    assert len(verify_detached(safe.folder, key=safe.key).segments) == 2
    for number, data in kept.items():
        safe.path(number).write_bytes(data)
    assert verify_backup(safe.folder, key=safe.key)[0] == safe.made
    assert verify_detached(safe.folder, key=safe.key).absent == ()


@pytest.mark.parametrize("line", [0, 2, 4])
def test_a_flipped_byte_is_found_where_it_is(safe: Safe, line: int) -> None:
    safe.detach(1)
    lines = gzip.decompress(safe.path(1).read_bytes()).splitlines(keepends=True)
    changed = lines[line].replace(b'"version":"0"', b'"version":"1"')
    assert changed != lines[line]
    safe.path(1).write_bytes(gzip.compress(b"".join([*lines[:line], changed, *lines[line + 1 :]])))
    at = safe.made.segments[1].first + line
    found = safe.damage(safe.key)
    assert found.position == at
    assert f"Position {at}: the payload" in found.message


def test_any_flipped_byte_of_the_file_is_found(safe: Safe) -> None:
    """Also one that the records do not show: the file is not the one that was sealed."""
    safe.detach(2)
    good = safe.path(2).read_bytes()
    first, last = safe.made.segments[2].first, safe.made.segments[2].last
    for at in range(len(good)):
        safe.path(2).write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        assert first <= safe.damage(safe.key).position <= last + 1, f"byte {at}"
    safe.path(2).write_bytes(good)
    verify_detached(safe.folder, key=safe.key)


def test_another_labs_segment_is_refused(safe: Safe) -> None:
    """Whoever exchanges the file, and its manifest too, is found out."""
    safe.detach(1)
    ledger = Ledger(LabState(), Head(LabId("lab-2"), 0, GENESIS, 1), Clock(), Ids())
    events: list[Event] = [LabCreated(LabId("lab-2"), "other"), *notes(20)]
    records: list[Record] = [ledger.write(event, "ada").record for event in events]
    mine = safe.made.segments[1]
    digest, _ = write_segment(safe.path(1), records[mine.first - 1 : mine.last])
    assert "holds a record of the lab lab-2" in safe.damage(safe.key).message
    before, last = records[mine.first - 2].hash.hex(), records[mine.last - 1].hash.hex()
    safe.change(1, lab="lab-2", before=before, hash=last, sha256=digest)
    if safe.key:
        assert "its seal was not made with this key" in safe.damage(safe.key).message
    assert "is of the lab lab-2, and the backup is of" in safe.damage().message


def test_what_it_rests_on_cannot_be_exchanged(safe: Safe) -> None:
    safe.detach(1)
    first = safe.made.segments[1].first
    safe.change(1, before="0" * 64)
    if safe.key:
        assert "its seal was not made with this key" in safe.damage(safe.key).message
    assert safe.damage().position == first
    safe.change(1, before="nonsense")
    assert "names no hash of the record before it" in safe.damage().message


def test_a_gap_and_an_empty_folder_are_no_backup(safe: Safe) -> None:
    safe.path(1).unlink()
    assert "is missing" in safe.damage(safe.key).message
    shutil.move(safe.path(0), safe.folder / "elsewhere.gz")
    safe.path(2).unlink()
    with pytest.raises(BadInput, match="All segments"):
        verify_detached(safe.folder)


def test_the_command_says_what_it_rests_on(
    safe: Safe, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    safe.detach(1)
    key = tmp_path / "key"
    key.write_bytes(b"0123456789abcdef")
    argv = ["verify", "--backup", str(safe.folder), "--detached"]
    assert main(argv) == 0
    told = capsys.readouterr().out
    rest = safe.made.segments[1]
    assert f"intact from position {rest.first} on: 10 records in 2 segments, 1 blobs." in told
    assert f"It continues position {rest.first - 1} with the hash {rest.before}" in told
    assert f"Elsewhere: {safe.made.segments[0].file}." in told
    assert "It contains no accounts" in told
    assert main([*argv, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["whole"], found["detached"]["before"]) == (True, rest.before)
    assert main([*argv, "--key", str(key)]) == 1
    assert "The backup is damaged." in capsys.readouterr().out
    assert main(["verify", "--detached"]) == 2
    assert main(["verify", "--backup", str(safe.folder)]) == 1


def test_accounts_and_words_beside_the_later_segments_are_checked_too(
    tmp_path: Path, opened: Open, capsys: pytest.CaptureFixture[str]
) -> None:
    key, url = tmp_path / "key", f"sqlite:///{tmp_path / 'lab.db'}"
    key.write_bytes(b"0123456789abcdef")
    safe = Safe(tmp_path / "safe", opened(url), key_of(key))
    words = keep("it smells", bytes(16))
    safe.kernel.say(StartsPaused("*", "ada", words.reference), words)
    backup(safe.store, FolderBlobs(tmp_path / "blobs"), safe.folder, key=safe.key)
    safe.detach(2)
    fill(url)
    accounts = open_accounts(url)
    copy_accounts(accounts, LAB, safe.folder, 7, safe.key)
    accounts.close()
    argv = ["verify", "--backup", str(safe.folder), "--detached", "--key", str(key)]
    assert main(argv) == 0
    assert "The accounts of 2 users are intact" in capsys.readouterr().out
    assert main([*argv, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["accounts"]["users"] == 2
    for name, old, new, fault in (
        ("accounts.json", '"bob"', '"eve"', "its seal was not made with this key"),
        ("accounts.json", LAB, "lab-9", "it is of the lab lab-9"),
        ("accounts.json", "{", "", "holds no accounts"),
        ("words.jsonl", "smells", "shines", "the text was changed after it was written"),
        ("words.jsonl", words.reference, f"words:{'0' * 64}", "the text was changed after it was written"),
    ):
        good = (safe.folder / name).read_text()
        (safe.folder / name).write_text(good.replace(old, new))
        assert main(argv) == 1, fault
        assert fault in capsys.readouterr().out
        (safe.folder / name).write_text(good)
    (safe.folder / "words.jsonl").unlink()
    assert main(argv) == 1
    assert "its words are missing" in capsys.readouterr().out
