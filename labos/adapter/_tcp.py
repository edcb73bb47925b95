"""A TCP connection to a foreign node; the adapters define the messages on it."""

from __future__ import annotations

import asyncio
from typing import Any

from labos.adapter._keepalive import keep_alive
from labos.errors import DeviceError

CONNECT_S = 5.0
LARGEST = 16 * 1024 * 1024
"""The largest number of bytes that wait to be read."""

Line = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Address:
    """The address of a foreign node; ``host`` and ``port`` are the first of these keys that ``config``
    has."""

    def __init__(self, config: dict[str, Any], host: tuple[str, ...], port: tuple[str, ...]) -> None:
        self._keys = host[0], port[0]
        self.host = str(next((config[key] for key in host if config.get(key)), ""))
        self.port = int(next((config[key] for key in port if config.get(key)), 0))

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    def check(self) -> None:
        """Raises DeviceError (``none``) if there is no address."""
        if not self.host or not self.port:
            raise DeviceError(f"`config:` has no `{'` and `'.join(self._keys)}`.", effects="none")

    async def open(self, patience_s: float) -> Line:
        """Connect; a failed computer is noticed after ``patience_s``. Raises DeviceError (``none``)."""
        try:
            opening = asyncio.open_connection(self.host, self.port, limit=LARGEST)
            reader, writer = await asyncio.wait_for(opening, CONNECT_S)
        except (OSError, TimeoutError) as error:
            raise self.make_no_answer_error(error) from error
        keep_alive(writer.get_extra_info("socket"), patience_s)
        return reader, writer

    def make_no_answer_error(self, error: Exception) -> DeviceError:
        """No connection could be made."""
        why = str(error) or f"no connection within {CONNECT_S:g} s"
        return DeviceError(f"{self} does not answer ({why}).", effects="none", remedy="Is it running?")
