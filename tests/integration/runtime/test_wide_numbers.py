"""A log of before 64 bits were the limit: its lab closes in order, keeps a snapshot, and can be backed up."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
from msgspec.structs import replace

from labos.clock import SystemClock, Uuid7Ids
from labos.core.canonical import digest
from labos.core.envelope import Envelope, seal
from labos.core.lab import WorkcellApplied
from labos.core.state import hash_state
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import load
from labos.runtime.writer import ThreadWriter
from labos.store import FolderBlobs, backup, open_store, verify_backup
from tests.unit.services.logbook import Logbook

WIDE = 2**70


def old_lab(home: Path) -> str:
    """A log that holds a number that msgspec's MessagePack cannot spell."""
    book = Logbook()
    book.furnish()
    applied = next(entry.event for entry in book.entries if isinstance(entry.event, WorkcellApplied))
    assert isinstance(applied, WorkcellApplied)
    first, *rest = applied.modules
    wide = replace(applied, modules=(replace(first, config={**first.config, "serial": WIDE}), *rest))
    payload = msgspec.json.Encoder(order="sorted").encode(wide)
    end = book.ledger.head
    envelope = Envelope(
        lab=end.lab,
        position=end.position + 1,
        id="wide",
        stream=wide.stream(),
        version=book.state.versions.get(wide.stream(), 0) + 1,
        type=wide.TYPE,
        schema=wide.SCHEMA,
        recorded_at=end.recorded_at,
        actor="labos",
        correlation="",
        causation="",
        digest=digest(payload),
    )
    book.records.append(seal(end.hash, envelope, payload))
    return book.save(home)


def test_a_lab_with_a_wide_number_closes_and_is_backed_up(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    url = old_lab(home)

    async def live() -> None:
        store = open_store(url, home=home)
        kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
        await kernel.open()
        first = next(iter(kernel.state.modules.by_name.values()))
        assert first.spec.config["serial"] == WIDE
        await kernel.close()
        assert not kernel.failed.done()
        store.close()

    asyncio.run(live())
    store = open_store(url, home=home)
    assert store.find_holder().owner == "", "the lease was given back"
    state, folded = load(store, end=store.head())
    assert folded == 0, "the snapshot was kept and is used"
    made = backup(store, FolderBlobs(home / "blobs"), tmp_path / "safe")
    store.close()
    assert made.segments[-1].state == hash_state(state)
    assert hash_state(verify_backup(tmp_path / "safe")[1]) == hash_state(state)
