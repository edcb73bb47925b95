"""Blobs are whole, or absent, or reported."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from labos.errors import LogDamaged, NotFound, StoreUnavailable
from labos.ports import BlobStore
from labos.store import FolderBlobs


def test_a_blob_comes_back(tmp_path: Path) -> None:
    blobs: BlobStore = FolderBlobs(tmp_path / "deep" / "blobs")
    data = os.urandom(300_000)
    name = blobs.put(data)
    assert name == hashlib.sha256(data).hexdigest()
    assert blobs.get(name) == data
    assert blobs.get(blobs.put(b"")) == b""


def test_the_same_bytes_are_kept_once(tmp_path: Path) -> None:
    blobs = FolderBlobs(tmp_path)
    assert blobs.put(b"abc") == blobs.put(b"abc")
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    name = hashlib.sha256(b"abc").hexdigest()
    assert files == [tmp_path / name[:2] / name[2:4] / name]


def test_threads_may_keep_the_same_bytes_at_once(tmp_path: Path) -> None:
    blobs = FolderBlobs(tmp_path)
    names: list[str] = []
    threads = [threading.Thread(target=lambda: names.append(blobs.put(b"abc" * 9000))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(names) == 8
    assert blobs.get(names[0]) == b"abc" * 9000
    assert len([file for file in tmp_path.rglob("*") if file.is_file()]) == 1


@pytest.mark.parametrize("damaged", [b"abd", b"ab", b""])
def test_changed_bytes_are_reported_and_mended(tmp_path: Path, damaged: bytes) -> None:
    blobs = FolderBlobs(tmp_path)
    name = blobs.put(b"abc")
    (tmp_path / name[:2] / name[2:4] / name).write_bytes(damaged)
    with pytest.raises(LogDamaged, match=name):
        blobs.get(name)
    blobs.put(b"abc")
    assert blobs.get(name) == b"abc"


@pytest.mark.parametrize("name", ["0" * 64, "", "../../etc/passwd", "A" * 64])
def test_what_is_not_there_is_not_found(tmp_path: Path, name: str) -> None:
    with pytest.raises(NotFound):
        FolderBlobs(tmp_path).get(name)


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StoreUnavailable, match="file"):
        FolderBlobs(tmp_path / "file").put(b"abc")
