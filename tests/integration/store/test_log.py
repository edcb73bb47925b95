"""The event store's contract, on both databases."""

from __future__ import annotations

import threading
from collections.abc import Callable

import msgspec
import pytest

from labos.core.envelope import GENESIS
from labos.core.ids import LabId
from labos.errors import Fenced, InvariantBroken, LogDamaged, Refused, StoreUnavailable
from labos.ports import EventStore, Head
from labos.store import SqlEventStore
from tests.integration.store.records import LAB, LEASE_S, batch, raw, write_records

Open = Callable[..., SqlEventStore]


class TestAppendAndRead:
    def test_an_empty_log_has_a_head_at_nothing(self, store: SqlEventStore) -> None:
        port: EventStore = store
        assert port.head() == Head(LabId(""), 0, GENESIS, 0, 0)
        assert list(store.read()) == []

    def test_what_is_appended_is_read_back_byte_for_byte(self, store: SqlEventStore) -> None:
        head = store.claim(LAB, "test", LEASE_S)
        records = batch(head, 3, {"text": "Grüße, µl → 96"})
        head = store.append(head, records)
        assert list(store.read()) == records
        assert store.head() == head
        assert head == Head(LAB, 3, records[-1].hash, 1, records[-1].head.recorded_at)

    def test_what_requests_caused_is_found_among_the_last(self, store: SqlEventStore) -> None:
        head = store.claim(LAB, "test", LEASE_S)
        for causation in ("request:a", "", "another", "request:b", "request%", "request:a"):
            head = store.append(head, batch(head, 1, causation=causation))
        assert store.list_caused_by("request:", 100) == [(1, "request:a"), (4, "request:b"), (6, "request:a")]
        assert store.list_caused_by("request:", 3) == [(4, "request:b"), (6, "request:a")]
        assert store.list_caused_by("request%", 100) == [(5, "request%")]

    @pytest.mark.parametrize("sizes", [(1, 1, 1), (19, 20, 21), (1201,)])
    def test_positions_have_no_gap_whatever_the_batches(
        self, store: SqlEventStore, sizes: tuple[int, ...]
    ) -> None:
        head = store.claim(LAB, "test", LEASE_S)
        for size in sizes:
            head = store.append(head, batch(head, size))
        positions = [record.head.position for record in store.read()]
        assert positions == list(range(1, sum(sizes) + 1))

    @pytest.mark.parametrize(
        ("after", "upto", "expected"),
        [(0, 3, [1, 2, 3]), (497, 503, [498, 499, 500, 501, 502, 503]), (600, None, []), (599, 900, [600])],
    )
    def test_a_part_is_read(
        self, store: SqlEventStore, after: int, upto: int | None, expected: list[int]
    ) -> None:
        write_records(store, 600)
        assert [record.head.position for record in store.read(after, upto)] == expected

    def test_replay_gives_the_same_records_as_tuples(self, store: SqlEventStore) -> None:
        write_records(store, 600)
        expected = []
        for record in store.read():
            at = record.head
            expected.append(
                (
                    at.position,
                    at.type,
                    at.schema,
                    at.recorded_at,
                    record.payload,
                )
            )
        assert list(store.replay()) == expected
        assert list(store.replay(598)) == expected[598:]

    def test_nothing_appended_is_nothing_done(self, store: SqlEventStore) -> None:
        head = write_records(store, 2)
        assert store.append(head, []) == head

    def test_records_that_do_not_follow_are_a_programming_error(self, store: SqlEventStore) -> None:
        head = write_records(store, 2)
        for wrong in (
            batch(head, 3)[1:],
            batch(msgspec.structs.replace(head, lab=LabId("lab-2"))),
            batch(head, 1, recorded_at=5),
        ):
            with pytest.raises(ValueError, match="does not follow"):
                store.append(head, wrong)
        assert store.head() == head

    def test_a_batch_that_contradicts_the_log_is_refused_whole(self, store: SqlEventStore) -> None:
        head = write_records(store, 2)
        good, bad = batch(head, 2, stream="run:same")
        with pytest.raises(InvariantBroken, match="nothing of it was written"):
            store.append(head, [good, bad])
        assert store.head() == head
        head = store.append(head, batch(head, 30))
        with pytest.raises(InvariantBroken):
            store.append(head, batch(head, 30, stream="run:same"))
        assert store.head() == head
        assert len(list(store.read())) == 32

    def test_a_reader_sees_whole_batches_while_the_writer_appends(self, store: SqlEventStore) -> None:
        head = store.claim(LAB, "test", LEASE_S)
        done = threading.Event()
        lengths: list[int] = []

        def look() -> None:
            while not done.is_set():
                lengths.append(sum(1 for _ in store.read()))

        reader = threading.Thread(target=look)
        reader.start()
        try:
            for _ in range(30):
                head = store.append(head, batch(head, 10))
        finally:
            done.set()
            reader.join()
        assert len(lengths) > 1
        assert all(length % 10 == 0 for length in lengths)
        assert lengths == sorted(lengths)

    def test_a_gap_stops_a_reader_at_the_missing_position(self, store: SqlEventStore, store_url: str) -> None:
        write_records(store, 8)
        with raw(store_url) as database:
            database.disarm()
            database.run("DELETE FROM event WHERE position = 5")
        seen: list[int] = []
        with pytest.raises(LogDamaged) as caught:
            seen.extend(row[0] for row in store.replay())
        assert caught.value.position == 5
        assert seen == [1, 2, 3, 4]
        assert [record.head.position for record in store.read(upto=4)] == seen


class TestOneKernel:
    def test_an_append_behind_a_stale_head_is_fenced(self, store: SqlEventStore) -> None:
        first = store.claim(LAB, "test", LEASE_S)
        head = store.append(first, batch(first))
        with pytest.raises(Fenced):
            store.append(first, batch(first))
        with pytest.raises(Fenced):
            store.append(msgspec.structs.replace(head, hash=GENESIS), batch(head))
        assert store.head() == head

    def test_an_append_without_the_claim_is_fenced(
        self, store: SqlEventStore, opened: Open, store_url: str
    ) -> None:
        head = write_records(store, 1)
        with pytest.raises(Fenced):
            opened(store_url).append(head, batch(head))
        store.release(head.epoch)
        with pytest.raises(Fenced):
            store.append(head, batch(head))

    def test_every_claim_raises_the_epoch_and_keeps_the_lab(self, store: SqlEventStore) -> None:
        head = write_records(store, 1)
        store.release(head.epoch)
        again = store.claim(LabId("another"), "test", LEASE_S)
        assert again == msgspec.structs.replace(head, epoch=2)

    def test_an_older_epoch_is_fenced(self, store: SqlEventStore) -> None:
        head = write_records(store, 1)
        store.claim(LAB, "test", LEASE_S)
        with pytest.raises(Fenced):
            store.append(head, batch(head))
        with pytest.raises(Fenced):
            store.renew(head.epoch, LEASE_S)
        assert store.head().position == 1

    def test_a_second_kernel_is_refused_until_the_first_releases(
        self, store: SqlEventStore, opened: Open, store_url: str
    ) -> None:
        first = store.claim(LAB, "the first kernel", LEASE_S)
        store.renew(first.epoch, LEASE_S)
        other = opened(store_url)
        with pytest.raises(Refused, match="the first kernel"):
            other.claim(LAB, "the second kernel", LEASE_S)
        head = store.append(first, batch(first))
        store.release(first.epoch)
        assert other.claim(LAB, "the second kernel", LEASE_S).epoch == 2
        with pytest.raises(Fenced):
            store.append(head, batch(head))

    def test_a_closed_store_lets_the_next_kernel_in(
        self, store: SqlEventStore, opened: Open, store_url: str
    ) -> None:
        head = write_records(store, 1)
        store.close()
        after = opened(store_url).claim(LAB, "the next kernel", LEASE_S)
        assert (after.position, after.epoch) == (1, head.epoch + 1)

    def test_releasing_late_leaves_the_next_kernel_alone(
        self, store: SqlEventStore, opened: Open, store_url: str
    ) -> None:
        head = write_records(store, 1)
        store.close()
        other = opened(store_url)
        now = other.claim(LAB, "the next kernel", LEASE_S)
        store.release(head.epoch)
        other.renew(now.epoch, LEASE_S)
        assert other.append(now, batch(now)).position == 2
        store.close()

    def test_a_store_opened_for_reading_cannot_write(
        self, store: SqlEventStore, opened: Open, store_url: str
    ) -> None:
        head = write_records(store, 3)
        reader = opened(store_url, read_only=True)
        assert reader.head() == head
        assert list(reader.read()) == list(store.read())
        with pytest.raises(StoreUnavailable, match="reading only"):
            reader.claim(LAB, "a reader", LEASE_S)
        with pytest.raises(StoreUnavailable, match="reading only"):
            reader.save_snapshot(3, head.hash, "fold-1", b"x")


class TestSnapshots:
    def test_the_newest_snapshot_of_the_same_fold_is_loaded(self, store: SqlEventStore) -> None:
        head = write_records(store, 3)
        assert store.load_snapshot("fold-1") is None
        second = next(store.read(1, 2))
        store.save_snapshot(2, second.hash, "fold-1", b"old")
        store.save_snapshot(3, head.hash, "fold-1", bytes(range(256)))
        assert store.load_snapshot("fold-1") == (3, head.hash, bytes(range(256)))
        assert store.load_snapshot("fold-2") is None

    def test_a_snapshot_of_another_history_says_that_the_log_was_rewritten(
        self, store: SqlEventStore, opened: Open, store_url: str
    ) -> None:
        head = write_records(store, 3)
        store.save_snapshot(3, GENESIS, "fold-1", b"data")
        with pytest.raises(LogDamaged, match="position 3") as caught:
            store.load_snapshot("fold-1")
        assert caught.value.position == 3
        store.save_snapshot(4, head.hash, "fold-1", b"data")
        assert store.load_snapshot("fold-1") is None
        assert opened(store_url, read_only=True).known_position == 4

    def test_a_snapshot_that_changed_is_ignored(self, store: SqlEventStore, store_url: str) -> None:
        head = write_records(store, 3)
        store.save_snapshot(3, head.hash, "fold-1", b"data")
        with raw(store_url) as database:
            database.run("UPDATE snapshot SET data = ?", b"date")
        assert store.load_snapshot("fold-1") is None
