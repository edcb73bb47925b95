"""People's words in a backup: a file that is rewritten with each backup, so that erased words disappear from
it.

They are not part of the segments, which never change. Each line is either a text with its salt, which is
checked against the reference in its event, or the mark that it was erased.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from labos.core.envelope import Record
from labos.core.erasure import list_erased, list_references_in_words
from labos.core.words import Kept
from labos.errors import LogDamaged
from labos.ports import StoredWords
from labos.private import replace_file

WORDS = "words.jsonl"


class _Line(msgspec.Struct, frozen=True):
    reference: str
    position: int
    salt: str = ""
    text: str = ""
    erased_at: int = 0


_decoder = msgspec.json.Decoder(_Line)


def copy_words(words: Iterable[StoredWords], folder: Path, upto: int) -> None:
    """Write the words of events up to a position."""
    lines = []
    for each in words:
        if each.position > upto:
            continue  # the backup does not have its event yet
        kept = each.words
        line = _Line(kept.reference, each.position, kept.salt.hex(), kept.text, each.erased_at)
        lines.append(msgspec.json.encode(line) + b"\n")
    if lines or (folder / WORDS).exists():
        replace_file(folder / WORDS, b"".join(lines))


def read_words_copy(folder: Path) -> Iterator[StoredWords]:
    """The words in a backup. Raises LogDamaged."""
    path = folder / WORDS
    if not path.exists():
        return
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        try:
            entry = _decoder.decode(line)
            kept = Kept(entry.reference, bytes.fromhex(entry.salt), entry.text)
        except (msgspec.MsgspecError, ValueError) as error:
            raise _report_damage(0, f"{path}:{number}: this is not a text of a backup ({error})") from None
        if not kept.is_genuine:
            raise _report_damage(
                entry.position, f"{path}:{number}: the text was changed after it was written"
            )
        yield StoredWords(kept, entry.position, entry.erased_at)


class WordsExpected:
    """Checks, from the records of a backup, that all words are there."""

    def __init__(self, folder: Path) -> None:
        self._known = {each.words.reference: each.words.is_erased for each in read_words_copy(folder)}
        self._named: dict[str, int] = {}

    def take(self, record: Record) -> None:
        head = record.head
        for reference in list_erased(head.type, head.schema, record.payload):
            self._named.pop(reference, None)
            if self._known.get(reference) is False:
                raise _report_damage(
                    head.position, f"{WORDS} contains words that are erased in the backup's log"
                )
        for reference in list_references_in_words(head.type, record.payload):
            self._named.setdefault(reference, head.position)

    def end(self) -> None:
        """Raises LogDamaged if words are missing."""
        for reference, position in self._named.items():
            if reference not in self._known:
                raise _report_damage(position, f"its words are missing from {WORDS}")


def _report_damage(position: int, fault: str) -> LogDamaged:
    where = f"Position {position}: " if position else ""
    return LogDamaged(
        f"{where}{fault}.", position=position, remedy="Use another copy of the backup; keep this one."
    )
