"""A disk whose writes or syncs fail, or that has turned read-only under an open log."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from labos.store import SqlEventStore, find_first_damage
from tests.integration.store.records import LAB, LEASE_S, batch
from tests.integration.store.test_crash import read_acknowledged, rest, writer
from tests.support.bad_disk import BadDisk

FAILURES = {
    "write": (errno.EIO, "w", "disk I/O error. Check the disk"),
    "sync": (errno.EIO, "s", "disk I/O error. Check the disk"),
    "read-only": (errno.EROFS, "wo", "disk I/O error. Check the disk"),
}


@pytest.mark.slow
@pytest.mark.parametrize("failing", list(FAILURES))
def test_it_is_reported_and_what_was_acknowledged_is_there(
    tmp_path: Path, opened: Callable[..., SqlEventStore], monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    bad = BadDisk(tmp_path, "lab.db")
    for name, value in bad.environment.items():
        monkeypatch.setenv(name, value)
    error, calls, words = FAILURES[failing]
    url = f"sqlite:///{tmp_path / 'lab.db'}"
    with writer(url) as process:
        position = read_acknowledged(process, 30)
        bad.fails(error, calls)
        said = rest(process)
        process.wait()
    positions = [int(line) for line in said if line.isdecimal()]
    last_words = said[len(positions)]
    assert last_words.startswith("StoreUnavailable: The SQLite database")
    assert words in last_words
    bad.mend()
    store = opened(url)
    head = store.claim(LAB, "next", LEASE_S)
    # What failed to be synced was not acknowledged; it may be there all the same, whole.
    assert head.position - max([position, *positions]) in (0, 3)
    assert store.append(head, batch(head)).position == head.position + 1
    assert find_first_damage(store) is None
