"""Framing: the boundaries between messages, independent of the wire."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

LIMIT = 64 * 1024
"""The number of bytes without a message end after which a stream counts as noise."""


class BadFrame(ValueError):
    """Bytes that are not a message; they have been removed from the buffer."""


class Framing(Protocol):
    """Packs messages for the wire and finds messages in the received bytes."""

    def pack(self, message: bytes) -> bytes: ...

    def take(self, buffer: bytearray) -> bytes | None:
        """The first message in the buffer, removed from it; None while it is not whole. Raises
        BadFrame."""


class Terminated:
    """Messages that end with certain bytes, and may begin with certain others. Bytes between an end and the
    next beginning are padding if all of them are in ``padding``, otherwise noise.
    """

    def __init__(
        self,
        end: bytes = b"\r\n",
        *,
        start: bytes = b"",
        send_end: bytes | None = None,
        padding: bytes = b"\r\n",
        limit: int = LIMIT,
    ) -> None:
        if not end:
            raise ValueError("a terminated message needs a terminator")
        self._start, self._end = start, end
        self._send_end = end if send_end is None else send_end
        self._padding, self._limit = padding, limit

    def pack(self, message: bytes) -> bytes:
        return self._start + message + self._send_end

    def take(self, buffer: bytearray) -> bytes | None:
        if self._start:
            self._skip_padding(buffer)
        at = buffer.find(self._end)
        if at < 0:
            if len(buffer) > self._limit:
                raise _bad(buffer, len(buffer), f"{len(buffer)} bytes without a terminator")
            return None
        piece = bytes(buffer[:at])
        begins = piece.rfind(self._start) if self._start else 0
        if begins != 0:
            # The buffer is valid from the beginning of a whole message on; the bytes before it are not.
            cut = begins if begins > 0 else at + len(self._end)
            raise _bad(buffer, cut, "it does not have the start of a message")
        del buffer[: at + len(self._end)]
        return piece[len(self._start) :]

    def _skip_padding(self, buffer: bytearray) -> None:
        kept = buffer.lstrip(self._padding)
        del buffer[: len(buffer) - len(kept)]


class LengthPrefixed:
    """Messages with their length in bytes in front."""

    def __init__(
        self, width: int = 4, *, order: Literal["big", "little"] = "big", limit: int = 16 * LIMIT
    ) -> None:
        self._width, self._order, self._limit = width, order, limit

    def pack(self, message: bytes) -> bytes:
        return len(message).to_bytes(self._width, self._order) + message

    def take(self, buffer: bytearray) -> bytes | None:
        if len(buffer) < self._width:
            return None
        length = int.from_bytes(buffer[: self._width], self._order)
        if length > self._limit:
            raise _bad(buffer, len(buffer), f"its length field says {length} bytes, more than {self._limit}")
        whole = self._width + length
        if len(buffer) < whole:
            return None
        message = bytes(buffer[self._width : whole])
        del buffer[:whole]
        return message


class Checked:
    """Messages of another framing that end with ``width`` bytes of a check sum.

    ``check`` computes the check sum of a message. ``outgoing`` is sent instead of it, for devices that accept
    a wildcard.
    """

    def __init__(
        self, inner: Framing, check: Callable[[bytes], bytes], width: int, *, outgoing: bytes | None = None
    ) -> None:
        self._inner, self._check, self._width, self._outgoing = inner, check, width, outgoing

    def pack(self, message: bytes) -> bytes:
        return self._inner.pack(
            message + (self._check(message) if self._outgoing is None else self._outgoing)
        )

    def take(self, buffer: bytearray) -> bytes | None:
        piece = self._inner.take(buffer)
        if piece is None:
            return None
        message, found = piece[: -self._width], piece[-self._width :]
        if len(piece) < self._width or found != self._check(message):
            raise BadFrame(f"the check sum of {piece!r} is wrong")
        return message


def _bad(buffer: bytearray, cut: int, why: str) -> BadFrame:
    bad = bytes(buffer[:cut])
    del buffer[:cut]
    shown = bad if len(bad) <= 60 else bad[:60] + b"..."
    return BadFrame(f"{why}: {shown!r}")
