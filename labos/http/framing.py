"""The end of a request must be stated in exactly one way.

If a program in front of the lab (a proxy) reads the bytes of a connection differently, a client can hide a
request in the body of another one. So requests that two programs may read differently are refused.
"""

from __future__ import annotations

from typing import Any

import h11
from h11._receivebuffer import ReceiveBuffer
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_HEAD = 16 * 1024
"""The largest number of bytes in the head of a request."""


class _Lines(ReceiveBuffer):
    """Lines end with CR LF and do not continue on the next line."""

    def __init__(self) -> None:
        super().__init__()
        self._looked_at = 0

    def _extract(self, count: int) -> bytearray:
        self._looked_at = 0
        return super()._extract(count)

    def maybe_extract_lines(self) -> list[bytearray] | None:
        end = self._data.find(b"\r\n\r\n", max(0, self._looked_at - 3))
        if self._data[:2] == b"\r\n":
            end = 0
        self._expect_whole_lines(len(self._data) if end < 0 else end)
        return super().maybe_extract_lines()

    def maybe_extract_next_line(self) -> bytearray | None:
        line = super().maybe_extract_next_line()
        if line is not None and (b"\r" in line[:-2] or b"\n" in line[:-2]):
            raise h11.LocalProtocolError("a line with a bare CR or LF")
        return line

    def _expect_whole_lines(self, end: int) -> None:
        at = self._data.find(b"\n", self._looked_at, end)
        while at >= 0:
            if not self._data.endswith(b"\r", 0, at):
                raise h11.LocalProtocolError("a line that ends with a bare LF")
            if self._data.startswith((b" ", b"\t"), at + 1):
                raise h11.LocalProtocolError("a header that is continued on the next line")
            at = self._data.find(b"\n", at + 1, end)
        # A last LF is checked again, together with the bytes after it.
        self._looked_at = max(0, end - 1)


class StrictConnection(h11.Connection):
    """A server's connection; a request whose end is stated in two ways is a RemoteProtocolError."""

    def __init__(self) -> None:
        super().__init__(h11.SERVER, MOST_HEAD)
        self._receive_buffer = _Lines()

    def next_event(self) -> h11.Event | type[h11.NEED_DATA] | type[h11.PAUSED]:
        event = super().next_event()
        if isinstance(event, h11.Request):
            names = [name for name, _ in event.headers]
            if b"transfer-encoding" in names and b"content-length" in names:
                raise h11.RemoteProtocolError("both Content-Length and Transfer-Encoding")
            if b"transfer-encoding" in names and event.http_version < b"1.1":
                raise h11.RemoteProtocolError("Transfer-Encoding in HTTP/1.0")
        return event


class StrictProtocol(H11Protocol):
    """A connection to a server that uses the strict reading."""

    def __init__(self, *args: Any, **named: Any) -> None:
        super().__init__(*args, **named)
        self.conn = StrictConnection()
