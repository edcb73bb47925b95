"""The device's end of a wire, for simulators of devices and for tests. It is a pseudo-terminal if the system
has them, otherwise a TCP port, which a serial link opens as ``socket://``. Real devices do not need this
module.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

from labos.link.transcript import TranscriptLine, read_exchanges

PORT_S = 20.0
"""How long to wait for a port that a simulated device had before and that is still in use."""


class FarEnd(Protocol):
    """The end of the wire at which a simulated device receives and sends."""

    @property
    def address(self) -> str:
        """The port that a serial link opens."""

    def read(self, timeout_s: float) -> bytes:
        """The received bytes; empty when the time is up, or while no client is connected."""

    def write(self, data: bytes) -> None:
        """Send data; it is lost if no client is connected."""

    def unplug(self) -> None:
        """Cut the line of the connected side."""

    def plug(self) -> None:
        """Connect the line again, at the same address."""

    def close(self) -> None: ...


class PtyEnd:
    """A pseudo-terminal. With ``path``, its address is a symbolic link of that name, like the names under
    ``/dev/serial/by-id``, which stays when the line is unplugged."""

    def __init__(self, path: str | Path | None = None) -> None:
        self._path = Path(path) if path is not None else None
        self._near = self._far = -1
        self._lock = threading.Lock()
        self.address = ""
        self.plug()

    def plug(self) -> None:
        import tty

        with self._lock:
            if self._far >= 0:
                return
            # The near side is kept open too, so that a client that leaves does not end the line.
            self._far, self._near = os.openpty()
            tty.setraw(self._near)
            os.set_blocking(self._far, False)
            self.address = os.ttyname(self._near)
            if self._path is not None:
                self._path.unlink(missing_ok=True)
                self._path.symlink_to(self.address)
                self.address = str(self._path)

    def unplug(self) -> None:
        with self._lock:
            for fd in (self._far, self._near):
                if fd >= 0:
                    os.close(fd)
            self._far = self._near = -1
            if self._path is not None:
                self._path.unlink(missing_ok=True)

    close = unplug

    def read(self, timeout_s: float) -> bytes:
        far = self._far
        try:
            if far < 0 or not select.select([far], [], [], timeout_s)[0]:
                if far < 0:
                    select.select([], [], [], timeout_s)
                return b""
            # Unplugged meanwhile, the number may be that of another file, and its read might never return.
            with self._lock:
                return os.read(far, 65536) if far == self._far else b""
        except (OSError, ValueError):
            return b""

    def write(self, data: bytes) -> None:
        # A full line means that no client reads: a device continues to send all the same.
        with self._lock, contextlib.suppress(OSError):
            if self._far >= 0:
                os.write(self._far, data)


class TcpEnd:
    """A TCP port that accepts one client at a time and sends it a greeting. ``clients`` counts all
    clients."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0, *, greeting: bytes = b"") -> None:
        self.host, self._greeting = host, greeting
        self.clients = 0
        self._listener = socket.create_server((host, port))
        self.port = int(self._listener.getsockname()[1])
        self._client: socket.socket | None = None

    @property
    def address(self) -> str:
        return f"socket://{self.host}:{self.port}"

    def plug(self) -> None:
        if self._listener.fileno() < 0:
            self._listener = server_at(self.host, self.port)

    def unplug(self) -> None:
        self._hang_up()
        with contextlib.suppress(OSError):
            # Another thread that waits for a client keeps a closed socket listening until it wakes up.
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    close = unplug

    def read(self, timeout_s: float) -> bytes:
        waiting: list[Any] = [one for one in (self._client, self._listener) if one and one.fileno() >= 0]
        try:
            ready = select.select(waiting, [], [], timeout_s)[0]
            if self._listener in ready:
                self._hang_up()
                self._client = self._listener.accept()[0]
                self.clients += 1
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client.sendall(self._greeting)
            elif self._client in ready and self._client is not None:
                data = self._client.recv(65536)
                if not data:
                    self._hang_up()
                return data
        except (OSError, ValueError):
            self._hang_up()
        return b""

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if self._client is not None:
                self._client.sendall(data)

    def _hang_up(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()


def server_at(host: str, port: int) -> socket.socket:
    """A socket that listens at this port (0: any free port). If another program has taken the port in the
    meantime, wait until it is free. Raises OSError."""
    give_up = time.monotonic() + PORT_S
    while True:
        try:
            return socket.create_server((host, port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE or time.monotonic() > give_up:
                raise
        time.sleep(0.05)


def serial_end() -> FarEnd:
    """The far end of a serial line, of the kind that this system supports."""
    return PtyEnd() if hasattr(os, "openpty") else TcpEnd()


def replay(
    script: str | Path | Iterable[TranscriptLine], end: FarEnd, *, patience_s: float = 5.0
) -> list[TranscriptLine]:
    """Play the device of a transcript over a real wire. Each answer is sent when the bytes before it in the
    transcript have been received again. Stops when other bytes arrive, or none for ``patience_s``; returns
    the part of the transcript that was not played.
    """
    left = read_exchanges(script)
    received = b""
    while left:
        if left[0].mark == "<":
            end.write(left.pop(0).data)
            continue
        wanted = left[0].data
        if received.startswith(wanted):
            received = received[len(wanted) :]
            left.pop(0)
            continue
        for _ in range(max(int(patience_s / 0.05), 1)):
            data = end.read(0.05)
            if data:
                break
        else:
            return left
        received += data
        if not (wanted.startswith(received) or received.startswith(wanted)):
            return left
    return []
