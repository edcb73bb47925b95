"""What is folded was checked as it was read; a picture of the state is believed only with its seal."""

from __future__ import annotations

import hashlib
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from labos.core.fold import evolve
from labos.core.registry import decode
from labos.core.state import LabState, encode_picture, fold_fingerprint, from_picture, hash_state
from labos.errors import LogDamaged
from labos.runtime.follower import Follower
from labos.runtime.ledger import load
from labos.store import SqlEventStore, find_first_damage, forget_end, migrate, restore_log
from tests.integration.store.records import LAB, Tamper, batch, flip, hear_journal, raw, write_records
from tests.unit.services.logbook import Logbook

Open = Callable[..., SqlEventStore]
RECORDS = 1200


def run(statement: str) -> Tamper:
    return lambda database: database.run(statement)


TAMPERED = [
    (flip("payload", 4), 4, "payload"),
    (flip("payload", 1200, -1), 1200, "payload"),
    (flip("envelope", 501, 40), 501, "envelope"),
    (flip("envelope", 1, -1), 1, "envelope"),
    (flip("hash", 500, 31), 500, "hash"),
    (run("UPDATE event SET type = 'run.ended' WHERE position = 7"), 7, "type"),
    (run("UPDATE event SET recorded_at = 5 WHERE position = 2"), 2, "recorded_at"),
    (run('UPDATE event SET "schema" = 2 WHERE position = 1001'), 1001, "schema"),
    (run("DELETE FROM event WHERE position = 600"), 600, "missing"),
    (run("DELETE FROM event WHERE position > 1190"), 1191, "ends at 1200"),
    (run("UPDATE head SET position = 1199"), 1199, "head row"),
    (run("UPDATE head SET lab = 'lab-2'"), 1, "lab-2"),
    (run("UPDATE head SET recorded_at = recorded_at + 1"), 1200, "head row"),
    (
        run("UPDATE head SET position = 1199, hash = (SELECT hash FROM event WHERE position = 1199)"),
        1200,
        "after the end",
    ),
]


@pytest.mark.parametrize(("tamper", "position", "field"), TAMPERED)
def test_a_record_that_changed_is_found_before_it_is_folded(
    store: SqlEventStore, store_url: str, tamper: Tamper, position: int, field: str
) -> None:
    write_records(store, RECORDS)
    with raw(store_url) as database:
        database.disarm()
        tamper(database)
    seen: list[int] = []
    with pytest.raises(LogDamaged, match=field) as caught:
        seen.extend(row[0] for row in store.replay(end=store.head()))
    assert caught.value.position == position
    assert f"position {position} " in str(caught.value)
    good = position if field == "head row" else position - 1
    assert seen == list(range(1, min(good, len(seen)) + 1)), "nothing that was not good was given"


def test_a_tail_is_checked_from_what_is_known_of_its_beginning(store: SqlEventStore, store_url: str) -> None:
    write_records(store, 30)
    tenth = next(store.read(9, 10)).hash
    assert len(list(store.replay(10, before=tenth, end=store.head()))) == 20
    with raw(store_url) as database:
        database.disarm()
        flip("payload", 5)(database)
    assert len(list(store.replay(10, before=tenth))) == 20, "what stands below is checked by itself"
    with pytest.raises(LogDamaged, match="position 10 "):
        list(store.replay(10, before=bytes(32)))


@pytest.fixture
def book() -> Logbook:
    made = Logbook()
    made.furnish()
    made.submit("pcr")
    made.carry_through("R1", seconds=5, steps=3)
    return made


@pytest.fixture
def kept(store: SqlEventStore, book: Logbook) -> SqlEventStore:
    """A store with a real log."""
    head = store.claim(book.ledger.head.lab, "test", 30.0)
    store.append(head, book.records)
    return store


def keep_snapshot(store: SqlEventStore, book: Logbook, upto: int) -> LabState:
    state = LabState()
    for record in book.records[:upto]:
        at = record.head
        evolve(state, decode(at.type, at.schema, record.payload), at.position, at.recorded_at)
    store.save_snapshot(upto, book.records[upto - 1].hash, fold_fingerprint(), encode_picture(state))
    return state


def forge(state: LabState) -> bytes:
    """The picture of another state: somebody else's lab."""
    other = from_picture(encode_picture(state))
    other.lab.name = "mine now"
    return encode_picture(other)


def test_a_forged_snapshot_is_not_used(
    kept: SqlEventStore, store_url: str, book: Logbook, opened: Open
) -> None:
    middle = len(book.records) // 2
    state = keep_snapshot(kept, book, middle)
    honest, number = load(kept, end=kept.head())
    assert number == len(book.records) - middle, "a genuine one is used"
    forged = forge(state)
    for digest in (hashlib.sha256(forged).hexdigest(), "", None):
        with raw(store_url) as database:
            if digest is not None:
                database.run("UPDATE snapshot SET digest = ?", digest)
            database.run("UPDATE snapshot SET data = ?", forged)
        with hear_journal() as told:
            folded, number = load(opened(store_url), end=kept.head())
        assert number == len(book.records), "the state is computed from the beginning of the log"
        assert [line["event"] for line in told].count("snapshot_not_used") == 1
        assert hash_state(folded) == hash_state(honest)
        keep_snapshot(kept, book, middle)  # for the third: sealed, then changed


@pytest.mark.parametrize(
    "column",
    ["position = position - 1", "fingerprint = 'x'", "hash = (SELECT hash FROM event WHERE position = 3)"],
)
def test_no_part_of_a_snapshot_can_be_changed(
    kept: SqlEventStore, store_url: str, book: Logbook, column: str
) -> None:
    keep_snapshot(kept, book, len(book.records) // 2)
    with raw(store_url) as database:
        database.run(f"UPDATE snapshot SET {column}")
    assert load(kept)[1] == len(book.records)


def test_a_snapshot_of_another_key_or_of_no_key_is_not_used(
    kept: SqlEventStore, store_url: str, book: Logbook, opened: Open, tmp_path: Path
) -> None:
    keep_snapshot(kept, book, len(book.records))
    assert load(kept)[1] == 0
    (tmp_path / "elsewhere").mkdir()
    for home in (None, tmp_path / "elsewhere"):
        assert load(opened(store_url, read_only=True, home=home))[1] == len(book.records)
    key = tmp_path / "labos.key"
    key.write_text("ab" * 32)
    assert load(opened(store_url, read_only=True))[1] == len(book.records)
    key.write_text("no key at all")
    assert load(opened(store_url, read_only=True))[1] == len(book.records)


def test_a_sealed_snapshot_shows_that_the_log_was_written_anew(
    kept: SqlEventStore, store_url: str, book: Logbook
) -> None:
    keep_snapshot(kept, book, len(book.records))
    with raw(store_url) as database:
        database.disarm()
        database.run("DELETE FROM event WHERE position > 0")
        database.run(
            "UPDATE head SET position = 0, hash = ?, epoch = 0, recorded_at = 0, lease_until = 0", bytes(32)
        )
    head = kept.claim(book.ledger.head.lab, "test", 30.0)
    kept.append(head, batch(head, len(book.records)))
    assert find_first_damage(kept) is None, "the chain alone does not show it"
    with pytest.raises(LogDamaged, match="sealed snapshot"):
        load(kept)


def test_a_standby_checks_what_it_reads(kept: SqlEventStore, store_url: str, book: Logbook) -> None:
    with raw(store_url) as database:
        database.disarm()
        flip("payload", 9)(database)
    with pytest.raises(LogDamaged, match="position 9 "):
        Follower(kept).catch_up()


@pytest.mark.skipif("os.name == 'nt'")
def test_the_key_is_private_and_made_once(opened: Open, store_url: str, tmp_path: Path) -> None:
    store = opened(store_url)
    write_records(store, 2)
    key = tmp_path / "labos.key"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    before = key.read_bytes()
    store.close()
    again = opened(store_url)
    again.claim(LAB, "test", 30.0)
    assert key.read_bytes() == before


class TestKnownEnd:
    def test_a_log_that_lost_its_tail_was_longer_once(
        self, store: SqlEventStore, store_url: str, opened: Open
    ) -> None:
        head = write_records(store, 8)
        store.append(head, batch(head, 3))
        assert store.known_position == 0, "it is what was known when the store was opened"
        store.close()
        assert opened(store_url).known_position == 11
        with raw(store_url) as database:
            database.disarm()
            database.run("DELETE FROM event WHERE position > 6")
            database.run(
                "UPDATE head SET position = 6, "
                "recorded_at = (SELECT recorded_at FROM event WHERE position = 6), "
                "hash = (SELECT hash FROM event WHERE position = 6)"
            )
        shortened = opened(store_url)
        assert (shortened.head().position, shortened.known_position) == (6, 11)
        shortened.close()
        again = opened(store_url)
        now = again.claim(LAB, "test", 30.0)
        now = again.append(now, batch(now, 2))
        again.close()
        assert opened(store_url).known_position == 11, "until the log has grown past it"

    def test_a_restored_log_says_so_and_is_believed(
        self, store: SqlEventStore, store_url: str, opened: Open, tmp_path: Path
    ) -> None:
        write_records(store, 8)
        store.close()
        assert opened(store_url).known_position == 8
        forget_end(tmp_path)
        assert opened(store_url).known_position == 0

    @pytest.mark.parametrize(
        "spoil",
        [lambda data: b"", lambda data: data[:70], lambda data: data.replace(b"8", b"9"), lambda _: b"{}"],
    )
    def test_a_note_that_cannot_be_believed_stops_nobody(
        self,
        store: SqlEventStore,
        store_url: str,
        opened: Open,
        tmp_path: Path,
        spoil: Callable[[bytes], bytes],
    ) -> None:
        write_records(store, 8)
        store.close()
        note = tmp_path / "labos.head"
        note.write_bytes(spoil(note.read_bytes()))
        again = opened(store_url)
        assert again.known_position == 0
        head = again.claim(LAB, "test", 30.0)
        again.append(head, batch(head))
        again.close()
        assert opened(store_url).known_position == 9

    def test_the_note_of_another_lab_says_nothing_of_this_one(
        self, store: SqlEventStore, opened: Open, tmp_path: Path
    ) -> None:
        write_records(store, 8)
        records = list(store.read())
        store.close()
        url = f"sqlite:///{tmp_path / 'other.db'}"
        fresh = opened(url)
        assert fresh.known_position == 8, "an empty log may be all that is left of it"
        fresh.close()
        migrate(url)
        other = opened(url)
        head = other.claim("lab-9", "test", 30.0)  # type: ignore[arg-type]
        other.append(head, batch(head, 2))
        other.close()
        assert records
        assert opened(url).known_position == 2
        restore_log(f"sqlite:///{tmp_path / 'third.db'}", records[:5], LAB, 7)
        assert opened(f"sqlite:///{tmp_path / 'third.db'}").known_position == 0
