"""Erasing words. The caller finds the words that are stored beside the log; this module decides who may erase
them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.decide.lookups import decides_about
from labos.core.decide.policy import find_service
from labos.core.erasure import REASONS, Erasure, ErasureAsked, ErasureRefused, WordsErased
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.users import find_person

PER_EVENT = 400
"""The most digests in one event."""

MOST_RECORDS = 1000
"""The most records in one request."""

_DIGEST = re.compile("[0-9a-f]{64}")


class EraseWords(Command, frozen=True):
    """Erase the words of the events at the positions ``records``, or all words of a ``user``. ``found`` are
    digests of their references, each with the position of its event. With ``erasure``, a second person agrees
    to the waiting erasure with this id."""

    because: str
    by: str
    found: tuple[tuple[int, str], ...]
    records: tuple[int, ...] = ()
    user: str = ""
    erasure: str = ""


class RefuseErasure(Command, frozen=True):
    """Refuse an erasure that waits for a second person."""

    erasure: str
    by: str


def _expect_erasure(state: LabState, command: EraseWords | RefuseErasure) -> Erasure | Rejection:
    found = state.erasures.open.get(command.erasure)
    missing = f"No erasure {command.erasure!r} waits for a second person."
    return found or Rejection("no_erasure", missing, "List: labos erase")


@decides(EraseWords)
def erase_words(state: LabState, command: EraseWords) -> Decision:
    wrong = _check_erasure(state, command)
    if wrong:
        return wrong
    if not state.approvals.policy.erasure and not command.erasure:
        return list(_erase(command, command.by, ""))
    if not command.erasure:
        return [make_from(ErasureAsked, command, erasure=state.erasures.next_id)]
    asked = _expect_erasure(state, command)
    if isinstance(asked, Rejection):
        return asked
    if find_person(asked.by) == find_person(command.by):
        return Rejection(
            "same_person",
            f"{command.by} requested {command.erasure}, and the policy requires a second person.",
            "Let another admin agree: labos erase --approve",
        )
    if (asked.because, asked.records, asked.user) != (command.because, command.records, command.user):
        return Rejection(
            "changed", f"{command.erasure} was requested with other values.", "See its request: labos erase"
        )
    return list(_erase(command, asked.by, command.by))


def _erase(command: EraseWords, by: str, approved_by: str) -> Iterator[Event]:
    for begin in range(0, len(command.found), PER_EVENT):
        some = command.found[begin : begin + PER_EVENT]
        yield make_from(
            WordsErased,
            command,
            by=by,
            digests=tuple(digest for _, digest in some),
            records=tuple(dict.fromkeys(position for position, _ in some)),
            approved_by=approved_by,
        )


@decides_about(RefuseErasure, _expect_erasure)
def refuse_erasure(state: LabState, command: RefuseErasure, asked: Erasure) -> Decision:
    return [ErasureRefused(command.erasure, command.by)]


def _check_erasure(state: LabState, command: EraseWords) -> Rejection | None:
    if command.because not in REASONS:
        return Rejection(
            "no_reason",
            f"{command.because!r} is not a valid reason to erase words.",
            f"Known: {', '.join(REASONS)}.",
        )
    if bool(command.records) == bool(command.user) or len(command.records) > MOST_RECORDS:
        return Rejection(
            "no_words",
            f"Name the words to erase by 1 to {MOST_RECORDS} positions, or by a user.",
            "Find them: labos log",
        )
    if not command.found:
        return Rejection(
            "no_words",
            "There are no erasable words at these positions: none were written, or they are already "
            "erased, or they were written by a LabOS that could not erase words.",
            "Look: labos log",
        )
    if not all(_DIGEST.fullmatch(digest) for _, digest in command.found):
        return Rejection("no_words", "A digest is not a SHA-256.")
    service = find_service(state, command.by)
    if service:
        return Rejection(
            "no_person", f"{service} is a program, and programs may not erase words.", "Ask an admin."
        )
    return None
