"""Limits of what a node accepts and sends: texts, values, messages.

A device's messages end up in the log, where an event has at most 64 KB. So they are cut here, and the whole
text goes to the node's own log file.
"""

from __future__ import annotations

import math
import re
from collections import deque
from typing import Any, TypeVar

import msgspec
import structlog

from labos.core.texts import CONTROL_IN_NOTE, strip_unprintable
from labos.core.texts import cut as cut_text
from labos.errors import Unreadable

T = TypeVar("T")

TEXT_LIMIT = 2_000
"""The most characters of a text from a device or its driver."""

NAME_LIMIT = 200
"""The most characters of a name: of an action, or of the person who stopped a module."""

DEPTH_LIMIT = 50
"""How deep lists and tables may be nested."""

RESULT_LIMIT = 48 * 1024
"""The most bytes of JSON of a result; larger data belongs in a file."""

MESSAGE_LIMIT = 256 * 1024
"""The most bytes of a request. Requests of LabOS itself have at most 64 KB."""

REPLY_LIMIT = 4 * 1024 * 1024
"""The most bytes of an answer, and of a message with a part of a file."""

_LOGGED = 20_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:@-]{0,199}")
_INTEGERS = range(-(2**63), 2**63)

_logged: deque[int] = deque(maxlen=32)
_log = structlog.get_logger(__name__)
_encode = msgspec.json.Encoder().encode


def cut(text: str, limit: int = TEXT_LIMIT) -> str:
    """A text in the form for sending and recording: at most ``limit`` characters, without control characters
    and unpaired surrogates. If a text is cut, the whole text is written to the node's log file."""
    clean = strip_unprintable(text)
    if len(clean) <= limit:
        return clean
    _log_once(clean)
    ending = f" … (cut: it has {len(clean)} characters, see the node's log file)"
    return clean[: limit - len(ending)] + ending


def _log_once(text: str) -> None:
    """Log a text only once, because a device may send the same text every second."""
    mark = hash(text)
    if mark not in _logged:
        _logged.append(mark)
        _log.warning("text_cut", characters=len(text), text=text[:_LOGGED])


def cut_name(text: object) -> str:
    """The name that a sender gives itself, as one short line; empty if it is not text."""
    return cut(" ".join(text[:10_000].split()), NAME_LIMIT) if isinstance(text, str) else ""


def is_name(text: str) -> bool:
    """Whether an id is valid in a key of the bus and in a message to a person."""
    return _NAME.fullmatch(text) is not None


def find_flaw(value: Any, *, limit: int = RESULT_LIMIT) -> str:
    """Why a value of plain JSON types cannot be recorded; empty if it can. ``limit`` is in bytes."""
    level, depth = [value], 0
    while level:
        if depth > DEPTH_LIMIT:
            return f"it is nested deeper than {DEPTH_LIMIT} levels"
        if len(level) > limit:
            return f"it has more than {limit} parts"
        for item in level:
            if flaw := _find_flaw_of_one(item):
                return flaw
        level = [inner for item in level for inner in _list_inner(item)]
        depth += 1
    size = len(_encode(value))
    return f"it has {size} bytes; {limit} are allowed" if size > limit else ""


def _list_inner(item: Any) -> list[Any]:
    if isinstance(item, dict):
        return [*item, *item.values()]
    return list(item) if isinstance(item, list | tuple) else []


def _find_flaw_of_one(item: Any) -> str:
    match item:
        case bool():
            return ""
        case int() if item not in _INTEGERS:
            return "it holds an integer of more than 64 bits"
        case float() if not math.isfinite(item):
            return f"{item} is not a finite number"
        case str() if not item.isascii() and CONTROL_IN_NOTE.search(item) and not _is_unicode(item):
            return "it holds a text that is not Unicode"
    return ""


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def read(
    payload: bytes, decoder: msgspec.json.Decoder[T], *, whose: str = "", limit: int = MESSAGE_LIMIT
) -> T:
    """A message from the bus, of at most ``limit`` bytes. ``whose`` names the sender. Raises Unreadable."""
    what = f"The message of {whose}" if whose else "The message"
    if len(payload) > limit:
        raise Unreadable(f"{what} has {len(payload)} bytes; {limit} are allowed.")
    try:
        return decoder.decode(payload)
    except (msgspec.MsgspecError, ValueError) as error:  # a number of 5,000 digits raises ValueError
        raise Unreadable(f"{what} cannot be read: {cut_text(str(error), NAME_LIMIT)}.") from error
    except RecursionError:
        raise Unreadable(f"{what} is nested too deeply.") from None
