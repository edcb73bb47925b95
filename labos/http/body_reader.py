"""Reads the bodies of requests: no more than is allowed, no slower, and not too many at once."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from starlette.requests import ClientDisconnect, Request

from labos.errors import BadInput
from labos.http.limits import LARGEST_BODIES, LARGEST_BODY


class TooLarge(BadInput):
    """The request is larger than it may be."""


class TooSlow(BadInput):
    """The request's body did not come in time."""


class TooMany(BadInput):
    """Too much is being sent to the lab at once."""


FIRST_S = 20.0
"""How long a body may take, besides what its size needs."""
SLOWEST = 64 * 1024
"""Bytes in a second: a slower body is given up."""


DRAINED = 8 * 1024 * 1024
DRAINED_S = 1.0
"""What is still read of a request that is refused: a connection that is closed while its client sends would
be reset, and the client might not hear why."""


async def drain(pieces: AsyncIterator[bytes]) -> None:
    """Read on for a moment, and throw it away."""
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
        """The whole body. Raises TooLarge as soon as more has come, TooSlow, TooMany."""
        told = request.headers.get("content-length", "")
        body = bytearray()
        loop = asyncio.get_running_loop()
        begun = loop.time()
        pieces = request.stream()
        try:
            if told.isdecimal() and int(told[:19]) > most:
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
