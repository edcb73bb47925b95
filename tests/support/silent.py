"""A server that takes connections, and then says nothing: a program that hangs on a computer that works."""

from __future__ import annotations

import contextlib
import socket
import threading
from types import TracebackType
from typing import Self


class SilentServer:
    """Listens on ``port``, keeps what connects, reads what comes, and never answers; or it sends ``begins``,
    and then one byte after the other, for ever."""

    def __init__(self, begins: bytes = b"") -> None:
        self._begins = begins
        self.received, self._over = threading.Event(), threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._kept: list[socket.socket] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        for each in (self._server, *self._kept):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                self._kept.append(near)
                if self._over.is_set():
                    near.close()
                    return
                threading.Thread(target=self._read, args=(near,), daemon=True).start()

    def _read(self, near: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while near.recv(65536):
                self.received.set()
                if self._begins:
                    self._drip(near)

    def _drip(self, near: socket.socket) -> None:
        near.sendall(self._begins)
        while not self._over.wait(0.05):
            near.sendall(b" ")
