"""Reads the bodies of requests, with limits on their size, duration and number."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from starlette.requests import ClientDisconnect, Request

from labos.errors import BadInput
from labos.http.limits import LARGEST_BODIES, LARGEST_BODY


class TooLarge(BadInput):
    """The request is too large."""


class TooSlow(BadInput):
    """The request's body did not come in time."""


class TooMany(BadInput):
    """Too many large requests are being sent to the lab at the same time."""


FIRST_S = 20.0
"""How long a body may take, in addition to the time that its size needs."""
SLOWEST = 64 * 1024
"""Bytes in a second: a slower body is refused."""


DRAINED = 8 * 1024 * 1024
DRAINED_S = 1.0
"""How long the rest of a refused request is still read. If the connection was closed while the client was
sending, it would be reset, and the client might not receive the reason."""


async def drain(pieces: AsyncIterator[bytes]) -> None:
    """Read and discard the rest of a request for a moment."""
    size = 0
    with contextlib.suppress(TimeoutError, ClientDisconnect):
        async with asyncio.timeout(DRAINED_S):
            async for piece in pieces:
                size += len(piece)
                if size > DRAINED:
                    return


class BodyReader:
    """The bodies that are being read."""

    def __init__(self) -> None:
        self._bytes = 0

    async def read(self, request: Request, most: int = LARGEST_BODY) -> bytes:
        """The whole body. Raises TooLarge as soon as it exceeds ``most``, TooSlow, TooMany."""
        length = request.headers.get("content-length", "")
        body = bytearray()
        loop = asyncio.get_running_loop()
        begun = loop.time()
        pieces = request.stream()
        try:
            if length.isdecimal() and int(length[:19]) > most:
                await drain(pieces)
                raise _make_too_large_error(most)
            while True:
                async with asyncio.timeout_at(begun + FIRST_S + len(body) / SLOWEST):
                    piece = await anext(pieces, None)
                if piece is None:
                    return bytes(body)
                body += piece
                self._bytes += len(piece)
                if len(body) > most:
                    await drain(pieces)
                    raise _make_too_large_error(most)
                if self._bytes > LARGEST_BODIES and self._bytes > len(body):
                    raise TooMany("The lab gets too many requests at once.", remedy="Ask again.")
        except TimeoutError:
            raise TooSlow(
                f"The request's body was not sent within {loop.time() - begun:.0f} s.",
                remedy="Send the whole body at once.",
            ) from None
        except ClientDisconnect:
            raise BadInput("The connection ended before the whole request was sent.") from None
        finally:
            self._bytes -= len(body)


def _make_too_large_error(most: int) -> TooLarge:
    size = f"{most // 1024} KB" if most < 1024 * 1024 else f"{most // 1024 // 1024} MB"
    return TooLarge(f"The request is larger than {size}.", remedy="Send less, or keep data in a file.")
