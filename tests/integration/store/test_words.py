"""Words stand beside the log in the same transaction as their events, and are erased in that of another."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import sqlalchemy

from labos.core.envelope import Record
from labos.core.erasure import WordsErased
from labos.core.registry import encode
from labos.core.words import PREFIX, Kept, keep
from labos.errors import StoreError
from labos.ports import Head, LogQuery
from labos.services.verification import check_words
from labos.store import SqlEventStore, find_first_damage, parse_url, read_erasures
from tests.integration.store.records import LAB, LEASE_S, batch

SALT = bytes(range(16))
TEXT = "Zoë Quux says: it's her cold\nand 100 % of it"


def pause_with_words(after: Head, text: str, salt: bytes = SALT, actor: str = "bo") -> tuple[Record, Kept]:
    """A pause with words of its own."""
    words = keep(text, salt)
    payload = {"target": "*", "by": actor, "why": words.reference}
    (record,) = batch(after, payload=payload, type="starts.paused", stream="*", version=after.position + 1)
    return msgspec.structs.replace(record, words=(words,)), words


def make_erasure(after: Head, *words: Kept, because: str = "personal") -> Record:
    digests = tuple(each.reference.removeprefix(PREFIX) for each in words)
    event = WordsErased("", because, "ada", digests, (1,))
    payload = msgspec.json.decode(encode(event))
    return batch(after, payload=payload, type=event.TYPE, stream="words", version=after.position + 1)[0]


def test_words_come_and_go_with_their_events(store: SqlEventStore) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    record, words = pause_with_words(head, TEXT)
    head = store.append(head, [record])
    assert store.words_of([words.reference, f"{PREFIX}{'0' * 64}"]) == {words.reference: words}
    assert [(each.words, each.position, each.erased_at) for each in store.all_words()] == [(words, 1, 0)]
    assert check_words(store).faults == ()
    head = store.append(head, [make_erasure(head, words)])
    gone = Kept(words.reference, b"", "")
    assert store.words_of([words.reference]) == {words.reference: gone}
    assert [each.erased_at for each in store.all_words()] == [2]
    assert store.scrub() == ""
    assert find_first_damage(store) is None
    found = check_words(store)
    assert (found.faults, found.checked) == ((), 1)
    assert "1 were erased" in found.result


def test_a_batch_that_is_not_written_leaves_no_words(store: SqlEventStore) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    record, words = pause_with_words(head, TEXT)
    with pytest.raises(StoreError):
        store.append(msgspec.structs.replace(head, epoch=head.epoch + 7), [record])
    assert store.words_of([words.reference]) == {}


def test_words_of_a_user_are_found(store: SqlEventStore) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    texts: dict[str, Kept] = {}
    for number, actor in enumerate(("bo", "ada", "robot for bo", "not for_bo")):
        words = keep("the same", bytes([number]) * 16)
        payload = {"target": "*", "by": actor, "why": words.reference}
        (record,) = batch(
            head, payload=payload, type="starts.paused", stream="*", version=number + 1, actor=actor
        )
        head = store.append(head, [msgspec.structs.replace(record, words=(words,))])
        texts[actor] = words
    assert len({words.reference for words in texts.values()}) == 4
    named = [texts[name].reference for name in ("bo", "robot for bo")]
    assert store.words_by("bo") == [(1, named[0]), (3, named[1])]
    store.append(head, [make_erasure(head, texts["bo"])])
    assert store.words_by("bo") == [(3, named[1])]


def test_the_log_is_searched_for_words_that_stand_beside_it(store: SqlEventStore) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    record, words = pause_with_words(head, TEXT)
    head = store.append(head, [record, *batch(msgspec.structs.replace(head, position=1, hash=record.hash))])
    assert [r.head.position for r in store.select(LogQuery(mentions="Zoë Quux"))] == [1]
    assert [r.head.position for r in store.select(LogQuery(mentions="100 % of"))] == [1]
    store.append(head, [make_erasure(head, words)])
    assert list(store.select(LogQuery(mentions="Zoë Quux"))) == []


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ("UPDATE words SET text = 'I am well'", "were changed after they were written"),
        ("UPDATE words SET salt = '', text = '', erased_at = 9", "no event records their erasure"),
        ("DELETE FROM words", "are missing beside the log"),
    ],
)
def test_words_that_somebody_changed_are_found(
    store: SqlEventStore, store_url: str, change: str, fault: str
) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    store.append(head, [pause_with_words(head, TEXT)[0]])
    engine = sqlalchemy.create_engine(parse_url(store_url))
    with engine.begin() as connection:
        connection.exec_driver_sql(change.replace("%", "%%"))
    engine.dispose()
    found = check_words(store)
    assert found.positions == (1,)
    assert fault in found.faults[0]
    assert find_first_damage(store) is None


def test_words_that_are_put_back_after_they_were_erased_are_found(
    store: SqlEventStore, store_url: str
) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    record, words = pause_with_words(head, TEXT)
    head = store.append(head, [record])
    store.append(head, [make_erasure(head, words)])
    engine = sqlalchemy.create_engine(parse_url(store_url))
    with engine.begin() as connection:
        connection.execute(
            sqlalchemy.text("UPDATE words SET salt = :salt, text = :text, erased_at = 0"),
            {"salt": words.salt, "text": words.text},
        )
    engine.dispose()
    assert "are there although they were erased at position 2" in check_words(store).faults[0]


def test_erasures_are_noted_beside_the_database(
    store: SqlEventStore, store_url: str, tmp_path: Path, opened: Callable[..., SqlEventStore]
) -> None:
    head = store.claim(LAB, "test", LEASE_S)
    record, words = pause_with_words(head, TEXT)
    head = store.append(head, [record])
    file = tmp_path / "labos.erased"
    assert not file.exists()
    store.append(head, [make_erasure(head, words)])
    assert [(e.lab, e.reference, e.position) for e in read_erasures(file)] == [(LAB, words.reference, 2)]
    assert store.erasures() == {words.reference: 2}
    file.write_bytes(b'{"lab":"torn')  # a kernel died before it was written
    store.close()
    again = opened(store_url)
    again.claim(LAB, "test", LEASE_S)
    assert again.erasures() == {words.reference: 2}


def test_nothing_of_the_text_is_left_in_the_files_of_sqlite(
    tmp_path: Path, opened: Callable[..., SqlEventStore]
) -> None:
    store = opened(f"sqlite:///{tmp_path / 'lab.db'}")
    head = store.claim(LAB, "test", LEASE_S)
    kept = []
    for number in range(300):  # several pages of the table, which are split as they fill
        record, words = pause_with_words(head, f"Quux {number} " + "nobody should read this " * (number % 40))
        kept.append(words)
        head = store.append(head, [record])
    mark = b"nobody should read this"
    reader = opened(f"sqlite:///{tmp_path / 'lab.db'}", read_only=True)
    assert len(list(reader.all_words())) == 300  # and has its connection open
    files = [tmp_path / "lab.db", tmp_path / "lab.db-wal"]
    assert any(mark in file.read_bytes() for file in files)
    for words in kept:
        head = store.append(head, [make_erasure(head, words)])
    assert store.scrub() == ""
    assert not any(mark in file.read_bytes() for file in tmp_path.iterdir())
    assert find_first_damage(store) is None
    assert check_words(store).faults == ()
