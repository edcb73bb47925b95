"""One flipped byte anywhere is found before anybody believes what it says, or it changes nothing.

Each flip is of one bit of one byte, in a copy of a lab at rest. What LabOS then does is compared with what
the log really was: it is refused, or comes to the very same state, or says that the log was once longer. The
numbers of the table in ``docs/security.md`` come from here (``LABOS_FLIPS_SHOWN=1``).
"""

from __future__ import annotations

import asyncio
import collections
import os
import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.core.fold import evolve
from labos.core.registry import decode
from labos.core.state import LabState, encode_picture, fold_fingerprint, hash_state
from labos.errors import BadInput, JournalDamaged, LogDamaged, StoreError
from labos.node.journal import Journal, read_journal
from labos.node.protocol import Outcome
from labos.node.world import World
from labos.runtime.ledger import load
from labos.services.verification import check_benches, check_end, check_snapshot
from labos.store import FolderBlobs, SqlEventStore, backup, find_first_damage, open_store, verify_backup
from labos.store._migrate import REVISION
from tests.integration.store.records import raw
from tests.unit.node.memory import Counter, MemoryFile
from tests.unit.services.logbook import Logbook, two_users

Counts = collections.Counter[str]

FEW, MANY = 30, 600
LESS = 25
"""Records of the log that are not in the snapshot."""


class Lab:
    """A lab at rest, and what its log comes to at each position."""

    def __init__(self, home: Path, book: Logbook) -> None:
        self.home, self.book = home, book
        self.states = {0: hash_state(LabState())}
        state = LabState()
        for record in book.records:
            at = record.head
            evolve(state, decode(at.type, at.schema, record.payload), at.position, at.recorded_at)
            self.states[at.position] = hash_state(state)
            if at.position == book.position - LESS:
                self.early = encode_picture(state)

    def write(self, *, snapshot: bool, close: bool) -> SqlEventStore:
        """The log as a kernel leaves it: closed in order, or killed with its write-ahead log beside it."""
        self.home.mkdir()
        store = open_store(self.url(self.home), home=self.home)
        head = store.claim(self.book.ledger.head.lab, "test", 30.0)
        for first in range(0, len(self.book.records), 20):
            head = store.append(head, self.book.records[first : first + 20])
        if snapshot:
            upto = self.book.position - LESS
            store.save_snapshot(upto, self.book.records[upto - 1].hash, fold_fingerprint(), self.early)
        if close:
            store.release(head.epoch)
            store.close()
        return store

    @staticmethod
    def url(home: Path) -> str:
        return f"sqlite:///{home / 'labos.db'}"


def flip(data: bytes, at: int, bit: int) -> bytes:
    return data[:at] + bytes([data[at] ^ (1 << bit)]) + data[at + 1 :]


def judge(lab: Lab, home: Path) -> str:
    """What a start makes of a lab, and whether that is the truth; who noticed what."""
    try:
        store = open_store(lab.url(home), home=home)
    except StoreError:
        return "refused by the database"
    try:
        try:
            head = store.claim(lab.book.ledger.head.lab, "judge", 30.0)
            state, _ = load(store, end=head)
        except LogDamaged as error:
            return "refused at its position" if 0 < error.position <= lab.book.position + 1 else "refused"
        except StoreError:
            return "refused by the database"
        folded = hash_state(state)
        if folded != lab.states[lab.book.position]:
            assert folded == lab.states.get(state.position), "something was folded that never was so"
            assert store.known_position > state.position, "a tail is gone and nobody says so"
            return "shorter, which is said"
        try:
            faults = [store.flaw(), *check_end(store).faults, *check_snapshot(store).faults]
            found = find_first_damage(store) is not None or any(faults)
        except StoreError:
            found = True
        return "found by verify" if found else "changes nothing"
    finally:
        store.close()


HOW_MANY = [pytest.param(FEW, id="few"), pytest.param(MANY, id="many", marks=pytest.mark.full)]


def show(what: str, counts: Counts) -> None:
    if os.environ.get("LABOS_FLIPS_SHOWN"):
        print(f"\n{what}: " + ", ".join(f"{n} {how}" for how, n in counts.most_common()))


def flips(size: int, number: int, seed: int) -> Iterator[tuple[int, int]]:
    rng = random.Random(seed)
    for _ in range(number):
        yield rng.randrange(size), rng.randrange(8)


@pytest.mark.parametrize("number", HOW_MANY)
@pytest.mark.parametrize(
    ("file", "snapshot", "close"),
    [
        pytest.param("labos.db", False, True, id="database"),
        pytest.param("labos.db", True, True, id="database-with-snapshot"),
        pytest.param("labos.db-wal", False, False, id="wal"),
        pytest.param("labos.db-wal", True, False, id="wal-with-snapshot"),
        pytest.param("labos.head", False, True, id="note-of-the-end"),
        pytest.param("labos.key", True, True, id="key"),
    ],
)
def test_a_flipped_byte_of_the_log_is_never_folded(
    tmp_path: Path, file: str, snapshot: bool, close: bool, number: int
) -> None:
    lab = Lab(tmp_path / "lab", two_users())
    store = lab.write(snapshot=snapshot, close=close)
    shutil.copytree(lab.home, tmp_path / "kept", ignore=shutil.ignore_patterns("*-shm", "*.lock"))
    store.close()
    data = (tmp_path / "kept" / file).read_bytes()
    counts: Counts = Counts()
    assert judge(lab, shutil.copytree(tmp_path / "kept", tmp_path / "sound")) == "changes nothing"
    for at, bit in flips(len(data), number, 1):
        home = Path(shutil.copytree(tmp_path / "kept", tmp_path / "flipped"))
        (home / file).write_bytes(flip(data, at, bit))
        try:
            counts[judge(lab, home)] += 1
        except AssertionError as error:
            raise AssertionError(f"bit {bit} of byte {at} of {file}: {error}") from error
        shutil.rmtree(home)
    show(f"{file}{' with a snapshot' if snapshot else ''}", counts)
    if file.startswith("labos.db"):
        assert counts["changes nothing"] < number / 2
    else:
        assert set(counts) <= {"changes nothing", "found by verify"}, "what stands beside it stops no lab"


@pytest.mark.parametrize("number", HOW_MANY)
def test_a_flipped_byte_of_a_blob_is_found_when_it_is_read(tmp_path: Path, number: int) -> None:
    blobs = FolderBlobs(tmp_path)
    name = blobs.put(random.Random(1).randbytes(3000))
    (file,) = (path for path in tmp_path.rglob("*") if path.is_file())
    data = file.read_bytes()
    for at, bit in flips(len(data), number, 2):
        file.write_bytes(flip(data, at, bit))
        with pytest.raises(LogDamaged, match=name):
            blobs.get(name)


@pytest.mark.parametrize("number", HOW_MANY)
def test_a_flipped_byte_of_a_journal_keeps_its_node_from_starting(number: int) -> None:
    async def live() -> bytes:
        file = MemoryFile()
        journal = await Journal.open(file, Counter())
        journal.bind("lab-1")
        for number in range(1, 8):
            journal.accept(f"a{number}", 1, number, "seal")
            await journal.sync()
            journal.end(f"a{number}", 1, Outcome(True, "all", {"n": number}))
            await journal.sync()
        await journal.close()
        return file.data

    data = asyncio.run(live())
    last = len(data) - 1
    counts: Counts = Counts()
    for at, bit in [*flips(len(data), number, 7), *((last, bit) for bit in range(8))]:
        try:
            found = read_journal(flip(data, at, bit))
        except JournalDamaged:
            counts["the node refuses to start"] += 1
            continue
        # Only the mark of the end of the last line can go: then the line is whole nevertheless.
        assert at == last, (at, bit)
        seventh = found.find("a7", 1)
        assert seventh is not None
        assert seventh.status == "finished"
        counts["changes nothing"] += 1
    show("journal", counts)


@pytest.mark.parametrize("number", HOW_MANY)
@pytest.mark.parametrize("file", ["backup.json", "log"])
def test_a_flipped_byte_of_a_backup_is_found_or_changes_nothing(
    tmp_path: Path, file: str, number: int
) -> None:
    lab = Lab(tmp_path / "lab", two_users())
    store = lab.write(snapshot=False, close=False)
    key = b"k" * 32
    folder = tmp_path / "safe"
    backup(store, FolderBlobs(lab.home / "blobs"), folder, key=key)
    store.close()
    (path,) = folder.glob(f"{file}*")
    data = path.read_bytes()
    counts: Counts = Counts()
    for at, bit in flips(len(data), number, 3):
        path.write_bytes(flip(data, at, bit))
        try:
            _, state = verify_backup(folder, key=key)
        except (StoreError, BadInput):
            counts["refused"] += 1
        else:
            assert hash_state(state) == lab.states[lab.book.position], (at, bit)
            counts["changes nothing"] += 1
    show(path.name, counts)


@pytest.mark.parametrize("number", HOW_MANY)
def test_a_flipped_byte_of_a_bench_is_found_or_is_a_letter(tmp_path: Path, number: int) -> None:
    folder = tmp_path / "world"
    folder.mkdir()
    world = World(str(folder / "rpl.db"))
    for at in range(40):
        world.furnish(f"place{at}")
        world.stock(f"place{at}", "plate96")
    world.close()
    data = (folder / "rpl.db").read_bytes()
    counts: Counts = Counts()
    for at, bit in flips(len(data), number, 4):
        (folder / "rpl.db").write_bytes(flip(data, at, bit))
        counts["found by verify" if check_benches(folder).faults else "not found"] += 1
    show("bench record", counts)
    assert counts["found by verify"]


COLUMNS = {
    "payload": "load", "envelope": "load", "hash": "load",
    "type": "load", "schema": "load", "recorded_at": "load",
    "actor": "verify", "stream": "verify", "correlation": "verify", "causation": "verify", "digest": "verify",
}  # fmt: skip
"""Who finds a change of a column: what a fold uses, whoever folds; what only queries use, the whole check."""


@pytest.mark.parametrize("number", HOW_MANY)
def test_a_flipped_byte_of_a_row_is_found(store: SqlEventStore, store_url: str, number: int) -> None:
    book = two_users()
    head = store.claim(book.ledger.head.lab, "test", 600.0)
    store.append(head, book.records)
    rng = random.Random(5)
    counts: Counts = Counts()
    with raw(store_url) as database:
        database.disarm()
        for _ in range(number):
            column, finder = rng.choice(list(COLUMNS.items()))
            position = rng.randint(1, book.position)
            where = f"WHERE position = {position}"
            ((value,),) = database.run(f'SELECT "{column}" FROM event {where}')
            database.run(f'UPDATE event SET "{column}" = ? {where}', spoilt(value, rng))
            if finder == "load":
                with pytest.raises(LogDamaged, match=f"position {position} ") as caught:
                    load(store, end=store.head())
                assert caught.value.position == position
            else:
                load(store, end=store.head())
                found = find_first_damage(store)
                assert found is not None
                assert found.position == position
                assert column in found.reason
            counts[finder] += 1
            database.run(f'UPDATE event SET "{column}" = ? {where}', value)
    assert find_first_damage(store) is None
    show(f"rows on {'SQLite' if store_url.startswith('sqlite') else 'PostgreSQL'}", counts)


@pytest.mark.parametrize("number", HOW_MANY)
def test_a_flipped_byte_of_a_snapshot_is_not_folded(
    store: SqlEventStore, store_url: str, tmp_path: Path, number: int
) -> None:
    lab = Lab(tmp_path / "unused", two_users())
    head = store.claim(lab.book.ledger.head.lab, "test", 600.0)
    store.append(head, lab.book.records)
    rng = random.Random(6)
    counts: Counts = Counts()
    upto = lab.book.position - LESS
    with raw(store_url) as database:
        for _ in range(number):
            store.save_snapshot(upto, lab.book.records[upto - 1].hash, fold_fingerprint(), lab.early)
            column = rng.choice(["data", "data", "data", "digest", "hash", "fingerprint", "position"])
            ((value,),) = database.run(f"SELECT {column} FROM snapshot")
            database.run(f"UPDATE snapshot SET {column} = ?", spoilt(value, rng))
            state, folded = load(store, end=store.head())
            assert folded == lab.book.position, "the log was folded from its beginning"
            assert hash_state(state) == lab.states[lab.book.position]
            faults = check_snapshot(store).faults
            counts["found by verify" if faults else "not used"] += 1
    show(f"snapshot on {'SQLite' if store_url.startswith('sqlite') else 'PostgreSQL'}", counts)


def spoilt(value: bytes | str | int, rng: random.Random) -> bytes | str | int:
    """A stored value with one bit flipped, as far as the column's type can hold it."""
    if isinstance(value, int):
        return value ^ (1 << rng.randrange(20))
    if isinstance(value, str):
        at = rng.randrange(len(value)) if value else 0
        return value[:at] + chr(ord(value[at]) ^ 1) + value[at + 1 :] if value else "x"
    data = bytes(value)
    return flip(data, rng.randrange(len(data)), rng.randrange(8))


def test_a_revision_that_is_no_text_any_more_is_damage(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "lab", two_users())
    lab.write(snapshot=False, close=True)
    file = lab.home / "labos.db"
    found = file.read_bytes()
    revision = b"\x06\x01\x02\x15" + REVISION.encode()  # a row of one text of four bytes
    assert found.count(revision) == 1
    file.write_bytes(flip(found, found.index(revision) + len(revision) - 1, 7))
    with pytest.raises(StoreError, match="UTF-8") as caught:
        open_store(lab.url(lab.home), home=lab.home)
    assert "Restore it from a backup" in caught.value.remedy
