"""The maximum lengths of texts. Every command is checked here once, before it is decided.

A request of a person or program is refused if a text is too long or has a form that cannot be recorded. A
report of a device or node is never refused because of its texts, since it reports a past event: its texts are
cut.
"""

from __future__ import annotations

from functools import cache
from typing import Any, get_args, get_origin

import msgspec

from labos.core.decide._base import Command, Rejection, Report
from labos.core.decide.wording import list_words
from labos.core.texts import (
    CONTROL,
    CONTROL_IN_NOTE,
    LONGEST_NAME,
    LONGEST_NOTE,
    LONGEST_REASON,
    LONGEST_REPORT,
    cut,
)

BAD_TEXT = "bad_text"
"""The code of a rejection for a text that is too long, or has a form that cannot be recorded."""

_LONGEST = {"note": LONGEST_NOTE, "why": LONGEST_REASON}
"""The maximum lengths of certain fields; all others have that of names."""

MOST_REPORTED = 1_000
"""The most items of a list in a report; the others are dropped."""


def cut_report(report: Report) -> Report:
    """The report with its texts and lists cut to their limits."""
    changed: dict[str, object] = {}
    fields = _find_fields(type(report))
    for name in fields.texts:
        text = getattr(report, name)
        if len(text) > LONGEST_REPORT or CONTROL_IN_NOTE.search(text):
            changed[name] = cut(text)
    for name in fields.lists:
        if len(items := getattr(report, name)) > MOST_REPORTED:
            changed[name] = items[:MOST_REPORTED]
    return msgspec.structs.replace(report, **changed) if changed else report


def shorten_report(report: Report) -> Report:
    """The report without its largest parts: with short texts, and without a result."""
    texts = _find_fields(type(report)).texts
    changed: dict[str, object] = {name: cut(getattr(report, name), LONGEST_NAME) for name in texts}
    if "result" in report.__struct_fields__:
        changed["result"] = None
    return msgspec.structs.replace(report, **changed)


def refuse_misfit(command: Command) -> Rejection | None:
    """Why the texts of a request cannot be recorded; None if they can."""
    fields = _find_fields(type(command))
    texts = [(getattr(command, field), field) for field in fields.texts]
    for field in fields.several:
        texts += [(text, field) for text in getattr(command, field)]
    texts += list_words(command)
    for text, field in texts:
        if text and (fault := find_fault(text, field)):
            return Rejection(BAD_TEXT, fault, "Shorten it, or hand in long text as a file.")
    return next(filter(None, map(refuse_misfit, command.list_parts())), None)


def find_fault(text: str, field: str) -> str:
    """The fault of a text of a request, as a sentence; empty if it has none."""
    most = _LONGEST.get(field, LONGEST_NAME)
    if len(text) > most:
        return f"The field {field!r} has {len(text)} characters; {most} are allowed."
    if (CONTROL_IN_NOTE if field == "note" else CONTROL).search(text):
        kind = "control characters" if field == "note" else "control characters or line breaks"
        return f"The field {field!r} has {kind}, which are not allowed there."
    return ""


class _Fields(msgspec.Struct, frozen=True):
    """The fields of a command that are texts, that are lists of texts, and that are lists of any kind."""

    texts: list[str]
    several: list[str]
    lists: list[str]


@cache
def _find_fields(kind: type[Command]) -> _Fields:
    fields = [(field.name, field.type) for field in msgspec.structs.fields(kind)]
    return _Fields(
        [name for name, kind in fields if _is_text(kind)],
        [name for name, kind in fields if any(map(_is_text, get_args(kind)[:1]))],
        [name for name, kind in fields if get_origin(kind) is tuple],
    )


def _is_text(kind: Any) -> bool:
    return getattr(kind, "__supertype__", kind) is str
