"""Canonical JSON: one value, one sequence of bytes.

Keys are sorted, there is no white space, and numbers that are not finite are refused (RFC 8259 has no
spelling for them). Values that JSON can express but other formats cannot are refused too. These are whole
numbers beyond 64 bits, unpaired surrogates (text that has no UTF-8), and lists that are nested too deeply.
Every value in the log gets into snapshots and clients, so these values are refused here, before they are
recorded.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import msgspec

DEEPEST = 100
"""Lists and objects may be nested at most this deep."""

LEAST, MOST = -(2**63), 2**64 - 1
"""The smallest signed and the largest unsigned whole number of 64 bits."""

_encoder = msgspec.json.Encoder(order="sorted")
# MessagePack has the same values and only 64 bits: encoding is the cheapest check of every number in a value.
_measure = msgspec.msgpack.Encoder()
# A number that is not finite contains these bytes in MessagePack: the mark of a float, and the first byte of
# an exponent whose bits are all ones. Other values may contain them by chance.
_NOT_FINITE = (b"\xcb\x7f", b"\xcb\xff")
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def encode_canonical(value: Any) -> bytes:
    """Encode a JSON value or a msgspec Struct. Raises ValueError for NaN and infinities, whole numbers beyond
    64 bits, text that has no UTF-8, and more than ``DEEPEST`` nested lists and objects."""
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
    """Raise ValueError that describes the first value that cannot be recorded."""
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
    """The parts of a list or an object; none for a number or a text."""
    if isinstance(value, dict):
        return [*value, *value.values()]
    if isinstance(value, list | tuple | set | frozenset):
        return list(value)
    if isinstance(value, msgspec.Struct):
        return [getattr(value, field) for field in value.__struct_fields__]
    return []


def _measure_depth(data: bytes) -> int:
    """How deep the brackets of canonical JSON are nested, without the brackets in texts."""
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
    return ValueError(
        f"Lists and objects are nested more than {DEEPEST} levels deep; that cannot be recorded."
    )


def digest(data: bytes) -> str:
    """SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
