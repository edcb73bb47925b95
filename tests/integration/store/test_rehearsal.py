"""A restore that is rehearsed, and old segments that move to an archive."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import msgspec
import pytest

from labos.errors import LogDamaged
from labos.services.doctor import REHEARSAL, check_rehearsal
from labos.store import FolderBlobs, move_old_segments, verify_backup, verify_detached
from labos.store._backup import read_backup
from tests.integration.trust.conftest import Lab, chain_anew
from tests.unit.services.logbook import two_users

RECORDS = two_users().records
HALF, END = len(RECORDS) // 2, len(RECORDS)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    made = Lab(tmp_path / "lab")
    made.home.mkdir(mode=0o700)
    return made


@pytest.fixture
def backup(lab: Lab, tmp_path: Path) -> Path:
    """Of two segments and a blob, with a log that goes on."""
    folder = tmp_path / "safe"
    FolderBlobs(lab.home / "blobs").put(b"a picture")
    for end in (HALF, HALF + 1):
        lab.write(RECORDS[:end])
        lab.ask("backup", str(folder))
    lab.write(RECORDS)
    return folder


def contents(folder: Path) -> dict[Path, bytes]:
    """The files of a lab's folder, but those that SQLite makes for readers."""
    return {
        path: path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in (".db-shm", ".db-wal")
    }


def test_a_backup_that_comes_back(lab: Lab, backup: Path, tmp_path: Path) -> None:
    before = contents(lab.home)
    said = lab.ask("restore", str(backup), "--rehearse")
    assert f"The backup can be restored: {HALF + 1} events" in said
    assert f"A restore would lose {END - HALF - 1} events" in said
    assert list((tmp_path / "temporary").iterdir()) == [], "nothing is left behind"
    after = contents(lab.home)
    noted = json.loads(after.pop(lab.home / REHEARSAL))
    assert after == before
    assert (noted["position"], noted["behind"]) == (HALF + 1, END - HALF - 1)
    assert check_rehearsal(lab.home, noted["at"]).state == "ok"
    assert check_rehearsal(lab.home, noted["at"] + 101 * 86_400 * 10**9).state == "warning"


def test_where_there_is_room_for_it_can_be_said(lab: Lab, backup: Path, tmp_path: Path) -> None:
    (tmp_path / "temporary").rmdir()
    (tmp_path / "large").mkdir()
    said = lab.ask("restore", str(backup), "--rehearse", "--scratch", str(tmp_path / "large"), "--json")
    assert json.loads(said)["blobs"] >= 1
    assert list((tmp_path / "large").iterdir()) == []
    assert "--scratch needs --rehearse" in lab.ask(
        "restore", str(backup), "--scratch", str(tmp_path / "large"), code=2
    )


def test_the_backup_of_another_log(lab: Lab, backup: Path) -> None:
    records = list(RECORDS)
    changed = msgspec.structs.replace(records[7].head, actor="mallory")
    records[7] = msgspec.structs.replace(records[7], head=changed)
    lab.write(chain_anew(records))
    said = lab.ask("restore", str(backup), "--rehearse", code=1)
    assert f"they differ at position {HALF + 1} or before" in said
    assert not (lab.home / REHEARSAL).exists()


def test_a_lab_that_has_lost_its_log(lab: Lab, backup: Path) -> None:
    for path in lab.home.glob("labos.db*"):
        path.unlink()
    assert "It was not compared with a log" in lab.ask("restore", str(backup), "--rehearse")


def test_a_backup_that_does_not_come_back(lab: Lab, backup: Path, tmp_path: Path) -> None:
    segment = sorted(backup.glob("log-*"))[0]
    data = bytearray(segment.read_bytes())
    data[len(data) // 2] ^= 1
    segment.write_bytes(data)
    lab.ask("restore", str(backup), "--rehearse", code=1)
    assert not (lab.home / REHEARSAL).exists()
    assert "as a test yet" in check_rehearsal(lab.home, 0).result
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.mark.parametrize("noted", [b"", b"[]", b"{}", b'{"at": 1}', b'{"at": "x", "folder": 1}'])
def test_a_note_that_cannot_be_read_is_none(tmp_path: Path, noted: bytes) -> None:
    (tmp_path / REHEARSAL).write_bytes(noted)
    assert check_rehearsal(tmp_path, 0).state == "warning"


def test_old_segments_move_and_both_parts_verify(lab: Lab, backup: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive" / "lab"
    words = ("backup", str(backup), "--move-old", str(archive), "--keep-days")
    assert "No segment is older than --keep-days." in lab.ask(*words, "100000")
    said = lab.ask(*words, "0", "--json")
    first, second, third = (segment.file for segment in read_backup(backup).segments)
    assert json.loads(said)["moved"] == [first, second]
    assert [path.name for path in backup.glob("log-*")] == [third], "the newest stays"
    assert verify_detached(backup).after == HALF + 1
    assert "No segment is older than --keep-days." in lab.ask(*words, "0")
    for name in (first, second):
        (backup / name).write_bytes((archive / name).read_bytes())
    assert verify_backup(backup)[0].position == END


def test_a_move_that_was_broken_off_is_finished(backup: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    archive.mkdir()
    first = read_backup(backup).segments[0]
    whole = (backup / first.file).read_bytes()
    (archive / first.file).write_bytes(whole[:100])
    assert [each.file for each in move_old_segments(backup, archive, first.recorded_at + 1)] == [first.file]
    assert (archive / first.file).read_bytes() == whole
    assert not (backup / first.file).exists()


def test_a_damaged_segment_stays_where_it_is(backup: Path, tmp_path: Path) -> None:
    first = read_backup(backup).segments[0]
    (backup / first.file).write_bytes(b"something else")
    with pytest.raises(LogDamaged, match="has changed"):
        move_old_segments(backup, tmp_path / "archive", first.recorded_at + 1)
    assert (backup / first.file).exists()
    assert not (tmp_path / "archive" / first.file).exists()
