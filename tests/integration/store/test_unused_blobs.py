"""Files that nothing in the log names: shown, and removed, but never one that somebody keeps just now."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from pathlib import Path

import pytest

from labos.core.canonical import digest
from labos.errors import NotFound
from labos.store import FolderBlobs
from labos.store._blobs import REMOVING
from tests.integration.trust.conftest import Lab
from tests.unit.services.logbook import two_users

RECORDS = two_users().records
DAY_S = 86_400.0


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    made = Lab(tmp_path / "lab")
    made.home.mkdir(mode=0o700)
    made.write(RECORDS)
    return made


def age(blobs: FolderBlobs, name: str, days: float) -> None:
    at = time.time() - days * DAY_S
    os.utime(blobs._find_file(name), (at, at))


def test_what_the_log_names_stays_and_what_is_young_stays(lab: Lab) -> None:
    blobs = FolderBlobs(lab.home / "blobs")
    for name in json.loads(lab.ask("files", "--unused", "--json"))["unused"]:
        age(blobs, name, 30)
    lab.ask("files", "--unused", "--remove")
    named = set(blobs.names())
    assert named, "the log names some"
    old, young = blobs.put(b"left behind"), blobs.put(b"arriving just now")
    for name in (*named, old):
        age(blobs, name, 30)
    found = json.loads(lab.ask("files", "--unused", "--json"))
    assert found == {"unused": sorted((old, young)), "removed": []}
    said = lab.ask("files", "--unused", "--remove")
    assert f"{old} removed" in said
    assert "2 files without a reference in the log; 1 were removed." in said
    assert set(blobs.names()) == {*named, young}
    assert "are there and unchanged" in lab.ask("verify")


def test_options_that_do_not_go_together(lab: Lab) -> None:
    lab.ask("files", "--remove", code=2)
    lab.ask("files", "R1", "--unused", code=2)
    lab.ask("files", "--unused", "--remove", "--keep-days", "0", code=2)


def test_what_is_kept_again_is_young(tmp_path: Path) -> None:
    blobs = FolderBlobs(tmp_path)
    name = blobs.put(b"data")
    age(blobs, name, 30)
    listed = time.time() - DAY_S
    assert blobs.put(b"data") == name  # between the look at the log and the removal
    assert not blobs.remove_unused(name, listed)
    assert blobs.get(name) == b"data"
    age(blobs, name, 30)
    assert blobs.remove_unused(name, listed)
    assert not blobs.remove_unused(name, listed)
    with pytest.raises(NotFound):
        blobs.get(name)


def test_a_removal_that_was_broken_off(tmp_path: Path) -> None:
    blobs = FolderBlobs(tmp_path)
    name, again = blobs.put(b"one"), blobs.put(b"two")
    (tmp_path / REMOVING).mkdir()
    for each in (name, again):
        blobs._find_file(each).rename(tmp_path / REMOVING / each)
    blobs.put(b"two")
    blobs.put_back_removed()
    assert (blobs.get(name), blobs.get(again)) == (b"one", b"two")
    assert list((tmp_path / REMOVING).iterdir()) == []


def test_whoever_has_kept_a_blob_finds_it(tmp_path: Path) -> None:
    """One thread keeps the same old blobs again and again, another removes whatever is old."""
    blobs, data = FolderBlobs(tmp_path), [bytes([n]) * 100 for n in range(8)]
    names, lost, over = [digest(each) for each in data], [], threading.Event()

    def remove() -> None:
        while not over.is_set():
            for name in names:
                blobs.remove_unused(name, time.time() - DAY_S)

    remover = threading.Thread(target=remove)
    remover.start()
    try:
        for _ in range(60):
            for each, name in zip(data, names, strict=True):
                blobs.put(each)
                try:
                    blobs.get(name)  # it is young: an event names it from now on
                except NotFound:
                    lost.append(name)
                with contextlib.suppress(FileNotFoundError):
                    age(blobs, name, 30)
    finally:
        over.set()
        remover.join()
    assert lost == []
