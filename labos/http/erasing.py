"""Erases words: finds the words beside the log; the core decides that they are erased."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Protocol, cast

import msgspec

from labos.core.decide.erasure import EraseWords
from labos.core.erasure import ErasureAsked, WordsErased
from labos.core.registry import TYPES
from labos.core.words import PREFIX, find_fields_of_words, list_references
from labos.errors import NotFound, Refused
from labos.http.operation import Call
from labos.services.log import Log

Found = tuple[tuple[int, str], ...]
"""Digests of references to words, each with the position of an event that contains it."""


class ErasingLog(Log, Protocol):
    """A log with a list of the words that are stored beside it."""

    def words_by(self, user: str) -> list[tuple[int, str]]: ...


class ErasureDone(msgspec.Struct, frozen=True):
    """``erased`` is the number of deleted texts, and ``records`` are the positions of their events.
    ``position`` is the position of the event that records the erasure. ``left`` says where in the database's
    files bytes of the texts may remain (empty: nowhere). With an ``erasure``, nothing is deleted yet: it
    waits under this id for a second person."""

    erasure: str
    erased: int
    records: list[int]
    position: int
    left: str


async def erase(
    call: Call, because: str, by: str, records: Sequence[int], user: str, erasure: str = ""
) -> ErasureDone:
    """Erase words, or request the agreement of a second person. Raises NotFound, Refused, Forbidden."""
    log = cast(ErasingLog, call.service.parts.store)
    found = await asyncio.to_thread(_find, log, tuple(records), user, call.kernel.durable)
    command = EraseWords(because, by, found, tuple(records), user, erasure)
    events = await call.kernel.execute(command, by)
    asked = next((event for event in events if isinstance(event, ErasureAsked)), None)
    if asked is not None:
        return ErasureDone(asked.erasure, 0, [], 0, "")
    position = call.kernel.durable
    gone = [event for event in events if isinstance(event, WordsErased)]
    left = await call.kernel.scrub()
    positions = sorted({at for event in gone for at in event.records})
    return ErasureDone("", sum(len(event.digests) for event in gone), positions, position, left)


def _find(log: ErasingLog, records: tuple[int, ...], user: str, durable: int) -> Found:
    named = (
        log.words_by(user) if user else [pair for at in records for pair in _list_words_at(log, at, durable)]
    )
    first = {reference: position for position, reference in reversed(named)}
    standing = [kept for kept in log.words_of(first).values() if not kept.is_erased]
    digests = [(first[kept.reference], kept.reference.removeprefix(PREFIX)) for kept in standing]
    return tuple(sorted(digests))


def _list_words_at(log: ErasingLog, position: int, durable: int) -> list[tuple[int, str]]:
    """The references in a record. Raises NotFound, and Refused for a record whose words are in the log
    itself."""
    record = next(log.read(position - 1, position), None) if 0 < position <= durable else None
    if record is None:
        raise NotFound(f"The log has no position {position}.", remedy="Find it: labos log")
    found = list_references(record.payload)
    if found:
        return [(position, reference) for reference in found]
    kind = TYPES.get(record.head.type)
    content = msgspec.json.decode(record.payload)
    if kind is not None and any(content.get(name) for name in find_fields_of_words(kind)):
        raise Refused(
            f"The words of position {position} are in the log itself: they were written by LabOS, or "
            "by a version that could not erase words.",
            remedy="The content of the log itself cannot be erased.",
        )
    return []
