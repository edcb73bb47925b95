"""Canonical JSON: one value, one sequence of bytes.

Keys are sorted, there is no white space, and numbers that are not finite are refused
(RFC 8259 has no spelling for them). So is what JSON can spell and others cannot hold: whole numbers beyond
64 bits, halves of surrogate pairs (text that has no UTF-8), and lists in lists without end. What is once in
the log goes into every snapshot and every client, so it is refused here, before it is recorded.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import msgspec

DEEPEST = 100
"""So many lists and objects may stand in one another."""

LEAST, MOST = -(2**63), 2**64 - 1
"""The whole numbers that 64 bits can hold, with a sign or without."""

_encoder = msgspec.json.Encoder(order="sorted")
# It knows the same values and only 64 bits: the cheapest way to look at every number of a value.
_measure = msgspec.msgpack.Encoder()
# Bytes without which MessagePack holds no number that is not finite: the mark of a float, and the first
# byte of an exponent that is all ones. They may also stand there by chance.
_NOT_FINITE = (b"\xcb\x7f", b"\xcb\xff")
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def encode_canonical(value: Any) -> bytes:
    """Encode a JSON value or a msgspec Struct. Raises ValueError for NaN and infinities, whole numbers
    beyond 64 bits, text that has no UTF-8, and more than ``DEEPEST`` lists and objects in one another."""
    try:
        packed = _measure.encode(value)
        data = _encoder.encode(value)
    except (OverflowError, UnicodeEncodeError, RecursionError):
        _refuse(value)
        raise
    if data.count(b"[") + data.count(b"{") > DEEPEST and _measure_depth(data) > DEEPEST:
        raise _make_depth_error()
    if _NOT_FINITE[0] in packed or _NOT_FINITE[1] in packed:
        refuse_non_finite(value)
    return data


def refuse_non_finite(value: Any) -> None:
    """Raise ValueError if a float somewhere in the value is not finite."""
    waiting = [value]
    while waiting:
        item = waiting.pop()
        if type(item) is float and not math.isfinite(item):
            raise ValueError(f"{item} is not a finite number and cannot be recorded.")
        waiting.extend(_list_inner(item))


def _refuse(value: Any) -> None:
    """Raise ValueError in words for the first thing in a value that cannot be recorded."""
    waiting = [(value, 1)]
    while waiting:
        item, depth = waiting.pop()
        if depth > DEEPEST + 1:
            raise _make_depth_error()
        if isinstance(item, int) and not LEAST <= item <= MOST:
            raise ValueError("A whole number does not fit into 64 bits and cannot be recorded.")
        if isinstance(item, str):
            try:
                item.encode()
            except UnicodeEncodeError:
                raise ValueError(
                    f"The text {item[:40]!r} holds half a surrogate pair and cannot be recorded."
                ) from None
        waiting.extend((inner, depth + 1) for inner in _list_inner(item))


def _list_inner(value: Any) -> list[Any]:
    """What a value is made of; nothing for a number or a text."""
    if isinstance(value, dict):
        return [*value, *value.values()]
    if isinstance(value, list | tuple | set | frozenset):
        return list(value)
    if isinstance(value, msgspec.Struct):
        return [getattr(value, field) for field in value.__struct_fields__]
    return []


def _measure_depth(data: bytes) -> int:
    """How deep the brackets of canonical JSON stand in one another. Those in texts count for nothing."""
    pieces = data.replace(rb"\\", b"").replace(rb"\"", b"").split(b'"')
    depth = deepest = 0
    for bracket in b"".join(pieces[::2]).translate(None, _NO_BRACKETS):
        if bracket in b"[{":
            depth += 1
            deepest = max(deepest, depth)
        else:
            depth -= 1
    return deepest


def _make_depth_error() -> ValueError:
    return ValueError(f"More than {DEEPEST} lists and objects stand in one another; that cannot be recorded.")


def digest(data: bytes) -> str:
    """SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
