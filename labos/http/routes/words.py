"""Erasing what people wrote: reasons, notes and comments, which stand beside the log."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Annotated, Protocol, cast

import msgspec

from labos.core.decide.erasure import MOST_RECORDS, EraseWords, RefuseErasure
from labos.core.erasure import REASONS, Erasure, ErasureAsked, WordsErased
from labos.core.registry import TYPES
from labos.core.structs import make_from
from labos.core.words import PREFIX, find_fields_of_words, list_references
from labos.errors import NotFound, Refused
from labos.http.limits import Asker, Name, Time, says
from labos.http.operation import Call, Method, administer, read
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


_CODES = ", ".join(f"`{code}` ({why})" for code, why in REASONS.items())


class OfErasure(msgspec.Struct, frozen=True):
    erasure: Annotated[Name, says("the id of an erasure that waits for a second person", "X1")]


class NewErasure(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Either ``records`` or a ``user``."""

    because: Annotated[Name, says(f"a code: {_CODES}")]
    by: Asker = ""
    records: Annotated[
        list[Time],
        msgspec.Meta(max_length=MOST_RECORDS),
        says("positions of the events whose words are erased"),
    ] = []
    user: Annotated[Name, says("erase the words of all events of this user")] = ""


class Agreement(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    by: Asker = ""


class ErasureView(msgspec.Struct, frozen=True):
    """A request of ``by`` at ``asked_at`` (UTC nanoseconds) that waits for a second person under the id
    ``erasure``."""

    erasure: str
    because: str
    by: str
    records: tuple[int, ...]
    user: str
    asked_at: int


class Erasures(msgspec.Struct, frozen=True):
    erasures: list[ErasureView]


class ErasureReference(msgspec.Struct, frozen=True):
    erasure: str


_DONE = {"erasure": "", "erased": 1, "records": [120], "position": 245, "left": ""}


@read(
    route="GET /words/erasures",
    client=Method("erasures", take="erasures"),
    summary="List the erasures that wait for a second person",
)
def list_erasures(call: Call) -> Erasures:
    waiting = call.kernel.state.erasures.open
    return Erasures([make_from(ErasureView, each, erasure=name) for name, each in waiting.items()])


@administer(
    route="POST /words/erasures",
    client=Method("erase_words"),
    summary="Erase what people wrote into events",
    at_kernel=True,
    problems=("not_found", "refused"),
    example={"records": [120], "because": "personal", "by": "ada"},
    example_answer=_DONE,
)
async def erase_words(call: Call, body: NewErasure) -> ErasureDone:
    """The texts and the salts of their digests are deleted. The events stay, and the log still verifies. Each
    text is then shown as `(erased)`. An event records the erasure, the user and the reason. If the policy has
    `erasure: true`, nothing is deleted before a second admin has agreed."""
    return await erase(call, body.because, body.by, body.records, body.user)


@administer(
    route="POST /words/erasures/{erasure}/approve",
    client=Method("approve_erasure"),
    summary="Agree to an erasure, as the second person",
    at_kernel=True,
    example={"by": "olga"},
    example_answer=_DONE,
)
async def approve_erasure(call: Call, path: OfErasure, body: Agreement) -> ErasureDone:
    """The user who asked for the erasure cannot agree to it. The present words at these events are erased."""
    asked = _find_erasure(call, path.erasure)
    return await erase(call, asked.because, body.by, asked.records, asked.user, path.erasure)


@administer(
    route="POST /words/erasures/{erasure}/refuse",
    client=Method("refuse_erasure", take="erasure", repeat=True),
    summary="Refuse an erasure that waits for a second person",
    example={"by": "olga"},
    example_answer={"erasure": "X1"},
)
async def refuse_erasure(call: Call, path: OfErasure, body: Agreement) -> ErasureReference:
    """Nothing is erased. The user who asked can withdraw the request in this way."""
    _find_erasure(call, path.erasure)
    await call.kernel.execute(RefuseErasure(path.erasure, body.by), body.by)
    return ErasureReference(path.erasure)


def _find_erasure(call: Call, name: str) -> Erasure:
    """Raises NotFound."""
    found = call.kernel.state.erasures.open.get(name)
    if found is None:
        raise NotFound(f"No erasure {name!r} waits for a second person.", remedy="List them: labos erase")
    return found


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
