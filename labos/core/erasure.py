"""Erasing words: the log records the erasure; the words themselves are deleted from their storage beside the
log."""

from __future__ import annotations

import msgspec

from labos.core.registry import TYPES, Event, decode, event
from labos.core.structs import make_from
from labos.core.words import PREFIX, find_fields_of_words, list_references

REASONS = {
    "request": "the author, or the person whom the text concerns, asked for it",
    "personal": "it holds personal data that do not belong there",
    "secret": "it holds a password or something confidential",
    "mistake": "it was written in the wrong place",
    "retention": "its retention period has ended",
    "order": "a court or an authority ordered it",
}
"""The reasons for erasing words, by code. A free text would be words again."""


class ErasureEvent(Event, frozen=True):
    """``because`` is the code of a reason. The words are those of the events at the positions ``records``, or
    all words of a ``user``. ``erasure`` is the id of the request that waited for a second person; empty if
    there was none."""

    erasure: str

    def stream(self) -> str:
        return "words"


@event("words.erasure_asked")
class ErasureAsked(ErasureEvent, frozen=True):
    """A user requests an erasure of words. By the lab's policy, a second person has to agree."""

    because: str
    by: str
    records: tuple[int, ...] = ()
    user: str = ""


@event("words.erasure_refused")
class ErasureRefused(ErasureEvent, frozen=True):
    """The second person did not agree to an erasure, or it was withdrawn; it is not done."""

    by: str


@event("words.erased")
class WordsErased(ErasureEvent, frozen=True):
    """Words that were stored beside the log are erased. ``digests`` are the digests in the references to
    them; ``records`` are the positions of the events that refer to them. ``approved_by`` is the second
    person."""

    because: str
    by: str
    digests: tuple[str, ...]
    records: tuple[int, ...]
    user: str = ""
    approved_by: str = ""

    def references(self) -> list[str]:
        return [f"{PREFIX}{digest}" for digest in self.digests]


def list_erased(kind: str, schema: int, payload: bytes) -> list[str]:
    """The references to words that a stored event erased."""
    event = decode(kind, schema, payload) if kind == WordsErased.TYPE else None
    return event.references() if isinstance(event, WordsErased) else []


def list_references_in_words(kind: str, payload: bytes) -> list[str]:
    """The references in those fields of a stored event that hold people's words. A name or a value is never a
    reference, even if it looks like one."""
    event = TYPES.get(kind)
    if event is None or not list_references(payload):
        return []
    content = msgspec.json.decode(payload)
    words = [content.get(name) for name in find_fields_of_words(event)]
    return list_references("\n".join(text for text in words if isinstance(text, str)).encode())


class Erasure(ErasureAsked, frozen=True):
    """An erasure that waits for a second person since ``asked_at`` (UTC ns)."""

    asked_at: int = 0


class Erasures(msgspec.Struct):
    """``open`` are the waiting erasures by id; ``asked`` counts all erasures that have ever waited."""

    open: dict[str, Erasure] = {}
    asked: int = 0

    @property
    def next_id(self) -> str:
        return f"X{self.asked + 1}"


def fold_asked(erasures: Erasures, event: ErasureAsked, at: int) -> None:
    erasures.asked += 1
    erasures.open[event.erasure] = make_from(Erasure, event, asked_at=at)


def fold_ended(erasures: Erasures, event: ErasureRefused | WordsErased, at: int) -> None:
    erasures.open.pop(event.erasure, None)
