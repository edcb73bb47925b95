"""What a lab writes is for its owner alone, whatever the umask says; what was open to others is closed."""

from __future__ import annotations

import asyncio
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from labos.bootstrap import descriptions, open_lab
from labos.cli.verify import command as verify
from labos.node.journal_file import FileJournalFile
from labos.private import tighten
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.store import FolderBlobs, backup, open_store
from tests.integration.store.records import hear_journal, write_records
from tests.unit.services.logbook import two_users

pytestmark = pytest.mark.skipif("os.name == 'nt'", reason="Windows has other rights")


@pytest.fixture(params=[0o000, 0o022], ids=["umask-0", "umask-022"])
def umask(request: pytest.FixtureRequest) -> Iterator[None]:
    before = os.umask(request.param)
    yield
    os.umask(before)


def open_to_others(folder: Path) -> list[str]:
    """Files and folders that somebody else may read, write or enter."""
    found = [folder, *folder.rglob("*")]
    return [
        f"{oct(path.stat().st_mode)} {path}" for path in found if stat.S_IMODE(path.stat().st_mode) & 0o077
    ]


@pytest.mark.usefixtures("umask")
def test_database_key_blobs_backups_and_checkpoints_are_private(tmp_path: Path) -> None:
    home = tmp_path / "deep" / "lab"
    store = open_store(f"sqlite:///{home / 'labos.db'}", home=home)
    head = write_records(store, 3)
    store.save_snapshot(3, head.hash, "fold", b"data")
    blobs = FolderBlobs(home / "blobs")
    blobs.put(b"a picture")
    assert {path.name for path in home.iterdir()} >= {"labos.db-wal", "labos.db.kernel.lock", "labos.key"}
    assert open_to_others(home) == [], "while it runs"
    store.close()
    checkpoint = tmp_path / "checkpoint.json"
    CliRunner().invoke(
        verify, ["--home", str(home), "--checkpoint", str(checkpoint)], env={"LABOS_BLOBS": ""}
    )
    assert checkpoint.exists()
    for path in (home.parent, checkpoint):
        assert open_to_others(path) == []


@pytest.mark.usefixtures("umask")
def test_a_nodes_journal_is_private(tmp_path: Path) -> None:
    folder = tmp_path / "nodes"

    async def live() -> None:
        file = FileJournalFile(folder / "m1.journal")
        await file.read()
        await file.append(b"one\n")
        assert open_to_others(folder) == []
        await file.replace(b"two\n")
        await file.close()

    asyncio.run(live())
    assert {path.name for path in folder.iterdir()} == {"m1.journal", "m1.journal.lock"}
    assert open_to_others(folder) == []


@pytest.mark.usefixtures("umask")
def test_a_whole_lab_is_private(tmp_path: Path) -> None:
    home, safe = tmp_path / "lab", tmp_path / "safe"
    settings = Settings.make(home, f"sqlite:///{home / 'labos.db'}", speed=1000.0, simulate=True)
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())

    async def live() -> None:
        async with open_lab(settings, workcells=[cell]) as lab:
            backup(lab.store, lab.blobs, safe)

    asyncio.run(live())
    assert stat.S_IMODE(home.stat().st_mode) == 0o700
    assert open_to_others(safe) == []


def test_what_is_open_is_closed_with_one_line(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    store = open_store(f"sqlite:///{home / 'labos.db'}", home=home)
    write_records(store, 3)
    store.close()
    home.chmod(0o755)
    for path in home.iterdir():
        path.chmod(0o644)
    with hear_journal() as told:
        store = open_store(f"sqlite:///{home / 'labos.db'}", home=home)
        write_records(store, 0)
    store.close()
    assert open_to_others(home) == []
    said = [line for line in told if line["event"] == "made_private"]
    assert said[0]["first"] == str(home)
    assert len(said) <= 3, said


def test_folders_that_are_not_the_labs_alone_keep_their_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    common, home = tmp_path / "tmp", tmp_path / "somebody"
    common.mkdir()
    common.chmod(0o1777)
    home.mkdir(mode=0o755)
    monkeypatch.setenv("HOME", str(home))
    before = [path.stat().st_mode for path in (common, home, Path("/"))]
    tighten([common, home, Path("/")], "nothing")
    assert [path.stat().st_mode for path in (common, home, Path("/"))] == before


def test_what_writers_that_died_left_behind_goes_away(tmp_path: Path) -> None:
    blobs = FolderBlobs(tmp_path / "blobs")
    name = blobs.put(b"whole")
    folder = tmp_path / "blobs" / name[:2] / name[2:4]
    old, fresh = folder / f".{name}.1.1", folder / f".{name}.2.2"
    for path in (old, fresh):
        path.write_bytes(b"half")
    os.utime(old, (1_000_000_000, 1_000_000_000))
    blobs.tidy()
    assert not old.exists()
    assert fresh.exists(), "somebody may still be writing it"
    assert blobs.get(name) == b"whole"
    safe = tmp_path / "safe"
    store = open_store(two_users().save(tmp_path / "lab"), home=tmp_path / "lab")
    backup(store, blobs, safe)
    left = safe / ".log-000000004-000000009.jsonl.gz.part"
    left.write_bytes(b"half")
    os.utime(left, (1_000_000_000, 1_000_000_000))
    backup(store, blobs, safe)
    store.close()
    assert not left.exists()
