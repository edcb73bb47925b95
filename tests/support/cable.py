"""A line between two processes that can be cut and mended: what a router that dies, or a plug, does."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable


class Cable:
    """Carries connections to ``port`` on to ``target``, on this machine. Cut, it resets what it carries
    and refuses whatever comes; mended, it listens at the same port again. A connection on which
    ``deaf_after`` went to the target brings nothing back from then on."""

    def __init__(self, target: int) -> None:
        self.target = target
        self.carried = 0
        self.deaf_after = b""
        self.deaf = threading.Event()
        self._ends: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._listen()

    def cut(self) -> None:
        """Nothing gets through any more."""
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        with self._lock:
            ends, self._ends = self._ends, set()
        for end in ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        """Whoever tries again gets through."""
        self._server = socket.create_server(("127.0.0.1", self.port))
        self._listen()

    def _listen(self) -> None:
        threading.Thread(target=self._accept, args=(self._server,), daemon=True).start()

    def _accept(self, server: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = server.accept()
                threading.Thread(target=self._carry, args=(near,), daemon=True).start()

    def _carry(self, near: socket.socket) -> None:
        with contextlib.suppress(OSError), near, socket.create_connection(("127.0.0.1", self.target)) as far:
            with self._lock:
                self._ends |= {near, far}
                self.carried += 1
            deaf = threading.Event()
            back = threading.Thread(target=_pump, args=(far, near, deaf.is_set), daemon=True)
            back.start()
            _pump(near, far, receive=lambda data: self._listen_to(data, deaf))
            back.join()

    def _listen_to(self, data: bytes, deaf: threading.Event) -> None:
        if self.deaf_after and self.deaf_after in data:
            deaf.set()
            self.deaf.set()


def _pump(
    source: socket.socket,
    target: socket.socket,
    drop: Callable[[], bool] = lambda: False,
    receive: Callable[[bytes], None] = lambda data: None,
) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            receive(data)  # before it is passed on: its answer is not to come through
            if not drop():
                target.sendall(data)
    with contextlib.suppress(OSError):
        target.shutdown(socket.SHUT_RDWR)
