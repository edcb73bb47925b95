"""A TCP proxy that loses answers: what a bad line does to a request that was carried out."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable


class Proxy:
    """Listens on ``port`` and passes on to ``target``. A connection whose first bytes ``lose`` picks
    passes its request on; of the answer nothing comes, and the line is cut when it should come, or
    at once (``early``)."""

    def __init__(self, target: int) -> None:
        self.target = target
        self.lose: Callable[[bytes], bool] = lambda head: False
        self.early = False
        self.instead = b""
        self.lost = 0
        self.requests: list[bytes] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        threading.Thread(target=self._listen, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def lose_next(self, *words: bytes, early: bool = False, instead: bytes = b"") -> None:
        """Lose the answer to the next request that holds all these words in its first line; ``instead`` of
        it something else may be said."""
        self.early, self.instead = early, instead

        def is_picked(head: bytes) -> bool:
            line = head.partition(b"\r\n")[0]
            if not all(word in line for word in words):
                return False
            self.lose = lambda head: False
            return True

        self.lose = is_picked

    def close(self) -> None:
        """Answer nobody any more."""
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                threading.Thread(target=self._serve, args=(near,), daemon=True).start()

    def _serve(self, near: socket.socket) -> None:
        with contextlib.suppress(OSError), near:
            head = near.recv(65536)
            losing = self.lose(head)
            self.requests.append(head.partition(b"\r\n")[0])
            with socket.create_connection(("127.0.0.1", self.target)) as far:
                far.sendall(head)
                up = threading.Thread(target=_pump, args=(near, far), daemon=True)
                if losing and self.early:
                    near.settimeout(0.2)  # what is left of the request
                    with contextlib.suppress(OSError):
                        while more := near.recv(65536):
                            far.sendall(more)
                    self.lost += 1
                    near.shutdown(socket.SHUT_RDWR)
                    while far.recv(65536):  # the far side is not to notice
                        pass
                    return
                up.start()
                if losing:
                    far.recv(65536)
                    self.lost += 1
                    near.sendall(self.instead)
                    near.shutdown(socket.SHUT_RDWR)
                    return
                _pump(far, near)


def _pump(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            target.sendall(data)
        target.shutdown(socket.SHUT_WR)
