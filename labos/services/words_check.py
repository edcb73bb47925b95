"""The check of ``labos verify`` for words: whether they are unchanged since they were written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from labos.core.erasure import list_erased, list_references_in_words
from labos.ports import Log, StoredWords
from labos.services.verification import VerifiedPart


class WordsStore(Log, Protocol):
    """A log with words beside it."""

    def all_words(self) -> Iterator[StoredWords]: ...
    def erasures(self) -> Mapping[str, int]: ...


def check_words(store: WordsStore) -> VerifiedPart:
    """Whether each text beside the log is unchanged, and whether an event explains each missing text. The
    event is in this log, or in a newer copy of it that the lab's folder knows of. Raises StoreUnavailable,
    BadInput."""
    named, erased = _count_references(store)
    elsewhere = store.erasures()
    found: list[tuple[int, str]] = []
    whole = gone = apart = 0
    for standing in store.all_words():
        name, position = standing.words.reference, standing.position
        named.pop(name, None)
        if standing.words.is_erased:
            gone += name in erased
            apart += name not in erased and name in elsewhere
            if name not in erased and name not in elsewhere:
                found.append((position, "words are gone, but no event records their erasure"))
        elif name in erased:
            found.append((position, f"words are there although they were erased at position {erased[name]}"))
        elif not standing.words.is_genuine:
            found.append((position, "the words stored beside the log were changed after they were written"))
        else:
            whole += 1
    found += [
        (position, "words are missing beside the log, but no event records their erasure")
        for name, position in named.items()
        if name not in erased
    ]
    found.sort()
    result = f"Words beside the log: {whole} are unchanged, {gone} were erased"
    result += f", {apart} in a newer copy of this log." if apart else "."
    faults = tuple(f"Position {position}: {fault}." for position, fault in found)
    return VerifiedPart(
        "words", whole + gone + apart + len(found), result, faults, tuple(at for at, _ in found)
    )


def _count_references(log: Log) -> tuple[dict[str, int], dict[str, int]]:
    """The references in fields of words, and the references that events list as erased; each with its
    position."""
    named: dict[str, int] = {}
    erased: dict[str, int] = {}
    for position, kind, schema, _, payload in log.replay():
        erased.update((reference, position) for reference in list_erased(kind, schema, payload))
        for reference in list_references_in_words(kind, payload):
            named.setdefault(reference, position)
    return named, erased
